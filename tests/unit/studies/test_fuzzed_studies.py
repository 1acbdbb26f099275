"""Mutated study files: each is a valid study or refused with one line, and nothing is written."""

import copy
import json
import random
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from strandline.errors import InvalidInput
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY

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


def mutated_content(content: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """Return the content with one to three values changed, renamed, moved, nested or taken away."""
    content = copy.deepcopy(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        *way, key = chance.choice(list(places(content)) or [("name",)])
        inside: Any = content
        for step in way:
            inside = inside[step]
        value = inside[key] if isinstance(inside, list) or key in inside else None
        kind = chance.randrange(7)
        if kind == 0:
            del inside[key]
        elif kind == 1 and isinstance(inside, dict):
            inside[chance.choice([k for k in ODD if isinstance(k, str | int | None)])] = inside.pop(key)
        elif kind == 2:
            inside[key] = [value] if chance.random() < 0.5 else {str(key): value}
        elif kind == 3 and isinstance(value, int | float) and not isinstance(value, bool):
            inside[key] = chance.choice((str(value), -value, value * 1e9, value * 1e-9, value * 1e200, [value, value]))
        elif kind == 4 and isinstance(value, list):
            inside[key] = chance.choice((value * 2, value[:1], value[::-1], dict(enumerate(value)), value * 400))
        else:
            inside[key] = copy.deepcopy(chance.choice(ODD))
    return content


def mutated_text(text: str, chance: random.Random) -> str:
    """Return the text with pieces put in, taken out, or lines doubled and swapped."""
    for _ in range(chance.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        here, there = chance.randrange(len(lines)), chance.randrange(len(lines))
        at = chance.randrange(len(text) + 1)
        kind = chance.randrange(5)
        if kind == 0:
            lines.insert(there, lines[here])
            text = "\n".join(lines)
        elif kind == 1:
            del lines[here]
            text = "\n".join(lines)
        elif kind == 2:
            text = text[:at] + text[at + chance.randrange(1, 12) :]
        else:
            text = text[:at] + chance.choice(PIECES) + text[at:]
    return text


def written(content: dict[str, Any], chance: random.Random) -> str:
    """Return the content as YAML, in one of two styles."""
    if chance.random() < 0.5:
        return json.dumps(content)
    return yaml.safe_dump(content, allow_unicode=True, default_flow_style=chance.choice((None, False)))


def entries(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}


def bases(folder: Path) -> list[Path]:
    """Return copies of the shipped studies, and of the two of the testing kit."""
    for shipped in SHIPPED:
        shutil.copytree(shipped, folder / shipped.name, ignore=shutil.ignore_patterns("ledger*", "fig*"))
    for name, changes in (("beam", {}), ("two-loads", TWO_LOADS_STUDY)):
        (folder / name).mkdir()
        (folder / name / "study.yaml").write_text(json.dumps({**BEAM_STUDY, **changes}))
    return sorted(folder.iterdir())


def study_texts(folder: Path, seed: int, number: int) -> Iterator[tuple[Path, str]]:
    """Yield folders with the texts of mutated studies, the same for the same seed."""
    chance = random.Random(seed)
    known = [(path, text := (path / "study.yaml").read_text(), yaml.safe_load(text)) for path in bases(folder)]
    for _ in range(number):
        path, text, content = chance.choice(known)
        by_content = chance.random() < 0.7
        yield path, written(mutated_content(content, chance), chance) if by_content else mutated_text(text, chance)


def complaint(run: Callable[[], object]) -> str:
    """Return what is wrong with how `run` ended; nothing for a valid study or a clear refusal."""
    try:
        run()
    except InvalidInput as error:
        line = str(error)
        return "" if line.isprintable() and len(line) < 3000 else f"not one plain line: {line[:300]!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:300]
    return ""


def found_in(folder: Path, seed: int, number: int) -> list[str]:
    """Return the complaints about `number` mutated studies."""
    found = []
    for path, text in study_texts(folder, seed, number):
        (path / "study.yaml").write_text(text, encoding="utf-8", errors="surrogatepass")
        before = entries(path)
        wrong = complaint(lambda path=path: load_study(path))
        if not wrong and entries(path) != before:
            wrong = "something was written"
        if wrong:
            found.append(f"{wrong}\n  in: {text[:2000]!r}")
    return found


def test_mutated_studies(tmp_path: Path) -> None:
    assert len(SHIPPED) >= 14
    assert found_in(tmp_path, SEED, FEW) == []


@pytest.mark.long
def test_other_mutated_studies(tmp_path: Path) -> None:
    seed = time.time_ns()
    assert found_in(tmp_path, seed, MANY) == [], f"seed {seed}"


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
    assert complaint(lambda: load_study(tmp_path)) == ""
