"""The source files of a Python model: its own, and those of the same package that it imports."""

import ast
import importlib.util
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType

__all__ = ["sources_of"]

OWN = "strandline"
"""Package whose modules are identified by its version, not by their text."""
INSTALLED = frozenset({"site-packages", "dist-packages"})


def sources_of(module: str) -> list[tuple[str, str]]:
    """Return (name, text) of `module` and the neighbouring modules it imports, directly or not, sorted by name.

    Neighbouring modules are those of the same top-level package, and, unless it is installed, those in the same folder
    as that package or file. Modules imported under a computed name are not found; neither are data files.

    Raises:
        OSError: The module has no file that can be read.
    """
    first = _file(module)
    if first is None:
        raise OSError(f"no source of {module}")
    top = module.partition(".")[0]
    root = first.parents[module.count(".") + (first.name == "__init__.py")]
    found: dict[str, str] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = None if name in found else _file(name)
        if path is None or (name != module and not _beside(name, path, top, root)):
            continue
        found[name] = path.read_text(encoding="utf-8")
        waiting += _imported(found[name], name if path.name == "__init__.py" else name.rpartition(".")[0])
    return sorted(found.items())


def _beside(name: str, path: Path, top: str, root: Path) -> bool:
    own = name.partition(".")[0]
    if own == OWN:
        return False
    if INSTALLED & set(root.parts) or own == top:
        return own == top
    return path.is_relative_to(root) and not INSTALLED & set(path.relative_to(root).parts)


def _file(name: str) -> Path | None:
    """Return the Python file of a module, loaded or not; None if there is none."""
    module = sys.modules.get(name)
    origin = getattr(module, "__file__", None) if isinstance(module, ModuleType) else _origin(name)
    return Path(origin).resolve() if origin and str(origin).endswith(".py") and Path(origin).is_file() else None


def _origin(name: str) -> str | None:
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError, AttributeError):
        return None
    return None if spec is None else spec.origin


@lru_cache(maxsize=4096)
def _imported(text: str, package: str) -> tuple[str, ...]:
    """Return the names of all modules that this source may import, parents included."""
    return tuple(dict.fromkeys(part for name in _named(ast.parse(text), package) for part in _with_parents(name)))


def _named(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            kept = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            origin = ".".join([*kept, *([node.module] if node.module else [])])
            yield from (
                (origin, *(f"{origin}.{alias.name}" for alias in node.names))
                if origin
                else (alias.name for alias in node.names)
            )


def _with_parents(name: str) -> Iterator[str]:
    parts = name.split(".")
    yield from (".".join(parts[: i + 1]) for i in range(len(parts)))
