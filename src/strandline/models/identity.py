"""What distinguishes the runs of a model: its fingerprint, and the source files that a Python model consists of."""

import ast
import dataclasses
import hashlib
import importlib.util
import inspect
import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from strandline.foundations import unfit
from strandline.models.protocol import ForwardModel

OWN = "strandline"
"""Package whose modules are identified by its version; a file of this name in a study folder does not replace it."""
INSTALLED = frozenset({"site-packages", "dist-packages"})


def fingerprint(model: ForwardModel) -> str:
    """Return the text that identifies `model` in a ledger.

    This is its own `fingerprint` if it has one, plus the options of the instance if the class has one fingerprint for
    all instances. Otherwise it is a hash of the class or function, the file that defines it, the files of the same
    package that this file imports, and the fields except `sensitivities`, which change no interface. Of what was typed
    into a notebook or a terminal, only the source of the class or function counts.

    Raises:
        InvalidInput: There is no source, as of what `exec` made.
    """
    own = getattr(model, "fingerprint", None)
    if isinstance(own, str):
        return own + _options_beside(model)
    subject, fields = _described(model)
    sources: Any
    try:
        kind, sources = "python-files", sources_of(str(subject.__module__))
    except OSError:
        kind, sources = "python", _typed(subject)
    text = json.dumps([subject.__module__, subject.__qualname__, sources, fields], default=_exactly)
    return f"{kind}:{hashlib.sha256(text.encode()).hexdigest()[:16]}"


def _exactly(value: Any) -> str:
    """Return the text of a value; that of a long array, which NumPy cuts, is a hash."""
    if isinstance(value, np.ndarray) and value.size > np.get_printoptions()["threshold"]:
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    return repr(value)


def _typed(subject: Any) -> str:
    """Return the source of what was typed into a notebook or a terminal.

    There is none of what ``exec`` made, and its bytecode would change with the version of Python.
    """
    try:
        return inspect.getsource(subject)
    except (OSError, TypeError):
        expected = "a file or a notebook cell that defines it, or its own attribute `fingerprint`"
        remedy = "Define it in a file, or give it a text as `fingerprint` that changes with its results."
        raise unfit("source of the model", subject.__qualname__, expected, remedy) from None


def _options_beside(model: Any) -> str:
    """Return the options that differ from their defaults, if a dataclass has one fingerprint for all instances.

    A fingerprint declared as a ``ClassVar`` states on purpose that no option changes results.
    """
    kind = type(model)
    declared = "fingerprint" in inspect.get_annotations(kind)
    if not dataclasses.is_dataclass(model) or declared or not isinstance(vars(kind).get("fingerprint"), str):
        return ""
    given = {}
    for one in dataclasses.fields(model):
        if one.init and one.name != "sensitivities":
            default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
            if repr(value := getattr(model, one.name)) != repr(default):
                given[one.name] = value
    return f"/{json.dumps(given, default=repr, sort_keys=True)}" if given else ""


def _described(model: ForwardModel) -> tuple[Any, dict[str, Any]]:
    """Return the function, or the class and the fields, that `model` is made of."""
    instance: Any = model
    if isinstance(instance, partial):
        subject, fields = _described(instance.func)
        return subject, {**fields, "args": instance.args, "keywords": instance.keywords}
    subject = instance if inspect.isfunction(instance) else type(instance)
    is_record = dataclasses.is_dataclass(instance) and not isinstance(instance, type)
    fields = dataclasses.asdict(instance) if is_record else {}
    fields.pop("sensitivities", None)
    return subject, fields


def sources_of(module: str) -> list[tuple[str, str]]:
    """Return (name, text) of `module` and the neighbouring modules it imports, directly or not, sorted by name.

    Neighbouring modules are those of the same top-level package, and, unless it is installed, those in the same folder
    as that package or file. Modules imported under a computed name are not found; neither are data files. Raises
    OSError if the module has no file that can be read.
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
    module, origin = sys.modules.get(name), None
    with suppress(ImportError, ValueError, AttributeError):
        known = module if isinstance(module, ModuleType) else importlib.util.find_spec(name)
        origin = getattr(known, "__file__" if known is module else "origin", None)
    return Path(origin).resolve() if origin and str(origin).endswith(".py") and Path(origin).is_file() else None


@lru_cache(maxsize=4096)
def _imported(text: str, package: str) -> tuple[str, ...]:
    """Return the names of all modules that this source may import, parents included."""
    parts = (name.split(".") for name in _named(ast.parse(text), package))
    return tuple(dict.fromkeys(".".join(some[: i + 1]) for some in parts for i in range(len(some))))


def _named(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            kept = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            origin = ".".join([*kept, *([node.module] if node.module else [])])
            names = [alias.name for alias in node.names]
            yield from [origin, *(f"{origin}.{name}" for name in names)] if origin else names
