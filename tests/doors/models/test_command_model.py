"""The model that runs a command: what reaches the simulator, what counts as success, and what is kept."""

import shutil
import sys

import numpy as np
import pytest
from tests.unit.models.command.commands import ECHO, RESULT, filled, model, study

from strandline.cli.main import main
from strandline.models import WithFields
from strandline.parameters import GaussianField, Support
from strandline.runs import InProcess, RunRequest


@pytest.fixture
def folder(tmp_path):
    return filled(tmp_path / "study")


def outcome(made, a=1.0):
    (record,) = InProcess()(made, [RunRequest("0123456789abcdef", {"a": a})])
    return record


def points(record):
    assert record.ok, record.message
    return record.interface.points.tolist()


@pytest.mark.smoke
def test_numbers_reach_the_simulator_as_they_are_unless_a_template_formats_them(folder):
    for value in (0.1 + 0.2, 1e-300, -123456.789):
        assert points(outcome(model(folder), value))[1][1] == value
    (folder / "in.j2").write_text("{{ '%.2f' % a }}")
    assert points(outcome(model(folder), 1 / 3))[1][1] == 0.33


@pytest.mark.smoke
def test_command_and_environment_take_inputs_and_post_follows(folder):
    (folder / "run.sh").write_text('echo "$1 $B $0" > args.txt')
    (folder / "post.sh").write_text("printf 'x,y\\n0,0\\n1,2\\n' > out.csv; echo post")
    made = model(
        folder,
        files=["run.sh", "post.sh"],
        command=["/bin/sh", "run.sh", "-e={{ a }}; touch hacked"],
        environment={"B": "{{ a }}", "OMP_NUM_THREADS": 1},
        post=[["/bin/sh", "post.sh"], ["/bin/sh", "-c", "exit 0"]],
        keep="all",
    )
    assert outcome(made, 2.0).ok
    kept = folder / "runs" / "0123456789ab-1"
    assert (kept / "args.txt").read_text() == "-e=2.0; touch hacked 2.0 run.sh\n"
    assert not (kept / "hacked").exists()  # there is no shell that would see the semicolon
    assert (kept / "post-1.log").read_text() == "post\n"


@pytest.mark.smoke
def test_a_program_of_the_study_folder_that_cannot_start_says_what_lets_it_start(folder):
    for change, steps in (
        ({}, "write ./run.sh in the command, make it executable: chmod +x run.sh"),
        ({"files": []}, "add it to `files`, which copies it into the folder of the run, write ./run.sh"),
        ({"command": ["./run.sh"]}, "run.sh lies in the study folder: make it executable: chmod +x run.sh"),
        ({"command": ["no-such-program"]}, "No such file or directory"),
    ):
        record = outcome(model(folder, **{"command": ["run.sh"]} | change))
        assert record.failure_kind == "command_not_found"
        assert steps in record.message, record.message


@pytest.mark.smoke
def test_the_check_says_that_a_command_that_hangs_is_never_ended(tmp_path, capsys):
    for name, options in (("without", {}), ("with", {"timeout": 60})):
        main(["check", str(study(tmp_path / name, {"local": {"workers": 1}}, **options))])
        assert ("no timeout: a run that hangs is never ended" in capsys.readouterr().out) == (not options)


def test_a_shell_only_where_it_is_asked_for_and_its_characters_in_names_are_names(folder):
    command = "cp out.txt missing.txt || printf 'x,y\\n0,0\\n1,{{ a }}\\n' > out.csv"
    assert outcome(model(folder, command=command, shell=True)).ok
    name = "a; touch hacked $(id) `id`.csv"
    script = f"import shutil; open({name!r}, 'w').write('x,y\\n0,0\\n1,1\\n')"
    assert outcome(model(folder, command=[sys.executable, "-c", script], result=RESULT | {"file": name}, keep="all")).ok
    assert not list(folder.rglob("hacked"))


def test_several_conditions(folder):
    (folder / "run.sh").write_text(ECHO + "; sed s/1,/2,/ out.csv > high.csv")
    made = model(folder, result=None, results={"low": RESULT, "high": {"file": "high.csv", "unit": "m"}})
    assert outcome(made).interfaces["high"].points.tolist() == [[0.0, 0.0], [2000.0, 1000.0]]


NINE = {"post": ["/bin/sh", "-c", "exit 9"]}
OUTCOMES = [
    ({"success": {"log": "1.0"}}, None),
    ({"success": {"log": "Job finished"}}, "no_success"),
    ({"success": {"log": "0,0", "file": "job.sta"}}, "no_success"),
    ({"exit_codes": "any", **NINE}, None),
    (NINE, "exit_code"),
    ({"errors": {"gone": "0,0"}, "post": ["/bin/sh", "-c", "cat out.csv; exit 9"]}, "gone"),
    ({"result": RESULT | {"file": "input.txt"}}, "result_old"),
]


@pytest.mark.smoke
def test_what_counts_as_success(folder):
    for changes, kind in OUTCOMES:
        record = outcome(model(folder, **changes))
        assert (record.ok, record.failure_kind) == (kind is None, kind), changes


@pytest.mark.parametrize(("keep", "ok", "failed"), [("all", 1, 1), ("failed", 0, 1), ("none", 0, 0)])
def test_folders_are_kept_as_asked(tmp_path, capsys, keep, ok, failed):
    folder = study(tmp_path, keep=keep)
    outcome(model(folder, keep=keep))
    main(["forward", str(folder), "--set", "a=1"])
    assert len(list(folder.glob("runs/*"))) == 2 * ok
    record = outcome(model(folder, keep=keep, exit_codes=[3]))
    assert ("its folder: " in str(record.message)) == bool(failed)
    shutil.rmtree(folder / "runs", ignore_errors=True)
    (folder / "run.sh").write_text("exit 4")
    for name, *options in (["check"], ["forward", "--set", "a=1"]):
        with pytest.raises(SystemExit):
            main([name, str(folder), *options])
    kept = [(folder / "runs" / f"trial-{k}").resolve() for k in (1, 2) if failed]
    assert sorted(folder.glob("runs/*")) == kept
    told = capsys.readouterr().err
    assert told.count("its folder: /") == sum(f"its folder: {path} " in told for path in kept) == len(kept)


def test_templates_are_those_of_the_load_and_changed_files_are_noticed(folder):
    made = model(folder)
    (folder / "in.j2").write_text("{{ a * 100 }}")
    assert points(outcome(made))[1][1] == 1.0
    (folder / "run.sh").write_text("exit 1")
    assert outcome(made).failure_kind == "file_changed"


def test_templates_are_boxed_in(folder):
    for text in ("{{ ''.__class__.__mro__ }}", "{{ a.__init__.__globals__ }}", "{% include '/etc/hostname' %}"):
        (folder / "in.j2").write_text(text + "{{ a }}")
        record = outcome(model(folder))
        assert (record.state, record.failure_kind) == ("failed", "template")


@pytest.mark.smoke
def test_a_field_reaches_the_simulator_as_a_file(folder):
    (folder / "in.j2").write_text("{{ E_field }}")
    (folder / "run.sh").write_text('(echo x,y; awk \'{print $1","$4}\' "$(cat input.txt)") > out.csv')
    field = GaussianField(2.0, 0.3, 0.3, modes=3).on("E", Support.interval(0.0, 1.0, 20))
    at = dict(zip(field.names, [1.0, -0.5, 0.3], strict=True))
    (record,) = InProcess()(WithFields(model(folder), (field,)), [RunRequest("0123456789abcdef", at)])
    values = field.values(np.array([*at.values()]))
    np.testing.assert_allclose(points(record), np.column_stack([field.support.points[:, 0], values]), rtol=1e-12)
