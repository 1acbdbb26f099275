"""Public helpers for tests: conformance suites, one for each kind of part, and small models and a study for them.

Each check of a suite takes a part and raises `AssertionError` with a sentence on what is wrong.
"""

from typing import Any

__all__ = ["checks_of", "require_parts"]


def checks_of(module: dict[str, Any], prefix: str = "check_") -> dict[str, Any]:
    """Return the functions among `globals()` whose names begin with `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): check for name, check in module.items() if name.startswith(prefix)}


def require_parts(entry: Any, protocol: Any) -> None:
    """Raise AssertionError with the names of the parts of `protocol` that `entry` lacks."""
    parts = [name for name in dir(protocol) if not name.startswith("_")]
    missing = [name for name in parts if not hasattr(entry, name)]
    assert not missing, f"{type(entry).__name__} has no {', '.join(missing)}"
