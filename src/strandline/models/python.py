"""A forward model of your own: a Python function, named in the study file, and the modules beside study.yaml."""

import importlib
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import getmodulename
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from strandline.foundations import imported, unfit
from strandline.interface import Interface
from strandline.models import protocol
from strandline.models.identity import OWN, fingerprint
from strandline.readers import repeats_first, require_clear_ends

__all__ = ["PythonModel", "lies_in", "modules_of"]

WHAT = "function of the Python model"


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
    """Let imports find the modules in `folder`, an absolute path, first; None changes nothing.

    Each module is executed once per process and folder; nothing is written into the folder. One thread at a time can be
    inside. Afterwards `sys.modules` and `sys.path` are as before.
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


@dataclass(frozen=True)
class PythonModel:
    """A simulator ``function(inputs, workdir)``, imported by the name of its module.

    It is called with the inputs by name and an empty folder for the run. It returns a `Simulation`, an `Interface`, or
    the points (point, 2) of an open polyline in mm, in order along the interface. If a run fails, it raises
    `ForwardModelError`. Any callable object at the top level of a module works.

    The function may carry four attributes: ``inputs``, a tuple of `ModelInput`; ``fingerprint``, a text;
    ``conditions``, the names of the interfaces if a `Simulation` holds several; and ``failure_kinds``, the kinds of
    `ForwardModelError` that it raises. Without ``inputs``, units and valid ranges are unknown: the study's unit
    (optional then) is taken as it is and no range is checked. Without ``fingerprint``, runs are identified by the
    source of the function's file and of the files that it imports from the same package or folder; other code that it
    calls can change unnoticed.

    Args:
        function: ``module:name``; the module must be in the study folder, installed, or on PYTHONPATH.
        sensitivities: Whether to compute sensitivities too; the callable is then a dataclass with a field of that name,
            or a function with the attribute ``sensitivities = True``. It may return a `vjp` in their place: a run then
            calls that once for each coordinate of each interface.
        folder: Folder of the study. If the module lies there, it and the modules beside it are imported from there;
            else this becomes None. Modules of two folders may have the same names.

    Raises:
        InvalidInput: there is no such module, or no such callable in it, or it offers no sensitivities.
    """

    function: str
    sensitivities: bool = False
    folder: Path | None = field(default=None, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        holds = self.folder is not None and lies_in(self.folder, self.function.partition(":")[0])
        object.__setattr__(self, "folder", self.folder.resolve() if self.folder and holds else None)
        self._target()

    @property
    def inputs(self) -> tuple[protocol.ModelInput, ...]:
        """The inputs that the function declares; empty if it declares none."""
        return protocol.declared_inputs(self._function())

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions that the function declares; a single unnamed one if it declares none."""
        return protocol.declared_conditions(self._function())

    @property
    def failure_kinds(self) -> tuple[str, ...] | None:
        """The kinds of failure that the function declares; None if it declares none."""
        return protocol.declared_failure_kinds(self._function())

    @property
    def fingerprint(self) -> str:
        """The function's own ``fingerprint``, or a text that changes with the source of its file and package."""
        try:
            with modules_of(self.folder):
                return fingerprint(self._function())
        except (OSError, TypeError):
            what = f"the source of {self.function} cannot be read"
            expected = "a function written in Python, or one with an attribute `fingerprint`"
            remedy = "Give it an attribute `fingerprint`, a text that changes whenever its results do."
            raise unfit(what, self.function, expected, remedy) from None

    def __call__(self, inputs: Mapping[str, Any], workdir: Path) -> Any:
        """Return the function's result, with points as an `Interface`; any other result makes the run invalid."""
        with modules_of(self.folder):
            result = self._target()(inputs, workdir)
        if isinstance(result, protocol.Simulation) and result.vjp is not None:
            return replace(result, vjp=partial(self._pulled_back, result.vjp))
        return result if isinstance(result, protocol.Simulation | Interface) else _polyline(result)

    def _pulled_back(self, vjp: Any, factors: protocol.Factors) -> protocol.Gradient:
        with modules_of(self.folder):
            found: protocol.Gradient = vjp(factors)
        return found

    def _function(self) -> Any:
        missing = "Correct the name, put the module beside study.yaml, install it, or put its folder on PYTHONPATH."
        with modules_of(self.folder):
            found = imported(self.function, WHAT, missing)
        if not callable(found):
            raise unfit(WHAT, self.function, "a function or another callable", "Correct the name.")
        return found

    def _target(self) -> Any:
        found = self._function()
        return protocol.with_sensitivities(found) if self.sensitivities else found


def _polyline(points: Any) -> Any:
    """Return the polyline through points (point, 2), closed if it repeats its first; return anything else unchanged."""
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] != 2:
        return points
    if closed := repeats_first(array):
        array = array[:-1]
    elif np.isfinite(array).all():
        remedy = "Return strandline.Interface.polyline(points, closed=True) or closed=False."
        require_clear_ends(array, "the array of points", remedy)
    return Interface.polyline(array, closed=closed)
