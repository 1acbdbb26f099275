"""What verifies the product uses its public names only, so that it sees what a user sees."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]


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


def test_a_hidden_name_is_noticed() -> None:
    assert hidden("strandline.likelihood.interfaces", "_spoken")
    assert not hidden("strandline.likelihood", "InterfaceLikelihood")
    assert not hidden("strandline.report", "plots")
