"""Stacks of pictures → the surface of the solid in them, with its errors."""
