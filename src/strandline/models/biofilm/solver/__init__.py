"""Linear systems and Newton's method."""
