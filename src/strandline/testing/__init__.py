"""Public helpers for tests: conformance suites, one for each kind of part, and small models and a study for them."""

from collections.abc import Callable
from typing import Any, ParamSpec

__all__ = ["by_name", "require_parts"]

_Arguments = ParamSpec("_Arguments")


def by_name(*checks: Callable[_Arguments, None]) -> dict[str, Callable[_Arguments, None]]:
    """Return the checks by their names, without `check_`."""
    return {check.__name__.removeprefix("check_"): check for check in checks}


def require_parts(entry: Any, protocol: Any) -> None:
    """Raise AssertionError with the names of the parts of `protocol` that `entry` lacks."""
    parts = [name for name in dir(protocol) if not name.startswith("_")]
    missing = [name for name in parts if not hasattr(entry, name)]
    assert not missing, f"{type(entry).__name__} has no {', '.join(missing)}"
