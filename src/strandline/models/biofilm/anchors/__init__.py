"""Runs that start from steady states solved beforehand, so that most of them need no Jacobian."""
