"""Values of a study file are changed in its text: comments and layout stay, and nothing else changes."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strandline.studies import yaml_edit
from strandline.studies.yaml_edit import REMOVED, changed_content, changed_text
from strandline.studies.yaml_text import load_yaml

ROOT = Path(__file__).parents[2]
TEXT = """\
# Top
noise: {sd: 3, unit: um}   # of a point
inputs:
  # stiffness
  E: {prior: {uniform: [1, 2]}, unit: Pa}  # Pa
  nu:
    prior:            # wide
      uniform: [0, 1]

  # the end of the inputs
design: {}
surrogate:
seed: 1   # any
note: |
  two
  lines
"""
CASES: list[tuple[dict[tuple[str, ...], Any], str, str]] = [
    ({("noise", "sd"): 4.5}, "{sd: 3, unit", "{sd: 4.5, unit"),
    ({("noise", "length"): 8}, "unit: um}", "unit: um, length: 8}"),
    ({("noise",): {"variance": 1.0}}, "{sd: 3, unit: um}", "{variance: 1.0}"),
    ({("inputs", "E", "prior", "uniform"): [100, 800]}, "[1, 2]", "[100, 800]"),
    (
        {("inputs", "nu", "prior"): {"normal": [0, 1]}},
        "# wide\n      uniform: [0, 1]",
        "# wide\n      {normal: [0, 1]}",
    ),
    ({("inputs", "nu"): {"prior": 3}}, "nu:\n    prior:            # wide\n      uniform: [0, 1]", "nu: {prior: 3}"),
    ({("inputs", "q"): {"prior": {}}}, "uniform: [0, 1]\n", "uniform: [0, 1]\n  q: {prior: {}}\n"),
    ({("inputs", "E"): REMOVED}, "  E: {prior: {uniform: [1, 2]}, unit: Pa}  # Pa\n", ""),
    ({("design", "sobol", "runs"): 9}, "design: {}", "design: {sobol: {runs: 9}}"),
    ({("surrogate", "field"): {}}, "surrogate:\n", "surrogate: {field: {}}\n"),
    ({("seed",): 2}, "seed: 1   # any", "seed: 2   # any"),
    ({("note",): "a, b: c"}, "note: |\n  two\n  lines", "note: 'a, b: c'"),
    ({("fixed",): {"load": 1e-5}}, "  lines\n", "  lines\nfixed: {load: 1.0e-05}\n"),
    ({("seed",): REMOVED}, "seed: 1   # any\n", ""),
    ({("noise", "nothing"): REMOVED}, "", ""),
]


@pytest.mark.parametrize(("changes", "old", "new"), CASES, ids=lambda value: None)
def test_one_value_changes_and_all_else_stays(changes: dict[tuple[str, ...], Any], old: str, new: str) -> None:
    assert not old or TEXT.count(old) == 1
    assert changed_text(TEXT, changes) == (TEXT.replace(old, new) if old else TEXT)


def test_several_changes() -> None:
    text = changed_text(TEXT, {("noise", "sd"): 1, ("inputs", "E"): REMOVED, ("fixed", "E"): 400, ("seed",): 7})
    assert load_yaml(text) == {
        "noise": {"sd": 1, "unit": "um"},
        "inputs": {"nu": {"prior": {"uniform": [0, 1]}}},
        "design": {},
        "surrogate": None,
        "seed": 7,
        "note": "two\nlines\n",
        "fixed": {"E": 400},
    }
    assert text.count("#") == TEXT.count("#") - 1


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        ("a: &one {x: 1}\nb: *one\n", {("b", "x"): 2}),
        ("a: &one {x: 1}\nb: *one\n", {("a",): 2}),
        ("{a: 1, b: 2}\n", {("a",): REMOVED}),
        ("a:\n  b: 1\nc: 2\n", {("a", "b"): REMOVED}),
    ],
)
def test_what_cannot_be_edited_is_written_anew(text: str, changes: dict[tuple[str, ...], Any]) -> None:
    content = load_yaml(changed_text(text, changes))
    assert content == changed_content(load_yaml(text), changes)
    assert content != load_yaml(text)


def test_a_wrong_edit_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted error: the edit cuts off what follows the value."""
    monkeypatch.setattr(yaml_edit, "_end", lambda text, node: len(text))
    text = changed_text(TEXT, {("noise", "sd"): 4})
    assert load_yaml(text) == changed_content(load_yaml(TEXT), {("noise", "sd"): 4})


SHIPPED = sorted(path for place in ("studies", "examples") for path in (ROOT / place).glob("*/study.yaml"))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-1e9, 1e9) | st.text("ab:,#'\"[]{} -\n", max_size=8),
    lambda below: (
        st.lists(below, max_size=3) | st.dictionaries(st.text("xyz", min_size=1, max_size=3), below, max_size=3)
    ),
    max_leaves=6,
)


def leaves(content: Any, above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = [above] if above else []
    for key, value in content.items() if isinstance(content, dict) else ():
        found += leaves(value, (*above, key))
    return found


@given(st.data())
def test_the_content_is_always_the_one_asked_for(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(SHIPPED)).read_text("utf-8")
    keys = data.draw(st.sampled_from(leaves(load_yaml(text))))
    if data.draw(st.booleans()):
        keys = (*keys[:-1], "new")
    changes = {keys: data.draw(VALUES)}
    new = changed_text(text, changes)
    assert load_yaml(new) == changed_content(load_yaml(text), changes)
    assert text.splitlines()[0] == new.splitlines()[0]
