"""Public is what `__all__` says, in all places; what verifies the product uses public names only, as a user does."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import strandline

ROOT = Path(__file__).parents[2]
MODULES = [name for _, name, _ in pkgutil.walk_packages(strandline.__path__, "strandline.")]
HEAVY = {"numpy", "scipy", "jax", "matplotlib", "ngsolve", "pydantic", "yaml", "rich"}


def test_every_public_name_exists() -> None:
    for name in MODULES:
        module = importlib.import_module(name)
        public = getattr(module, "__all__", None)
        if name != "strandline.errors":  # all of its classes are public
            assert public is not None or not has_public_names(Path(str(module.__file__))), name
        for item in public or ():
            assert getattr(module, item) is not None, f"{name}.{item}"
        assert len(set(public or ())) == len(public or ()), name


def has_public_names(path: Path) -> bool:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_") for n in body)


def test_the_packages_names_exist_where_they_are_said_to_be_for_checkers_too() -> None:
    for name in strandline.__all__:
        assert getattr(strandline, name) is not None
        assert name in dir(strandline)
    assert set(strandline.__all__) == set(strandline._HOME)
    tree = ast.parse(Path(str(strandline.__file__)).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == {name: f"strandline.{module}" for name, module in strandline._HOME.items()}


def test_the_order_is_that_of_the_pipeline() -> None:
    order = "Uniform Parameter sobol Ledger Currents fit_log_likelihood sample Posterior Study"
    places = [strandline.__all__.index(name) for name in order.split()]
    assert places == sorted(places)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = strandline.calibrat
    with pytest.raises(ImportError):
        exec("from strandline.studies import nothing")


def test_importing_the_package_loads_no_numerics() -> None:
    code = "import sys, strandline; print(*{name.partition('.')[0] for name in sys.modules})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert HEAVY.isdisjoint(ended.stdout.split())


def taken(source: str) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of everything that a program imports from strandline."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "strandline":
            yield from ((str(node.module), alias.name) for alias in node.names)


def hidden(module: str, name: str) -> bool:
    """Return whether a name is not public; a module is."""
    home = importlib.import_module(module)
    if name in getattr(home, "__all__", ()) or name == "__version__":
        return False
    try:
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return not (module == "strandline.errors" and not name.startswith("_"))
    return False


def test_verification_imports_public_names() -> None:
    found = {
        f"{path.relative_to(ROOT)}: {module}.{name}"
        for path in sorted((ROOT / "verification").rglob("*.py"))
        if ".venv" not in path.parts
        for module, name in taken(path.read_text("utf-8"))
        if hidden(module, name)
    }
    assert not found, "\n".join(sorted(found))
    assert hidden("strandline.likelihood.interfaces", "_spoken")
    assert not hidden("strandline.likelihood", "InterfaceLikelihood")
    assert not hidden("strandline.report", "plots")
