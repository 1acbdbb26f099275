"""What the conformance suites share: a protocol's parts, and the checks by name."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ParamSpec

from strandline.readers import Unreadable

__all__ = ["by_name", "refusal", "require_parts"]

_Arguments = ParamSpec("_Arguments")


def by_name(*checks: Callable[_Arguments, None]) -> dict[str, Callable[_Arguments, None]]:
    """Return the checks by their names, without `check_`."""
    return {check.__name__.removeprefix("check_"): check for check in checks}


def require_parts(entry: Any, protocol: Any) -> None:
    """Raise AssertionError with the names of the parts of `protocol` that `entry` lacks."""
    parts = [name for name in dir(protocol) if not name.startswith("_")]
    missing = [name for name in parts if not hasattr(entry, name)]
    assert not missing, f"{type(entry).__name__} has no {', '.join(missing)}"


def refusal(name: str, content: bytes, read: Callable[[Path], object]) -> str:
    """Return the message with which `read` refuses a file of this name and content; empty if it reads it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        try:
            read(path)
        except Unreadable as error:
            return str(error)
    return ""
