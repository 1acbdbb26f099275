"""The door of a room: the names that other rooms may import from it, each imported when it is first used."""

import importlib
import re
from collections.abc import Callable
from functools import cache
from typing import Any


def door(room: str, source: str) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package that imports its names below ``if TYPE_CHECKING:`` alone.

    So the command line's help loads no numerics, while type checkers and the import contracts see every name.

    Args:
        room: the package, its `__name__`.
        source: its `__init__.py`, which is read when the first name is wanted.
    """

    @cache
    def homes() -> dict[str, str]:
        with open(source, encoding="utf-8") as stream:  # noqa: PTH123  # pathlib and ast take longer than all of this
            imports = re.findall(r"^    from (\S+) import (\([^)]*\)|.+)$", stream.read(), re.MULTILINE)
        return {name: module for module, names in imports for name in re.findall(r"\w+", names)}

    def imported(name: str) -> Any:
        if name not in homes():
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes()[name]), name)

    return imported
