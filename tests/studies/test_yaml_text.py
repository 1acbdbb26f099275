"""The text of study.yaml → plain data: merge keys work; depth, repetition, tags and odd numbers end in one line."""

import pytest

from strandline.errors import InvalidStudy
from strandline.studies.yaml_text import load_yaml


def test_merge_keys() -> None:
    text = "e: &a {x: 1, y: 2}\nf: {<<: *a, y: 3}\ng:\n  <<: [*a, {z: 1}]\n  x: 4\nh: {<<: {i: &b {u: 0}}, j: *b}\n"
    expected = {
        "e": {"x": 1, "y": 2},
        "f": {"x": 1, "y": 3},
        "g": {"x": 4, "y": 2, "z": 1},
        "h": {"i": {"u": 0}, "j": {"u": 0}},
    }
    assert load_yaml(text) == expected


def test_a_merge_within_a_merge_is_no_key_twice() -> None:
    text = "a: &a {x: 1}\nb: &b {<<: *a, x: 2}\nc: {<<: *b, x: 3}\n"
    assert load_yaml(text)["c"] == {"x": 3}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1_0", "1_0"),
        ("1_0.5", "1_0.5"),
        ("0x_f", "0x_f"),
        ("10", 10),
        ("-1.5e+3", -1500.0),
        ("1e-3", 0.001),
        ("2E5", 200000.0),
        (".5e1", 5.0),
        ("'1e-3'", "1e-3"),
        ("1e", "1e"),
        ("1_0e3", "1_0e3"),
        (".5", 0.5),
        ("0x1F", 31),
        (".inf", float("inf")),
        ("١٢", "١٢"),
        ("yes", True),
        ("~", None),
    ],
)
def test_words_and_numbers(text: str, value: object) -> None:
    assert load_yaml(f"a: {text}") == {"a": value}


CHAIN = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 200))])
LAUGHS = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9))])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: " + "[" * 5000, ["line 1", "at most 40"]),
        ("a: " + "[" * 5000 + "]" * 5000, ["line 1", "at most 40"]),
        ("a: " + "{b: " * 5000, ["line 1", "at most 40"]),
        ("- " * 5000 + "x", ["line 1", "at most 40"]),
        (CHAIN, ["line 40", "at most 40"]),
        (LAUGHS, ["line 6", "repeat each other"]),
        ("a: &a [*a]", ["*a within &a itself"]),
        ("a: &a {<<: *a}", ["*a within &a itself"]),
        ("a: !!bool maybe", ["line 1, column 4", "'maybe', which is no bool"]),
        ("a: !!int x", ["'x', which is no int"]),
        ("a: !!float ''", ["'', which is no float"]),
        ("a: !!timestamp x", ["'x', which is no timestamp"]),
        ("a: !!int 1_0", ["without underscores"]),
        ("a: !!set {x, y}", ["the tag tag:yaml.org,2002:set"]),
        ("a: !own x", ["the tag !own"]),
        ("a: =", ["the tag tag:yaml.org,2002:value"]),
        ("a: <<", ["study.yaml, line 1"]),
        ("<<: [3]", ["for merging"]),
        ("a: 1" + "0" * 400, ["401 digits"]),
        ("a: 0x" + "f" * 5000, ["5002 digits"]),
        ("? [a]\n: b", ["a list or mapping as a key"]),
        ('a: "\\0"', ["got \\x00", "Remove the character"]),
        ('a: "\\ud800"', ["got \\ud800"]),
        ('a: "\\e[2J"', ["got \\x1b"]),
        ("a: 1\n'a': 2", ["line 2: a key for the second time"]),
    ],
)
def test_refused_with_the_line(text: str, words: list[str]) -> None:
    with pytest.raises(InvalidStudy) as caught:
        load_yaml(text)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 400
    for word in words:
        assert word in message
