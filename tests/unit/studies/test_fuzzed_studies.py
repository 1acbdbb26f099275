"""Mutated study files: each is a valid study or refused with one line, and nothing is written."""

import copy
import json
import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from strandline.errors import InvalidInput
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study

ROOT = Path(__file__).parents[3]
SHIPPED = sorted(path.parent for place in ("studies", "examples") for path in (ROOT / place).glob("*/study.yaml"))
SEED, FEW, MANY = 20260, 80, 2000
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 0.5, -0.0, 2**31, 2**63, 10**30, 10**299, 1e12, 1e-300, 1e300, 1.7e308, 5e-324,
    float("nan"), float("inf"), "", " ", "nan", "inf", "80", "1_0", "1e-5", "1e999", "١٢", "Ⅳ", "²", "a/b", "../..",
    "/dev/null", "/", ".", "..", "~", "a\nb", "a\tb", "a\0b", "\x1b[2J", "\x7f", "\ud800", "\u202eabc", "é" * 70,
    "x" * 300, "x" * 5000, "/x" * 3000, "$\\frac{$", "{{ E", "{% raw %}", "{{ " + "(" * 500, "<b>&", "draw", "weight",
    "=", "%s", "no:such", ":", "a:", ":b", ".:b", "..a:b", "os.path:join", "json:dumps", "[", "2020-01-01", "4:00:00",
    [], {}, [[]], [1], [1, 2], [2, 1], [0, 0], [1, 2, 3, 4], [1e308, -1e308], ["a", "b"], [None], [{}], {"a": 1},
    {"a": {}}, {"file": "a\0b"}, {"file": "x" * 5000, "unit": "mm"}, {"uniform": [0, 1]}, {1: 2}, {None: 1}, {"": 1},
)  # fmt: skip
PIECES = (
    "\0", "\t", "\x85", "\ufeff", "\n", "- ", "? ", ": ", "&a ", "*a", "<<: *a", "!!bool ", "!!int ", "!!set ", "!x ",
    "{", "}", "[", "]", "'", '"', "#", "|", ">", "%", "@", "`", "---\n", "...\n", "0x", "1_0", "[" * 200, "{a: " * 60,
    "&a [*a]", "\u2028", "é", "\U0001f4a5", "!!python/name:os.system ", "!!float x", "!!timestamp x",
)  # fmt: skip


def places(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the place of every value below the root."""
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*place, key)
        yield from places(value, (*place, key))


def changed(content: dict[str, Any], chance: random.Random) -> str:
    """Return the content as YAML, with one to three values changed, renamed, nested or taken away."""
    content = copy.deepcopy(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        *way, key = chance.choice(list(places(content)) or [("name",)])
        inside: Any = content
        for step in way:
            inside = inside[step]
        value = inside[key] if isinstance(inside, list) or key in inside else None
        kind = chance.randrange(5)
        if kind == 0:
            del inside[key]
        elif kind == 1 and isinstance(inside, dict):
            inside[chance.choice([k for k in ODD if isinstance(k, str | int | None)])] = inside.pop(key)
        elif kind == 2:
            inside[key] = chance.choice(([value], {str(key): value}, value * 2 if isinstance(value, list) else [value]))
        elif kind == 3 and isinstance(value, int | float):
            inside[key] = chance.choice((str(value), -value, value * 1e9, value * 1e-9, value * 1e200))
        else:
            inside[key] = copy.deepcopy(chance.choice(ODD))
    return json.dumps(content) if chance.random() < 0.5 else yaml.safe_dump(content, allow_unicode=True)


def damaged(text: str, chance: random.Random) -> str:
    """Return the text with pieces put in or taken out."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        at = chance.randrange(len(text) + 1)
        cut = chance.choice((0, 0, chance.randrange(1, 12)))
        text = text[:at] + ("" if cut else chance.choice(PIECES)) + text[at + cut :]
    return text


def complaint(folder: Path) -> str:
    """Return what is wrong with how loading ended; nothing for a valid study or a clear refusal."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    try:
        load_study(folder)
    except InvalidInput as error:
        line = str(error)
        if not line.isprintable() or len(line) >= 3000:
            return f"not one plain line: {line[:300]!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:300]
    return "" if before == {path: path.stat().st_mtime_ns for path in folder.rglob("*")} else "something was written"


def complaints(folder: Path, seed: int, number: int) -> list[str]:
    """Return the complaints about mutations of the shipped studies, and of the two of the testing kit."""
    chance, found = random.Random(seed), []
    for shipped in SHIPPED:
        shutil.copytree(shipped, folder / shipped.name, ignore=shutil.ignore_patterns("ledger*", "fig*"))
    write_study(folder / "beam")
    write_study(folder / "two-loads", **TWO_LOADS_STUDY)
    texts = {path: (path / "study.yaml").read_text() for path in sorted(folder.iterdir())}
    for _ in range(number):
        path, text = chance.choice(list(texts.items()))
        text = changed(yaml.safe_load(text), chance) if chance.random() < 0.7 else damaged(text, chance)
        (path / "study.yaml").write_text(text, encoding="utf-8", errors="surrogatepass")
        wrong = complaint(path)
        found += [f"{wrong}\n  in: {text[:2000]!r}"] if wrong else []
    return found


def test_mutated_studies(tmp_path: Path) -> None:
    assert len(SHIPPED) >= 14
    assert complaints(tmp_path, SEED, FEW) == []


@pytest.mark.long
def test_other_mutated_studies(tmp_path: Path) -> None:
    seed = time.time_ns()
    assert complaints(tmp_path, seed, MANY) == [], f"seed {seed}"


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(place=st.sampled_from(sorted(places(dict(BEAM_STUDY)), key=str)), value=VALUES)
def test_any_value_anywhere(tmp_path: Path, place: tuple[Any, ...], value: Any) -> None:
    content = json.loads(json.dumps(dict(BEAM_STUDY)))
    inside: Any = content
    for step in place[:-1]:
        inside = inside[step]
    inside[place[-1]] = value
    (tmp_path / "study.yaml").write_text(json.dumps(content))
    assert complaint(tmp_path) == ""
