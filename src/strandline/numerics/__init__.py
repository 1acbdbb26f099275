"""Numerical tools that several packages share and no user sees: threads, compiled functions, factorised matrices."""
