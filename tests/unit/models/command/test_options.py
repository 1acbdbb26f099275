"""The model that runs a command: what it refuses before a run, and what its fingerprint covers."""

import errno
import json
import pickle
import shutil
from pathlib import Path

import pytest
from tests.unit.models.command.commands import ECHO, RESULT, filled, model, study

from strandline.foundations import ForwardModelError, InvalidInput, InvalidStudy
from strandline.models.command import model as command_model
from strandline.models.command.options import InputTemplate, named_by
from strandline.models.identity import fingerprint
from strandline.models.protocol import declared_failure_kinds
from strandline.studies import load_study


@pytest.fixture
def folder(tmp_path):
    return filled(tmp_path / "study")


def test_the_fingerprint_follows_what_results_depend_on(folder, tmp_path):
    base = fingerprint(model(folder))
    assert fingerprint(model(Path(shutil.copytree(folder, tmp_path / "elsewhere")))) == base
    assert fingerprint(pickle.loads(pickle.dumps(model(folder)))) == base
    for harmless in ({"timeout": 9.0}, {"errors": {"diverged": "x"}}, {"keep": "all"}, {"grace": 1.0}):
        assert fingerprint(model(folder, **harmless)) == base
    changes = [
        {"command": ["/bin/sh", "./run.sh"]},
        {"environment": {"A": "1"}},
        {"result": RESULT | {"unit": "m"}},
        {"result": RESULT | {"count": 2}},
        {"version": "2"},
        {"templates": {"in.j2": "input2.txt"}},
        {"post": ["true"]},
    ]
    prints = {base, *(fingerprint(model(folder, **change)) for change in changes)}
    for name, text in (("in.j2", "{{ a }} "), ("run.sh", ECHO + " ")):
        (folder / name).write_text(text)
        prints.add(fingerprint(model(folder)))
    assert len(prints) == 1 + len(changes) + 2


def test_numbers_are_exact_or_have_twenty_characters():
    shown = InputTemplate("in.inp", "{{ a }}")
    for value in (0.1 + 0.2, 1e-300, -123456.789, 5.0):
        assert shown.rendered({"a": value}) == repr(value)
    for value in (3.141592653589793e-05, -1.2345678901234567e-05, -1.2345678901234567e-105):
        text = shown.rendered({"a": value})
        assert len(text) == 20
        assert float(text) == pytest.approx(value, rel=1e-12)


def test_no_name_leads_out_of_the_study_folder_or_the_runs(folder):
    (folder.parent / "secret").write_text("secret")
    (folder / "link.txt").symlink_to(folder.parent / "secret")
    (folder / "linked").symlink_to(folder.parent)
    for name in ("/etc/hostname", "link.txt", "sub/../../secret", "", ".", "linked/secret"):
        for place, change in (("templates", {"templates": {name: "x.txt"}}), ("files", {"files": [name]})):
            with pytest.raises(InvalidInput, match=place):
                model(folder, **change)
    for name in ("../x", "/tmp/x", "a/../../x", "", "a\nb", "..\\x", "dir/"):
        for place, change in (
            ("templates", {"templates": {"in.j2": name}}),
            (r"result\.file", {"result": {"file": name, "unit": "mm"}}),
            (r"success\.file", {"success": {"log": "x", "file": name}}),
        ):
            with pytest.raises(InvalidInput, match=place):
                model(folder, **change)


REFUSED = [
    ({"result": None}, "either result"),
    ({"result": {"file": "a.csv"}}, "result.unit"),
    ({"errors": {"exit_code": "x"}}, "a new word for each kind"),
    ({"errors": {"a b": "x"}}, "{diverged: no convergence}"),
    ({"command": "cp a b"}, "program and arguments as a list"),
    ({"shell": True}, "one text for /bin/sh"),
    ({"files": ["run.sh", "run.sh"]}, "for the second time"),
    ({"templates": {"in.j2": "command.log"}}, "written by strandline"),
    ({"inputs": {"a": {"low": 1, "high": 0}}}, "low below high"),
]


def test_options_that_cannot_be(folder):
    for changes, words in REFUSED:
        with pytest.raises(InvalidInput) as caught:
            model(folder, **changes)
        assert words in str(caught.value), changes


def test_a_text_in_the_log_names_the_kind_of_a_failure(folder, tmp_path):
    (tmp_path / "command.log").write_text("step 1\n  Newton: |r| = 1e30\nwrote restart file\nbye\n")
    made, failed = model(folder, errors={"stuck": "stagnates", "diverged": "|r|"}), ForwardModelError("timeout", "late")
    found = named_by(made.errors, tmp_path, failed)
    assert (found.kind, found.message, found.state) == ("diverged", "Newton: |r| = 1e30 (late)", "timeout")
    assert {"diverged", "exit_code"} <= {*declared_failure_kinds(pickle.loads(pickle.dumps(made)))}
    for other in (ForwardModelError("simulator_killed", "", state="killed"), failed):
        assert named_by({} if other is failed else made.errors, tmp_path, other) is other


def test_mistakes_in_templates_are_refused_at_load(tmp_path):
    folder = study(tmp_path)
    for text, words in (
        ("line\n{{ b }}", "in.j2, line 2: unknown variable: got b; expected one of a, load, python"),
        ("{{ a }\n", "in.j2, line 1"),
        ("{{ load }}", "the input a is used in no template"),
        ("{{ a }} \udcff", "cannot be read"),
    ):
        (folder / "in.j2").write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(InvalidStudy) as caught:
            load_study(folder)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_study_names_the_key_that_is_wrong_and_checks_declared_inputs(tmp_path):
    declared = {"a": {"unit": "Pa", "low": 0}, "load": {}}
    assert load_study(study(tmp_path, inputs=declared)).space.names == ("a",)
    for changes, words in (
        ({"inputs": {**declared, "a": {"unit": "MPa"}}}, "Pa"),
        ({"inputs": {**declared, "a": {"unit": "Pa", "low": "3e0"}}}, r"in \[3, inf\]"),
        ({"result": {"file": "../x.csv", "unit": "mm"}}, "model.command.result.file"),
        ({"folder": "elsewhere"}, "unknown option: got folder"),
    ):
        with pytest.raises(InvalidStudy, match=words):
            load_study(study(tmp_path, **changes))


def test_lack_of_memory_says_so_and_is_tried_again(folder, tmp_path):
    answer = {"exit_code": -9, "timeout": False, "tail": "", "left": 0, "out_of_memory": True}
    ended = command_model._ended(json.dumps(answer).encode(), 0, tmp_path / "log")
    with pytest.raises(ForwardModelError, match=r"solver ended with .* while the machine was out of memory") as caught:
        model(folder)._require_success(ended, "solver")
    assert (caught.value.kind, caught.value.state) == ("out_of_memory", "killed")
    answer = {"error": "Cannot allocate memory", "errno": errno.ENOMEM}
    with pytest.raises(ForwardModelError, match="Cannot allocate memory") as caught:
        command_model._ended(json.dumps(answer).encode(), 0, tmp_path / "log")
    assert (caught.value.kind, caught.value.state) == ("out_of_memory", "killed")
