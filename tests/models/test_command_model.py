"""The model that runs a command: what it renders, copies, refuses and keeps."""

import json
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.cli.main import main
from strandline.errors import ForwardModelError, InvalidInput, InvalidStudy
from strandline.models.command.model import CommandModel
from strandline.models.protocol import fingerprint
from strandline.runs import InProcess, LocalProcesses, RunRecord, RunRequest
from strandline.studies import load_study
from strandline.testing.studies import write_study

ECHO = "cat input.txt; printf 'x,y\\n0,0\\n1,%s\\n' \"$(cat input.txt)\" > out.csv"
OPTIONS: dict[str, Any] = {
    "templates": {"in.j2": "input.txt"},
    "command": ["/bin/sh", "run.sh"],
    "files": ["run.sh"],
    "result": {"file": "out.csv", "unit": "mm"},
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study folder with a template of one number and a simulator that writes it as a deflection."""
    inner = tmp_path / "study"
    inner.mkdir()
    (inner / "in.j2").write_text("{{ a }}")
    (inner / "run.sh").write_text(ECHO)
    return inner


def model(folder: Path, **changes: Any) -> CommandModel:
    options = {name: value for name, value in (OPTIONS | changes).items() if value is not None}
    return CommandModel.from_options(folder=folder, **options)


def outcome(made: CommandModel, **inputs: float) -> RunRecord:
    (record,) = InProcess()(made, [RunRequest("0123456789abcdef", inputs)])
    return record


@pytest.mark.parametrize("value", [0.1 + 0.2, 1e-300, -1 / 3, 12345678901234567.0, float(np.float64(0.7)), 5.0])
def test_numbers_reach_the_simulator_with_all_their_digits(folder: Path, value: float) -> None:
    record = outcome(model(folder), a=value)
    assert record.ok, record.message
    assert record.interface is not None
    assert record.interface.points[1, 1] == value


def test_a_template_may_format_them(folder: Path) -> None:
    (folder / "in.j2").write_text("{{ '%.2f' % a }}")
    record = outcome(model(folder), a=1 / 3)
    assert record.interface is not None
    assert record.interface.points[1, 1] == 0.33


def test_command_and_environment_take_inputs_and_post_follows(folder: Path) -> None:
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
    assert outcome(made, a=2.0).ok
    kept = folder / "runs" / "0123456789ab-1"
    assert (kept / "args.txt").read_text() == "-e=2.0; touch hacked 2.0 run.sh\n"
    assert not (kept / "hacked").exists()  # there is no shell that would see the semicolon
    assert (kept / "post-1.log").read_text() == "post\n"


def test_a_shell_only_where_it_is_asked_for(folder: Path) -> None:
    command = "cp out.txt missing.txt || printf 'x,y\\n0,0\\n1,{{ a }}\\n' > out.csv"
    assert outcome(model(folder, command=command, shell=True), a=3.0).ok
    with pytest.raises(InvalidInput, match="program and arguments as a list"):
        model(folder, command=command)
    with pytest.raises(InvalidInput, match="one text for /bin/sh"):
        model(folder, shell=True)


def test_names_with_the_characters_of_a_shell_are_names(folder: Path) -> None:
    name = "a; touch hacked $(id) `id`.csv"
    script = f"import shutil; open({name!r}, 'w').write('x,y\\n0,0\\n1,1\\n')"
    made = model(folder, command=[sys.executable, "-c", script], result={"file": name, "unit": "mm"}, keep="all")
    assert outcome(made, a=1.0).ok
    assert not list(folder.rglob("hacked"))


def test_several_conditions(folder: Path) -> None:
    (folder / "run.sh").write_text(ECHO + "; sed s/1,/2,/ out.csv > high.csv")
    results = {"low": {"file": "out.csv", "unit": "mm"}, "high": {"file": "high.csv", "unit": "m"}}
    made = model(folder, result=None, results=results)
    assert made.conditions == ("low", "high")
    record = outcome(made, a=1.0)
    assert record.interfaces["high"].points.tolist() == [[0.0, 0.0], [2000.0, 1000.0]]


@pytest.mark.parametrize(
    ("changes", "ok", "kind"),
    [
        ({"success": {"log": "1.0"}}, True, None),
        ({"success": {"log": "Job finished"}}, False, "no_success"),
        ({"success": {"log": "0,0", "file": "out.csv"}}, True, None),
        ({"success": {"log": "0,0", "file": "job.sta"}}, False, "no_success"),
        ({"exit_codes": [3]}, False, "exit_code"),
        ({"exit_codes": "any", "post": ["/bin/sh", "-c", "exit 9"]}, True, None),
        ({"exit_codes": [0, 9], "post": ["/bin/sh", "-c", "exit 9"]}, True, None),
        ({"post": ["/bin/sh", "-c", "exit 9"]}, False, "exit_code"),
        ({"result": {"file": "input.txt", "unit": "mm"}}, False, "result_old"),
    ],
)
def test_what_counts_as_success(folder: Path, changes: dict[str, Any], ok: bool, kind: str | None) -> None:
    record = outcome(model(folder, **changes), a=1.0)
    assert (record.ok, record.failure_kind) == (ok, kind)


@pytest.mark.parametrize(("keep", "ok", "failed"), [("all", 1, 1), ("failed", 0, 1), ("none", 0, 0)])
def test_folders_are_kept_as_asked(folder: Path, keep: str, ok: int, failed: int) -> None:
    outcome(model(folder, keep=keep), a=1.0)
    assert len(list(folder.glob("runs/*"))) == ok
    record = outcome(model(folder, keep=keep, exit_codes=[3]), a=1.0)
    assert len(list(folder.glob("runs/*"))) == ok + failed
    assert ("its folder: " in str(record.message)) == bool(failed)


def test_every_attempt_has_a_folder_of_its_own(folder: Path) -> None:
    (folder / "run.sh").write_text("test ! -e dirty && touch dirty && " + ECHO)
    made = model(folder, keep="all")
    assert all(outcome(made, a=1.0).ok for _ in range(3))
    assert sorted(path.name for path in folder.glob("runs/*")) == [f"0123456789ab-{k}" for k in (1, 2, 3)]


def test_the_fingerprint_follows_what_results_depend_on(folder: Path, tmp_path: Path) -> None:
    base = fingerprint(model(folder))
    same = tmp_path / "elsewhere"
    shutil.copytree(folder, same)
    assert fingerprint(model(same)) == base
    for harmless in ({"timeout": 9.0}, {"keep": "all"}, {"grace": 1.0}):
        assert fingerprint(model(folder, **harmless)) == base
    changes: list[dict[str, Any]] = [
        {"command": ["/bin/sh", "./run.sh"]},
        {"environment": {"A": "1"}},
        {"result": {"file": "out.csv", "unit": "m"}},
        {"result": {"file": "out.csv", "unit": "mm", "count": 2}},
        {"version": "2"},
        {"templates": {"in.j2": "input2.txt"}},
        {"post": ["true"]},
    ]
    prints = {base, *(fingerprint(model(folder, **change)) for change in changes)}
    for name, text in (("in.j2", "{{ a }} "), ("run.sh", ECHO + " ")):
        (folder / name).write_text(text)
        prints.add(fingerprint(model(folder)))
    assert len(prints) == 1 + len(changes) + 2


def test_templates_are_those_of_the_load_and_changed_files_are_noticed(folder: Path) -> None:
    made = model(folder)
    (folder / "in.j2").write_text("{{ a * 100 }}")
    record = outcome(made, a=1.0)
    assert record.interface is not None
    assert record.interface.points[1, 1] == 1.0
    (folder / "run.sh").write_text(ECHO)
    assert outcome(made, a=1.0).ok  # rewritten, but the same
    (folder / "run.sh").write_text("exit 1")
    assert outcome(made, a=1.0).failure_kind == "file_changed"
    (folder / "run.sh").unlink()
    assert outcome(made, a=1.0).failure_kind == "file_changed"


def test_it_travels_to_worker_processes_from_a_relative_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder.parent)
    made = model(Path("study"), keep="all")
    assert fingerprint(pickle.loads(pickle.dumps(made))) == fingerprint(made)
    (record,) = LocalProcesses(workers=1)(made, [RunRequest("key", {"a": 2.0})])
    assert record.ok, record.message
    assert (folder / "runs" / "key-1" / "input.txt").read_text() == "2.0"


@pytest.mark.parametrize(
    "name", ["../secret", "/etc/hostname", "link.txt", "sub/../../secret", "", ".", "linked/secret"]
)
@pytest.mark.parametrize("place", ["templates", "files"])
def test_no_source_leads_out_of_the_study_folder(folder: Path, name: str, place: str) -> None:
    (folder.parent / "secret").write_text("secret")
    (folder / "link.txt").symlink_to(folder.parent / "secret")
    (folder / "linked").symlink_to(folder.parent)
    change = {"templates": {name: "x.txt"}} if place == "templates" else {"files": [name]}
    with pytest.raises(InvalidInput, match=place):
        model(folder, **change)


@pytest.mark.parametrize("name", ["../x", "/tmp/x", "a/../../x", "", "a\nb", "..\\x", "dir/"])
def test_no_target_and_no_result_leads_out_of_the_runs_folder(folder: Path, name: str) -> None:
    with pytest.raises(InvalidInput, match="templates"):
        model(folder, templates={"in.j2": name})
    with pytest.raises(InvalidInput, match=r"result\.file"):
        model(folder, result={"file": name, "unit": "mm"})
    with pytest.raises(InvalidInput, match=r"success\.file"):
        model(folder, success={"log": "x", "file": name})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("line\n{{ b }}", "in.j2, line 2: unknown variable: got b; expected one of a, load, python"),
        ("{% if a > 1 %}\n\n{{ aa }}{% endif %}", "in.j2, line 3: unknown variable: got aa"),
        ("{{ a }\n", "in.j2, line 1"),
        ("{{ load }}", "the input a is used in no template"),
        ("{{ a }} \udcff", "cannot be read"),
    ],
)
def test_mistakes_in_templates_are_refused_at_load(tmp_path: Path, text: str, words: str) -> None:
    folder = study(tmp_path)
    (folder / "in.j2").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InvalidStudy) as caught:
        load_study(folder)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["{{ ''.__class__.__mro__[1].__subclasses__() }}", "{{ a.__init__.__globals__ }}", "{% include '/etc/hostname' %}"],
)
def test_templates_are_boxed_in(folder: Path, text: str) -> None:
    (folder / "in.j2").write_text(text + "{{ a }}")
    record = outcome(model(folder), a=1.0)
    assert (record.state, record.failure_kind) == ("failed", "template")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"result": None}, "either result"),
        ({"results": {"a": {"file": "a.csv", "unit": "mm"}}}, "either result"),
        ({"result": {"file": "a.csv"}}, "result.unit"),
        ({"keep": "some"}, "all, failed, none"),
        ({"timeout": 0.0}, "seconds above 0"),
        ({"exit_codes": [0.5]}, "a list such as [0, 1]"),
        ({"success": {"text": "x"}}, "{log: TEXT}"),
        ({"environment": {"A=B": "c"}}, "environment"),
        ({"command": []}, "program and arguments"),
        ({"command": ["a\0b"]}, "program and arguments"),
        ({"files": "run.sh"}, "a list of names"),
        ({"files": ["run.sh", "run.sh"]}, "for the second time"),
        ({"templates": {"in.j2": "command.log"}}, "written by strandline"),
        ({"inputs": {"a": {"min": 0}}}, "some of high, low, meaning, unit"),
        ({"inputs": {"a": {"low": 1, "high": 0}}}, "low below high"),
    ],
)
def test_options_that_cannot_be(folder: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput) as caught:
        model(folder, **changes)
    assert words in str(caught.value)


def study(tmp_path: Path, **changes: Any) -> Path:
    folder: Path = write_study(
        tmp_path / "s",
        model={"command": OPTIONS | changes},
        fixed={"load": 1.0},
        inputs={"a": {"prior": {"uniform": [1, 2]}, "unit": "Pa"}},
        observation={"synthetic": {"a": 1.5, "load": 1.0}},
    )
    (folder / "in.j2").write_text("{{ a }}")
    (folder / "run.sh").write_text(ECHO)
    return folder


def test_declared_inputs_are_checked(tmp_path: Path) -> None:
    declared = {"a": {"unit": "Pa", "low": 0}, "load": {}}
    assert load_study(study(tmp_path, inputs=declared)).space.names == ("a",)
    with pytest.raises(InvalidStudy, match="Pa"):
        load_study(study(tmp_path, inputs={**declared, "a": {"unit": "MPa"}}))
    with pytest.raises(InvalidStudy, match=r"in \[3, inf\]"):
        load_study(study(tmp_path, inputs={**declared, "a": {"unit": "Pa", "low": "3e0"}}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"templates": {"../in.j2": "x"}}, "model.command.templates"),
        ({"result": {"file": "../x.csv", "unit": "mm"}}, "model.command.result.file"),
        ({"folder": "elsewhere"}, "unknown option: got folder"),
        ({"comand": ["x"]}, "Did you mean command?"),
    ],
)
def test_the_command_line_refuses_with_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["check", str(study(tmp_path, **changes))])
    assert caught.value.code == 2
    assert words in capsys.readouterr().err


def test_check_shows_the_log_of_a_run_that_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = study(tmp_path)
    (folder / "run.sh").write_text("echo no licence; exit 4")
    with pytest.raises(SystemExit):
        main(["check", str(folder)])
    error = capsys.readouterr().err
    assert "last lines of the simulator's log:\nno licence\n" in error
    assert "exit_code at " in error
    assert (folder / "runs" / "trial-1" / "command.log").read_text() == "no licence\n"


@pytest.mark.parametrize("arguments", [["check"], ["forward", "--set", "a=1"]], ids=["check", "forward"])
@pytest.mark.parametrize(("keep", "failed", "ok"), [("failed", 1, 0), ("none", 0, 0), ("all", 1, 1)])
def test_single_runs_keep_folders_by_the_same_rule_and_say_so(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    keep: str,
    failed: int,
    ok: int,
) -> None:
    name, *options = arguments
    folder = study(tmp_path, keep=keep)
    main([name, str(folder), *options])
    assert len(list(folder.glob("runs/*"))) == ok
    shutil.rmtree(folder / "runs", ignore_errors=True)
    (folder / "run.sh").write_text("echo its folder: none; exit 4")
    with pytest.raises(SystemExit):
        main([name, str(folder), *options])
    assert len(list(folder.glob("runs/*"))) == failed
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("its folder: /")]
    kept = f"its folder: {(folder / 'runs' / 'trial-1').resolve()} (kept for a look; delete it at any time)"
    assert told == [kept] * failed


def test_check_tells_the_whole_of_what_a_result_lacks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = study(tmp_path)
    (folder / "run.sh").write_text("printf 'node,x,y\\n1,0,0\\n2,1,1\\n' > out.csv")
    with pytest.raises(SystemExit):
        main(["check", str(folder)])
    *_, line = capsys.readouterr().err.splitlines()
    assert "failed: got result_unreadable at load = 1, a = 1.5; expected" in line
    assert line.endswith(
        "; expected a run that ends with an interface. Look at the simulator, or move the priors to where it runs. It "
        "says: out.csv has no point in line 2: got 1 0 0; expected two numbers x, y. Say which of the 3 columns to take"
        ", by name or by number from 1, e.g. `columns: [x, y]`."
    )


@pytest.mark.parametrize("count", [None, 2])
def test_a_result_that_ends_within_a_line_is_not_whole_unless_its_points_are_counted(
    folder: Path, count: int | None
) -> None:
    (folder / "run.sh").write_text("printf 'x,y\\n0,0\\n1,0.1' > out.csv")  # of 0.125
    result = OPTIONS["result"] | ({} if count is None else {"count": count})
    record = outcome(model(folder, result=result), a=1.0)
    if count is not None:
        assert record.ok
        return
    assert (record.state, record.failure_kind) == ("invalid", "result_unreadable")
    assert "out.csv ends within a line: got 1,0.1; expected a line break at the end" in (record.message or "")


def test_a_result_with_decimal_commas(folder: Path) -> None:
    (folder / "run.sh").write_text("printf 'x;y\\n0;0\\n0,5;0,25\\n' > out.csv")
    assert outcome(model(folder), a=1.0).failure_kind == "result_unreadable"
    record = outcome(model(folder, result=OPTIONS["result"] | {"decimal": ","}), a=1.0)
    assert record.interface is not None
    assert record.interface.points.tolist() == [[0.0, 0.0], [0.5, 0.25]]


def test_tags_of_yaml_are_refused(tmp_path: Path) -> None:
    folder = study(tmp_path)
    text = json.dumps(json.loads((folder / "study.yaml").read_text()) | {"model": "MODEL"})
    tag = f'!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ["{tmp_path}/sprung"]]'
    (folder / "study.yaml").write_text(text.replace('"MODEL"', tag))
    with pytest.raises(InvalidStudy, match="not valid YAML"):
        load_study(folder)
    assert not (tmp_path / "sprung").exists()


def test_an_error_keeps_state_and_log_on_its_way() -> None:
    error = pickle.loads(pickle.dumps(ForwardModelError("k", "m", {"a": 1.0}, state="invalid", log="l")))
    assert (error.kind, error.message, error.evidence, error.state, error.log) == ("k", "m", {"a": 1.0}, "invalid", "l")
    assert ForwardModelError("timeout", "m").state == "timeout"
    assert ForwardModelError("other", "m").state == "failed"
