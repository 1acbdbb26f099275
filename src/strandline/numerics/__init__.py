"""Internal numerical tools shared by several packages: threads, compiled functions, factorised matrices."""
