"""Adaptive tempered Sequential Monte Carlo."""
