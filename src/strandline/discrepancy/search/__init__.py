"""Nearest points of polylines and surfaces."""
