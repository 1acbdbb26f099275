"""The door of a room: the names that other rooms may import from it, each imported when it is first used."""

import ast
import importlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
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
        tree = ast.parse(Path(source).read_text(encoding="utf-8"))
        blocks = (node for node in tree.body if isinstance(node, ast.If))
        imports = (line for block in blocks for line in block.body if isinstance(line, ast.ImportFrom))
        return {alias.name: str(line.module) for line in imports for alias in line.names}

    def imported(name: str) -> Any:
        if name not in homes():
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        return getattr(importlib.import_module(homes()[name]), name)

    return imported
