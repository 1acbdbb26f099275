"""Rules of style that a program can check: arguments described by themselves, everyday words, short functions."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted(
    path
    for place in ("src", "verification")
    for path in (ROOT / place).rglob("*.py")
    if ".venv" not in path.parts  # the other programs' environment, which `make bench` installs there
)
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


def entries(docstring: str) -> Iterator[tuple[str, str]]:
    """Yield names and descriptions of the entries under ``Args:``."""
    block = re.search(r"^ *Args:\n(.*?)(?=\n\s*\n|\Z)", docstring, re.MULTILINE | re.DOTALL)
    if block is None:
        return
    lines = block[1].splitlines()
    indent = len(lines[0]) - len(lines[0].lstrip())
    for line in lines:
        entry = re.match(rf" {{{indent}}}(\S[^:]*): *(.*)", line)
        if entry:
            yield entry[1], entry[2]


def described(path: Path) -> Iterator[tuple[str, str]]:
    """Yield place and description of every argument in a file."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            for name, text in entries(ast.get_docstring(node) or ""):
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}({name})", text


def leaning(text: str) -> bool:
    """Tell whether a description needs the argument's name before it."""
    words = re.findall(r"[A-Za-z]+", text)
    return bool(words) and words[0].lower() in PREPOSITIONS


def test_every_argument_is_described_by_itself() -> None:
    found = [f"{place}: {text}" for path in SOURCES for place, text in described(path) if leaning(text)]
    assert not found, f"{len(found)}:\n" + "\n".join(found)


def test_a_leaning_description_is_noticed() -> None:
    for text, wrong in (("of them", True), ("Number of them", False), ("``of``", True), ("", False)):
        assert leaning(text) is wrong
        described = f"    runs: {text}\n        and more: of it"
        ((name, found),) = entries(f"Does it.\n\nArgs:\n{described}\n\nRaises:\n    X: of y.")
        assert (name, leaning(found)) == ("runs", wrong)


def unusual(text: str) -> Iterator[str]:
    """Yield each unusual phrase with its line and a better one."""
    for pattern, better in UNUSUAL.items():
        for found in re.finditer(pattern, text, re.IGNORECASE):
            yield f"{text.count(chr(10), 0, found.start()) + 1}: {found[0]!r}; better: {better}"


def test_words_are_those_of_every_day() -> None:
    files = {path.relative_to(ROOT): path.read_text("utf-8") for path in (*SOURCES, *PAGES)}
    found = [f"{name}:{said}" for name, text in files.items() for said in unusual(text)]
    assert not found, f"{len(found)}:\n" + "\n".join(found)
    assert list(unusual("First.\nWanted is the mean.")) == ["2: 'Wanted is'; better: the goal is"]
