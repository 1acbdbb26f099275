"""Rules of the source that a program can check: everyday words and public names."""

import ast
import importlib
import pkgutil
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests import conftest

import strandline

ROOT = Path(__file__).parents[2]
OTHERS = ".venv"  # the other programs' environment, which `make bench` installs in verification/
SOURCES = [path for place in ("src", "verification") for path in sorted((ROOT / place).rglob("*.py"))]
SOURCES = [path for path in SOURCES if OTHERS not in path.parts]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
UNUSUAL = {
    r"wanted is\b": "the goal is",
    r"may (it|they|this|the \w+) be (believed|trusted)": "can you trust it",
    r"\bis told\b|\bare told\b|\btold anew\b": "reported, printed, shown",
    r"\bstands rightly\b": "is correct",
    r"\bwere it (by|for|only)\b": "even if",
    r"\banew\b": "again",
    r"\bheeded\b|\bheeds\b": "follow",
    r"\bfigures that a program might want\b": "all results",
}
"""What no native engineer would write, and what one would."""


def test_words_are_those_of_every_day():
    found = [
        f"{path.relative_to(ROOT)}: {phrase[0]!r}; better: {better}"
        for path in (*SOURCES, *PAGES)
        for pattern, better in UNUSUAL.items()
        for phrase in re.finditer(pattern, path.read_text("utf-8"), re.IGNORECASE)
    ]
    assert not found, "\n".join(found)


def test_modules_named_in_strings_lie_below_too():
    """The contract that imports point down cannot see those by name."""
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"][0]
    floor = {room: k for k, row in enumerate(reversed(contract["layers"])) for room in row.split(" | ")}
    for path in (ROOT / "src" / "strandline").rglob("*.py"):
        room = path.relative_to(ROOT / "src" / "strandline").parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            named = re.fullmatch(r"strandline\.(\w+)[\w.:]*", str(getattr(node, "value", "")))
            if named and room in floor:
                assert named[1] == room or floor[named[1]] < floor[room], f"{path}: {named[0]}"


def has_public_names(path):
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_") for n in body)


def test_every_public_name_exists():
    for _, name, _ in pkgutil.walk_packages(strandline.__path__, "strandline."):
        module = importlib.import_module(name)
        public = getattr(module, "__all__", None)
        if hasattr(module, "__path__"):  # a room; the modules in it are private to it, unless they say otherwise
            assert public is not None or not has_public_names(Path(str(module.__file__))), name
        for item in public or ():
            assert getattr(module, item) is not None, f"{name}.{item}"


def doors():
    """Yield the packages that import their names when they are first used, with these names."""
    for path in (ROOT / "src" / "strandline").rglob("__init__.py"):
        blocks = [node for node in ast.parse(path.read_text("utf-8")).body if isinstance(node, ast.If)]
        if blocks:
            package = ".".join(path.parent.relative_to(ROOT / "src").parts)
            yield package, [name.name for line in blocks[0].body for name in line.names]


def test_names_behind_a_door_are_those_that_checkers_see():
    found = dict(doors())
    assert len(found) > 8
    for package, names in found.items():
        room = importlib.import_module(package)
        assert all(getattr(room, name) is not None for name in names)
        assert {*getattr(room, "__all__", ())} <= {*names, *vars(room)}
        files = {path.stem for path in Path(str(room.__file__)).parent.iterdir()}
        assert not files & {*names}, "once the file is imported, it would be found under this name"
        with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
            _ = room.calibrat
    assert set(found["strandline"]) == set(strandline.__all__)


def test_a_room_is_entered_by_its_door():
    """A few have a second door: where the first would bring a solver along, or a file has the name of what it holds."""
    source = ROOT / "src" / "strandline"
    entered = {}
    for path in source.rglob("*.py"):
        room = path.relative_to(source).parts[0]
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            parts = (getattr(node, "module", None) or "").split(".") if isinstance(node, ast.ImportFrom) else []
            if parts[:1] == ["strandline"] and len(parts) > 1 and parts[1] != room and path.parent != source:
                entered.setdefault(parts[1], set()).add(".".join(parts[2:]))
    assert {room: files for room, files in entered.items() if len(files) > 3} == {}


def test_a_failure_is_skipped_for_a_missing_package_alone_and_not_for_what_its_test_names(monkeypatch):
    """Planted: lines of the test count as well, and one that names an extra is never seen to fail."""

    def report(error, printed=""):
        lines = 'raises(match="pip install \\"strandline[dask]\\"")'
        return SimpleNamespace(longrepr=f"> {lines}\nE   {error}", sections=[("stderr", printed)])

    monkeypatch.setattr(conftest, "OPTIONAL", {"absent_package"})
    assert conftest.needed(report("assert 1 == 2")) is None
    assert conftest.needed(report("No module named 'absent_package'")) == "absent_package"
    assert conftest.needed(report("SystemExit: 2", 'pip install "strandline[dask]"')) == "absent_package"
    monkeypatch.setattr(conftest, "OPTIONAL", {"json"})
    assert conftest.needed(report("SystemExit: 2", 'pip install "strandline[dask]"')) is None
