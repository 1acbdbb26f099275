"""Figures: each function takes data and an optional Axes and returns the Axes."""
