"""Mutants that no test notices, and why none has to."""

__all__ = ["EXPLAINED"]

EXPLAINED: dict[tuple[str, str, str], str] = {}
"""(file, before, after): the reason."""
