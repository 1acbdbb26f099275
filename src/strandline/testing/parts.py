"""Which parts of a protocol something has."""

from typing import Any

__all__ = ["require_parts"]


def require_parts(entry: Any, protocol: Any) -> None:
    """Raise AssertionError with the names of the parts of `protocol` that `entry` lacks."""
    parts = [name for name in dir(protocol) if not name.startswith("_")]
    missing = [name for name in parts if not hasattr(entry, name)]
    assert not missing, f"{type(entry).__name__} has no {', '.join(missing)}"
