"""The text of study.yaml: read as plain data, changed in place, and compared without its questions."""

import hashlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strandline.errors import InvalidStudy
from strandline.studies import yaml_edit
from strandline.studies.question_keys import digest_of, without_questions
from strandline.studies.yaml_edit import REMOVED, changed_content, changed_text
from strandline.studies.yaml_text import load_yaml

ROOT = Path(__file__).parents[3]
SHIPPED = sorted(path for place in ("studies", "examples") for path in (ROOT / place).glob("*/study.yaml"))


def test_merge_keys() -> None:
    text = "e: &a {x: 1, y: 2}\nf: {<<: *a, y: 3}\ng:\n  <<: [*a, {z: 1}]\n  x: 4\nh: {<<: {i: &b {u: 0}}, j: *b}\n"
    expected = {
        "e": {"x": 1, "y": 2},
        "f": {"x": 1, "y": 3},
        "g": {"x": 4, "y": 2, "z": 1},
        "h": {"i": {"u": 0}, "j": {"u": 0}},
    }
    assert load_yaml(text) == expected
    assert load_yaml("a: &a {x: 1}\nb: &b {<<: *a, x: 2}\nc: {<<: *b, x: 3}\n")["c"] == {"x": 3}


WORDS: dict[str, Any] = {
    **{text: text for text in ("1_0", "1_0.5", "0x_f", "1e", "1_0e3", "١٢")},
    **{"10": 10, "-1.5e+3": -1500.0, "1e-3": 0.001, "2E5": 200000.0, ".5e1": 5.0, "'1e-3'": "1e-3", ".5": 0.5},
    **{"0x1F": 31, ".inf": float("inf"), "yes": True, "~": None},
}
CHAIN = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 200))])
LAUGHS = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9))])
REFUSED: list[tuple[str, ...]] = [
    ("a: " + "[" * 5000, "line 1", "at most 40"),
    ("a: " + "{b: " * 5000, "line 1", "at most 40"),
    ("- " * 5000 + "x", "line 1", "at most 40"),
    (CHAIN, "line 40", "at most 40"),
    (LAUGHS, "line 6", "repeat each other"),
    ("a: &a [*a]", "*a within &a itself"),
    ("a: &a {<<: *a}", "*a within &a itself"),
    ("a: !!bool maybe", "line 1, column 4", "'maybe', which is no bool"),
    ("a: !!int x", "'x', which is no int"),
    ("a: !!float ''", "'', which is no float"),
    ("a: !!timestamp x", "'x', which is no timestamp"),
    ("a: !!int 1_0", "without underscores"),
    ("a: !!set {x, y}", "the tag tag:yaml.org,2002:set"),
    ("a: !own x", "the tag !own"),
    ("a: =", "the tag tag:yaml.org,2002:value"),
    ("a: <<", "study.yaml, line 1"),
    ("<<: [3]", "for merging"),
    ("a: 1" + "0" * 400, "401 digits"),
    ("a: 0x" + "f" * 5000, "5002 digits"),
    ("? [a]\n: b", "a list or mapping as a key"),
    ('a: "\\0"', "got \\x00", "Remove the character"),
    ('a: "\\ud800"', "got \\ud800"),
    ('a: "\\e[2J"', "got \\x1b"),
    ("a: 1\n'a': 2", "line 2: a key for the second time"),
]


def test_words_and_numbers() -> None:
    assert {text: load_yaml(f"a: {text}")["a"] for text in WORDS} == WORDS


def test_odd_texts_are_refused_with_the_line() -> None:
    for text, *words in REFUSED:
        with pytest.raises(InvalidStudy) as caught:
            load_yaml(text)
        message = str(caught.value)
        assert message.isprintable()
        assert len(message) < 400
        assert [word for word in words if word not in message] == [], message


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
NU = "nu:\n    prior:            # wide\n      uniform: [0, 1]"
EDITS: list[tuple[dict[tuple[str, ...], Any], str, str]] = [
    ({("noise", "sd"): 4.5}, "{sd: 3, unit", "{sd: 4.5, unit"),
    ({("noise", "length"): 8}, "unit: um}", "unit: um, length: 8}"),
    ({("noise",): {"variance": 1.0}}, "{sd: 3, unit: um}", "{variance: 1.0}"),
    ({("inputs", "E", "prior", "uniform"): [100, 800]}, "[1, 2]", "[100, 800]"),
    (
        {("inputs", "nu", "prior"): {"normal": [0, 1]}},
        "# wide\n      uniform: [0, 1]",
        "# wide\n      {normal: [0, 1]}",
    ),
    ({("inputs", "nu"): {"prior": 3}}, NU, "nu: {prior: 3}"),
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


def test_one_value_changes_and_all_else_stays() -> None:
    for changes, old, new in EDITS:
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


def test_what_cannot_be_edited_is_written_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    shared = "a: &one {x: 1}\nb: *one\n"
    cases: list[tuple[str, dict[tuple[str, ...], Any]]] = [
        (shared, {("b", "x"): 2}),
        (shared, {("a",): 2}),
        ("{a: 1, b: 2}\n", {("a",): REMOVED}),
        ("a:\n  b: 1\nc: 2\n", {("a", "b"): REMOVED}),
    ]
    for text, changes in cases:
        assert load_yaml(changed_text(text, changes)) == changed_content(load_yaml(text), changes) != load_yaml(text)
    # A planted error: the edit cuts off what follows the value.
    monkeypatch.setattr(yaml_edit, "_end", lambda text, node: len(text))
    sd = {("noise", "sd"): 4}
    assert load_yaml(changed_text(TEXT, sd)) == changed_content(load_yaml(TEXT), sd)


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


@settings(max_examples=25)
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


STUDY = "version: 1\nname: a\n# end of the head\n\ninputs:\n  E: {prior: {uniform: [1, 2]}}\n\n# numbers\nseed: 1\n"
INLINE = "next: {V_in: [25, 50]}\n"
QUESTIONS = (
    INLINE,
    "# which rate\nnext:\n  V_in: [25, 50]\n  # and\n  together: 2\n",
    "what_if:\n- {fix: {V_in: 2}}\n",
    "specimens: all/*.csv\n",
)


def test_a_question_added_anywhere_leaves_the_digest_as_it_was() -> None:
    for question in QUESTIONS:
        asked = [STUDY + "\n" + question]
        for before in ("inputs:\n", "# numbers\nseed"):
            head, found, tail = STUDY.partition(before)
            asked.append(head + question + "\n" + found + tail)
        for text in asked:
            assert without_questions(text) == STUDY
            assert digest_of(text) == hashlib.sha256(STUDY.encode()).hexdigest()


def test_any_other_change_shows_and_other_texts_are_kept_whole() -> None:
    changes = {"seed: 1": "seed: 2", "[1, 2]": "[1, 3]", "# numbers": "# digits", "inputs": "next_inputs"}
    for old, new in changes.items():
        assert digest_of(STUDY.replace(old, new) + INLINE) != digest_of(STUDY)
    for text in ("{version: 1, next: {V_in: [1]}}\n", "a: [", "a: 1\na: *b\n", "- next\n", "", "[" * 5000):
        assert without_questions(text) == text
