"""Weak forms of fluid, solid and mesh, element by element; the system that they make."""
