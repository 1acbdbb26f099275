"""The text of study.yaml: read as plain data, mutated at random, changed in place, and copied with other values."""

import copy
import hashlib
import json
import random
import re
import shutil
import time
from pathlib import Path

import pytest
import yaml
from tests.unit.cli.command_line import contents

from strandline.foundations import InvalidInput, InvalidStudy
from strandline.studies import StudyFile, load_study
from strandline.studies.keys import text as study_text
from strandline.studies.keys.folder import QUESTION, digest_of
from strandline.studies.keys.schema import listed
from strandline.studies.keys.text import DEEPEST, REMOVED, changed_content, changed_text, load_yaml
from strandline.studies.write import changed_copy
from strandline.studies.write.changed_copy import changed_study
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

ROOT = Path(__file__).parents[3]
SHIPPED = sorted(path.parent for place in ("studies", "examples") for path in (ROOT / place).glob("*/study.yaml"))
ODD = (
    None, True, False, 0, -1, 1, 0.5, -0.0, 2**31, 2**63, 10**30, 10**299, 1e12, 1e-300, 1e300, 1.7e308, 5e-324,
    float("nan"), float("inf"), "", " ", "nan", "inf", "80", "1_0", "1e-5", "1e999", "١٢", "Ⅳ", "²", "a/b", "../..",
    "/dev/null", "/", ".", "..", "~", "a\nb", "a\tb", "a\0b", "\x1b[2J", "\x7f", "\ud800", "\u202eabc", "é" * 70,
    "x" * 300, "x" * 5000, "/x" * 3000, "$\\frac{$", "{{ E", "{% raw %}", "{{ " + "(" * 500, "<b>&", "draw", "weight",
    "=", "%s", "no:such", ":", "a:", ":b", ".:b", "..a:b", "os.path:join", "json:dumps", "[", "2020-01-01", "4:00:00",
    [], {}, [[]], [1], [1, 2], [2, 1], [0, 0], [1, 2, 3, 4], [1e308, -1e308], ["a", "b"], [None], [{}], {"a": 1},
    {"a": {}}, {"file": "a\0b"}, {"file": "x" * 5000, "unit": "mm"}, {"uniform": [0, 1]}, {1: 2}, {None: 1}, {"": 1},
)  # fmt: skip


def places(content, place=()):
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*place, key)
        yield from places(value, (*place, key))


def changed(content, chance):
    """Return the content as YAML, with one to three values changed, renamed, nested or taken away."""
    content = copy.deepcopy(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        *way, key = chance.choice(list(places(content)) or [("name",)])
        inside = content
        for step in way:
            inside = inside[step]
        value = inside[key] if isinstance(inside, list) or key in inside else None
        kind = chance.randrange(5)
        if kind == 0:
            del inside[key]
        elif kind == 1 and isinstance(inside, dict):
            inside[chance.choice([k for k in ODD if isinstance(k, str | int | None)])] = inside.pop(key)
        elif kind == 2:
            inside[key] = chance.choice(([value], {str(key): value}))
        elif kind == 3 and isinstance(value, int | float):
            inside[key] = chance.choice((str(value), -value, value * 1e9, value * 1e-9, value * 1e200))
        else:
            inside[key] = copy.deepcopy(chance.choice(ODD))
    return json.dumps(content) if chance.random() < 0.5 else yaml.safe_dump(content, allow_unicode=True)


def complaint(folder):
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


def complaints(folder, seed, number):
    """Return the complaints about mutations of the shipped studies, and of one with two conditions."""
    chance, found = random.Random(seed), []
    for shipped in SHIPPED:
        shutil.copytree(shipped, folder / shipped.name, ignore=shutil.ignore_patterns("ledger*", "fig*"))
    write_study(folder / "two-loads", **TWO_LOADS_STUDY)
    texts = [(path, (path / "study.yaml").read_text()) for path in sorted(folder.iterdir())]
    for _ in range(number):
        path, text = chance.choice(texts)
        text = changed(yaml.safe_load(text), chance)
        (path / "study.yaml").write_text(text, encoding="utf-8", errors="surrogatepass")
        wrong = complaint(path)
        found += [f"{wrong}\n  in: {text[:2000]!r}"] if wrong else []
    return found


@pytest.mark.stand_in
@pytest.mark.parametrize("number", [80, pytest.param(2000, marks=pytest.mark.long)])
def test_mutated_studies(tmp_path, number):
    seed = 20260 if number == 80 else time.time_ns()
    assert len(SHIPPED) >= 14
    assert complaints(tmp_path, seed, number) == [], f"seed {seed}"


def test_names_of_files_that_are_too_long(tmp_path):
    for shipped in ("command", "pendant-drop"):
        study = shutil.copytree(ROOT / "examples" / shipped, tmp_path / shipped) / "study.yaml"
        text = study.read_text()
        study.write_text(re.sub(r"(file: |files: \[)[\w.]+", rf"\g<1>{'x' * 300}", text, count=1))
        with pytest.raises(InvalidInput, match=r"no such file|is missing|cannot be read"):
            load_study(study.parent)


def test_merge_keys():
    text = "e: &a {x: 1, y: 2}\nf: {<<: *a, y: 3}\ng:\n  <<: [*a, {z: 1}]\n  x: 4\nh: {<<: {i: &b {u: 0}}, j: *b}\n"
    e, f, g, h = load_yaml(text).values()
    assert (e, f, g) == ({"x": 1, "y": 2}, {"x": 1, "y": 3}, {"x": 4, "y": 2, "z": 1})
    assert h == {"i": {"u": 0}, "j": {"u": 0}}
    assert load_yaml("a: &a {x: 1}\nb: &b {<<: *a, x: 2}\nc: {<<: *b, x: 3}\n")["c"] == {"x": 3}


WORDS = {
    **{text: text for text in ("1_0", "1_0.5", "0x_f", "1e", "1_0e3", "١٢")},
    **{"10": 10, "-1.5e+3": -1500.0, "1e-3": 0.001, "2E5": 200000.0, ".5e1": 5.0, "'1e-3'": "1e-3", ".5": 0.5},
    **{"0x1F": 31, ".inf": float("inf"), "yes": True, "~": None},
}
CHAIN = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 200))])
LAUGHS = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9))])
REFUSED = [
    ("a: " + "[" * 5000, "line 1", "at most 40"),
    (CHAIN, "line 39", "at most 40"),
    (LAUGHS, "line 6", "repeat each other"),
    ("a: &a [*a]", "*a within &a itself"),
    ("a: !!bool maybe", "line 1, column 4", "'maybe', which is no bool"),
    ("a: !own x", "the tag !own", "plain YAML without tags"),
    ("a: 1" + "0" * 400, "401 digits"),
    ("? [a]\n: b", "a list or mapping as a key"),
    ('a: "\\0"', "got \\x00", "Remove the character"),
    ("a: 1\n'a': 2", "line 2", "got a again; expected every key once"),
]


def test_words_and_numbers_and_odd_texts_which_are_refused_with_the_line():
    assert {text: load_yaml(f"a: {text}")["a"] for text in WORDS} == WORDS
    deepest = "[" * (DEEPEST - 1) + "]" * (DEEPEST - 1)
    assert str(load_yaml(f"a: {deepest}")["a"]) == deepest
    for text, *words in REFUSED:
        with pytest.raises(InvalidStudy) as caught:
            load_yaml(text)
        message = str(caught.value)
        assert message.isprintable()
        assert all(word in message for word in words), message


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
EDITS = [
    ({("noise", "sd"): 4.5}, "{sd: 3, unit", "{sd: 4.5, unit"),
    ({("noise", "length"): 8}, "unit: um}", "unit: um, length: 8}"),
    ({("inputs", "E", "prior", "uniform"): [100, 800]}, "[1, 2]", "[100, 800]"),
    ({("inputs", "nu", "prior"): {"normal": [0, 1]}}, "wide\n      uniform: [0, 1]", "wide\n      {normal: [0, 1]}"),
    ({("inputs", "q"): {"prior": {}}}, "uniform: [0, 1]\n", "uniform: [0, 1]\n  q: {prior: {}}\n"),
    ({("inputs", "E"): REMOVED}, "  E: {prior: {uniform: [1, 2]}, unit: Pa}  # Pa\n", ""),
    ({("design", "sobol", "runs"): 9}, "design: {}", "design: {sobol: {runs: 9}}"),
    ({("surrogate", "field"): {}}, "surrogate:\n", "surrogate: {field: {}}\n"),
    ({("fixed",): {"load": 1e-5}}, "  lines\n", "  lines\nfixed: {load: 1.0e-05}\n"),
    ({("seed",): REMOVED}, "seed: 1   # any\n", ""),
]


def test_one_value_changes_and_all_else_stays():
    for changes, old, new in EDITS:
        assert TEXT.count(old) == 1
        assert changed_text(TEXT, changes) == TEXT.replace(old, new)
    assert changed_text(TEXT, {("noise", "nothing"): REMOVED}) == TEXT
    several = {("noise", "sd"): 1, ("inputs", "E"): REMOVED, ("fixed", "E"): 400, ("seed",): 7}
    assert changed_text(TEXT, several).count("#") == TEXT.count("#") - 1


def test_what_cannot_be_edited_is_written_anew(monkeypatch):
    shared = "a: &one {x: 1}\nb: *one\n"
    for text, changes in (
        (shared, {("b", "x"): 2}),
        (shared, {("a",): 2}),
        ("{a: 1, b: 2}\n", {("a",): REMOVED}),
        ("a:\n  b: 1\nc: 2\n", {("a", "b"): REMOVED}),
    ):
        assert load_yaml(changed_text(text, changes)) == changed_content(load_yaml(text), changes) != load_yaml(text)
    # A planted error: the edit cuts off what follows the value.
    monkeypatch.setattr(study_text, "_end", lambda text, node: len(text))
    assert load_yaml(changed_text(TEXT, {("noise", "sd"): 4})) == {**load_yaml(TEXT), "noise": {"sd": 4, "unit": "um"}}


STUDY = "version: 1\nname: a\n# end of the head\n\ninputs:\n  E: {prior: {uniform: [1, 2]}}\n\n# numbers\nseed: 1\n"
INLINE = "next: {V_in: [25, 50]}\n"
LONGER = "# which rate\nnext:\n  V_in: [25, 50]\n  # and\n  together: 2\n"


def test_a_question_added_anywhere_leaves_the_digest_as_it_was_and_any_other_change_shows():
    for question in (INLINE, LONGER, "what_if:\n- {fix: {V_in: 2}}\n", "specimens: all/*.csv\n"):
        asked = [STUDY + "\n" + question]
        for before in ("inputs:\n", "# numbers\nseed"):
            head, found, tail = STUDY.partition(before)
            asked.append(head + question + "\n" + found + tail)
        for text in asked:
            assert QUESTION.sub("", text) == STUDY
            assert digest_of(text) == hashlib.sha256(STUDY.encode()).hexdigest()
    for old, new in {"seed: 1": "seed: 2", "# numbers": "# digits", "inputs": "next_inputs"}.items():
        assert digest_of(STUDY.replace(old, new) + INLINE) != digest_of(STUDY)
    for text in ("{version: 1, next: {V_in: [1]}}\n", "a: [", "a: 1\na: *b\n", "- next\n", "", "[" * 5000):
        assert QUESTION.sub("", text) == text


@pytest.fixture
def beam(tmp_path):
    folder = write_study(tmp_path / "beam", design={"sobol": {"runs": 8}}, executor=None)
    text = yaml.safe_dump(content(folder), sort_keys=False).replace("seed:", "# chosen by a die\nseed:")
    (folder / "study.yaml").write_text(f"# A beam that is bent.\n{text}# The end.\n")
    (folder / "notes.txt").write_text("mine")
    return folder


def content(folder):
    return yaml.safe_load((folder / "study.yaml").read_text())


def test_a_copy_lies_beside_the_study_and_keeps_comments_and_files(beam):
    (beam / "mine.json").write_text('{"study": "beam"}')
    (beam / "new-question.json").write_text('{"study": "beam", "study_sha256": "its digest"}')
    before = contents(beam)
    copy = changed_study(beam, ["seed=3", "noise={variance: 1.0e-4}"])
    assert sorted(contents(copy)) == ["mine.json", "notes.txt", "study.yaml"]
    assert copy == beam.with_name("beam-noise-variance-0.0001-seed-3")
    assert copy == changed_study(beam, ["noise={variance: 1.0e-4}", "seed=3"]), "the order does not matter"
    text = (copy / "study.yaml").read_text()
    assert text.startswith("# beam with noise={variance: 0.0001}, seed=3\n# A beam that is bent.\n")
    assert all(comment in text for comment in ("# chosen by a die", "# The end."))
    assert content(copy)["reuse"] == ["../beam"]
    assert (copy / "notes.txt").read_text() == "mine"
    assert contents(beam) == before
    assert sorted(path.name for path in beam.parent.iterdir()) == ["beam", copy.name]
    # Another file of the study makes the copy another study's.
    (beam / "notes.txt").write_text("changed")
    before = contents(copy)
    with pytest.raises(InvalidStudy, match=f"another study already: got {copy}, where notes.txt differs.*--into"):
        changed_study(beam, ["seed=3", "noise={variance: 1.0e-4}"])
    assert contents(copy) == before
    with pytest.raises(InvalidStudy, match=r"where study\.yaml differs"):
        changed_study(beam, ["seed=4"], copy)
    # No run of another model fits, but those of a function with the same fingerprint do.
    for function, reuse in (("undeclared_beam", []), ("beam", ["../beam"])):
        setting = f"model.python.function='strandline.testing.studies:{function}'"
        assert content(changed_study(beam, [setting]))["reuse"] == reuse


def test_a_long_name_is_shortened_the_same_way_each_time(beam):
    settings = [f"inputs.{name}.prior.uniform=[0.{'1' * 20}, 0.9]" for name in ("E", "tilt")]
    one = changed_study(beam, settings)
    assert one == changed_study(beam, settings)
    assert len(one.name) <= 63
    assert one != changed_study(beam, [*settings, "seed=2"])
    # Another folder is named after itself, and reuses the studies that the original does.
    write_study(beam.with_name("earlier"))
    (beam / "study.yaml").write_text((beam / "study.yaml").read_text() + "reuse: [../earlier]\n")
    (beam.parent / "below").mkdir()
    target = beam.parent / "below" / "other"
    assert changed_study(beam, ["seed=3"], target) == target
    found = content(target)
    assert found["reuse"] == ["../../beam", "../../earlier"]
    assert (found["name"], found["seed"]) == ("other", 3)
    # A section that is not there yet is made.
    assert content(changed_study(beam, ["surrogate.log_likelihood={}"]))["surrogate"] == {"log_likelihood": {}}


WRONG = {
    "noise": "--set: got noise; expected KEY=VALUE",
    "noise..sd=3": "--set: got noise..sd=3",
    "seed=[1": "--set seed: the value is not valid YAML: got [1",
    "seed.x=1": "--set seed.x: seed has no keys below it",
    "noise.varience=3": "--set: study.yaml: unknown key: got noise.varience",
    "seed=many": "--set: study.yaml: seed: got many; expected a whole number",
}


def test_what_is_refused_leaves_nothing_behind(beam):
    before = contents(beam.parent)
    for setting, told in WRONG.items():
        with pytest.raises(InvalidStudy, match=re.escape(told)):
            changed_study(beam, [setting])
    with pytest.raises(InvalidStudy, match=r"--set: got seed.*each key once"):
        changed_study(beam, ["seed=1", "seed=2"])
    for into in (".", "beam", "beam/below"):
        with pytest.raises(InvalidStudy, match="--into"):
            changed_study(beam, ["seed=3"], beam.parent / into)
    assert contents(beam.parent) == before


def test_keys_with_dots_and_a_planted_error(tmp_path, monkeypatch):
    """Planted: each dot begins another key."""
    name = "strandline.models.python:PythonModel"
    folder = write_study(tmp_path / "beam", model={name: {"function": "nowhere:f"}})
    setting = f"model.{name}.function=strandline.testing.studies:beam"
    found = content(changed_study(folder, [setting]))["model"]
    assert found == {name: {"function": "strandline.testing.studies:beam"}}
    monkeypatch.setattr(changed_copy, "_keys", lambda name, content: tuple(name.split(".")))
    with pytest.raises(InvalidStudy):
        changed_study(folder, [setting], tmp_path / "other")


def test_every_key_has_a_meaning_and_names_in_it_are_shown_once():
    keys = {key.name: key for key in listed(StudyFile)}
    assert [name for name, key in keys.items() if not key.meaning] == []
    assert {"surrogate.field", "executor.in_process", "noise.conditions.NAME", "next.together"} <= set(keys)
    assert keys["design.active.runs"].default == keys["noise.unknown.shift"].default.replace("0.0", "required")
