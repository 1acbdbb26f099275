"""Discrepancies d² between a simulated and an observed interface, one measure a file."""
