"""Modules beside study.yaml: those of one folder never stand in for modules of the same names elsewhere."""

import importlib
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from inspect import getmodulename
from pathlib import Path
from types import ModuleType

__all__ = ["lies_in", "modules_of"]

OWN = "strandline"
"""Package that a file of the same name in a study folder does not replace."""


@dataclass
class _Folder:
    """The modules of a folder while they are not in `sys.modules`, and the names that its files give them."""

    path: Path
    loaded: dict[str, ModuleType] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    changed: int | None = None

    def look(self) -> None:
        """Read the names again if the folder has changed."""
        changed = self.path.stat().st_mtime_ns
        if changed == self.changed:
            return
        importlib.invalidate_caches()
        entries = [(one, one.name if one.is_dir() else getmodulename(one.name)) for one in self.path.iterdir()]
        usable = [(one, name) for one, name in entries if name is not None and _usable(name)]
        self.packages = tuple(name for one, name in usable if one.is_dir() and any(one.glob("*.py")))
        self.names, self.changed = (*self.packages, *(name for one, name in usable if one.is_file())), changed

    def taken(self) -> dict[str, ModuleType]:
        """Remove all modules with the names of this folder from `sys.modules`; return them."""
        below = tuple(f"{name}." for name in self.packages)
        found = [name for name in self.names if name in sys.modules]
        found += [name for name in list(sys.modules) if name.startswith(below)] if below else []
        return {name: sys.modules.pop(name) for name in found}


_TURN = threading.RLock()
_FOLDERS: dict[Path, _Folder] = {}
_CURRENT: list[Path] = []


def lies_in(folder: Path, module: str) -> bool:
    """Return whether `folder` has the file or package of `module`; a name of the standard library never lies there."""
    top = module.partition(".")[0]
    with suppress(OSError):  # a name that is too long for a file
        return _usable(top) and ((folder / f"{top}.py").is_file() or (folder / top / "__init__.py").is_file())
    return False


@contextmanager
def modules_of(folder: Path | None) -> Iterator[None]:
    """Let imports find the modules in `folder` first; None changes nothing.

    Each module is executed once per process and folder; nothing is written into the folder. One thread at a time can be
    inside. Afterwards `sys.modules` and `sys.path` are as before.

    Args:
        folder: Absolute path of the folder.
    """
    if folder is None:
        yield
        return
    with _TURN:
        if _CURRENT[-1:] == [folder]:
            yield
            return
        own = _FOLDERS.setdefault(folder, _Folder(folder))
        own.look()
        others = own.taken()
        sys.modules.update(own.loaded)
        sys.path.insert(0, str(folder))
        sys.dont_write_bytecode, kept = True, sys.dont_write_bytecode
        _CURRENT.append(folder)
        try:
            yield
        finally:
            _CURRENT.pop()
            sys.dont_write_bytecode = kept
            with suppress(ValueError):  # the model may have removed it
                sys.path.remove(str(folder))
            own.loaded = own.taken()
            sys.modules.update(others)


def _usable(name: str) -> bool:
    return name.isidentifier() and name != OWN and name not in sys.stdlib_module_names
