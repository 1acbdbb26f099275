"""Rules of the source that a program can check: described arguments, everyday words, public names, a quick import."""

import ast
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import strandline

ROOT = Path(__file__).parents[2]
OTHERS = ".venv"  # the other programs' environment, which `make bench` installs in verification/
SOURCES = [path for place in ("src", "verification") for path in sorted((ROOT / place).rglob("*.py"))]
SOURCES = [path for path in SOURCES if OTHERS not in path.parts]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
PREPOSITIONS = frozenset({
    "about", "above", "across", "after", "against", "along", "among", "around", "as", "at", "before", "behind", "below",
    "between", "beyond", "by", "down", "during", "except", "for", "from", "in", "inside", "into", "like", "near", "of",
    "off", "on", "onto", "out", "outside", "over", "past", "per", "since", "through", "to", "toward", "towards",
    "under", "until", "up", "upon", "via", "with", "within", "without",
})  # fmt: skip
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


def entries(docstring):
    """Yield names and descriptions of the entries under ``Args:``."""
    block = re.search(r"^ *Args:\n(.*?)(?=\n\s*\n|\Z)", docstring, re.MULTILINE | re.DOTALL)
    lines = block[1].splitlines() if block else []
    for line in lines:
        indent = len(lines[0]) - len(lines[0].lstrip())
        if entry := re.match(rf" {{{indent}}}(\S[^:]*): *(.*)", line):
            yield entry[1], entry[2]


def described(path):
    """Yield place and description of every argument in a file."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            for name, text in entries(ast.get_docstring(node) or ""):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}({name})", text


def leaning(text):
    """Tell whether a description needs the argument's name before it."""
    words = re.findall(r"[A-Za-z]+", text)
    return bool(words) and words[0].lower() in PREPOSITIONS


def test_every_argument_is_described_by_itself():
    found = [f"{place}: {text}" for path in SOURCES for place, text in described(path) if leaning(text)]
    assert not found, f"{len(found)}:\n" + "\n".join(found)
    for text, wrong in (("of them", True), ("Number of them", False), ("``of``", True), ("", False)):
        doc = f"Does it.\n\nArgs:\n    runs: {text}\n        and more: of it\n\nRaises:\n    X: of y."
        assert [(name, leaning(said)) for name, said in entries(doc)] == [("runs", wrong)]


def unusual(text):
    """Yield each unusual phrase with its line and a better one."""
    for pattern, better in UNUSUAL.items():
        for found in re.finditer(pattern, text, re.IGNORECASE):
            yield f"{text.count(chr(10), 0, found.start()) + 1}: {found[0]!r}; better: {better}"


def test_words_are_those_of_every_day():
    files = {path.relative_to(ROOT): path.read_text("utf-8") for path in (*SOURCES, *PAGES)}
    found = [f"{name}:{said}" for name, text in files.items() for said in unusual(text)]
    assert not found, f"{len(found)}:\n" + "\n".join(found)
    assert list(unusual("First.\nWanted is the mean.")) == ["2: 'Wanted is'; better: the goal is"]


def has_public_names(path):
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return any(isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_") for n in body)


def test_every_public_name_exists():
    for _, name, _ in pkgutil.walk_packages(strandline.__path__, "strandline."):
        module = importlib.import_module(name)
        public = getattr(module, "__all__", None)
        if name != "strandline.errors":  # all of its classes are public
            assert public is not None or not has_public_names(Path(str(module.__file__))), name
        for item in public or ():
            assert getattr(module, item) is not None, f"{name}.{item}"
        assert len(set(public or ())) == len(public or ()), name


def test_the_packages_names_exist_where_they_are_said_to_be_for_checkers_too_in_the_order_of_the_pipeline():
    for name in strandline.__all__:
        assert getattr(strandline, name) is not None
        assert name in dir(strandline)
    assert set(strandline.__all__) == set(strandline._HOME)
    tree = ast.parse(Path(str(strandline.__file__)).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == {name: f"strandline.{module}" for name, module in strandline._HOME.items()}
    order = "Uniform Parameter sobol Ledger Currents fit_log_likelihood sample Posterior Study"
    places = [strandline.__all__.index(name) for name in order.split()]
    assert places == sorted(places)
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = strandline.calibrat
    with pytest.raises(ImportError):
        exec("from strandline.studies import nothing")


def test_importing_the_package_loads_no_numerics():
    code = "import sys, strandline; print(*{name.partition('.')[0] for name in sys.modules})"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "jax", "matplotlib", "ngsolve", "pydantic", "yaml", "rich"}
    assert heavy.isdisjoint(ended.stdout.split())


def taken(source):
    """Yield (module, name) of everything that a program imports from strandline."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "strandline":
            yield from ((str(node.module), alias.name) for alias in node.names)


def hidden(module, name):
    """Return whether a name is not public; a module is."""
    home = importlib.import_module(module)
    if name in getattr(home, "__all__", ()) or name == "__version__":
        return False
    try:
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return not (module == "strandline.errors" and not name.startswith("_"))
    return False


def test_verification_imports_public_names_as_a_user_does():
    found = {
        f"{path.relative_to(ROOT)}: {module}.{name}"
        for path in SOURCES
        if path.is_relative_to(ROOT / "verification")
        for module, name in taken(path.read_text("utf-8"))
        if hidden(module, name)
    }
    assert not found, "\n".join(sorted(found))
    assert hidden("strandline.likelihood.interfaces", "_spoken")
    assert not hidden("strandline.likelihood", "InterfaceLikelihood")
    assert not hidden("strandline.report", "plots")
