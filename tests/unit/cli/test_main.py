"""What all commands share: refusals in one line, signals, completion of folders, colours."""

import shlex
import signal
import socket

import click
import numpy as np
import pytest
from tests.unit.cli.command_line import contents, ends, refused
from tests.unit.cli.test_runs import some_runs

from strandline.cli import results, signals
from strandline.cli.study_folder import STUDY
from strandline.errors import InvalidInput, NumericsError
from strandline.testing.studies import write_study

REFUSALS = {
    "rum study": "No such command 'rum'. Did you mean run? See `strandline --help`.",
    "run study --fast": "'--fast'. Did you mean",
    "init ''": "an argument is empty: got ''",
    "run empty": "not a study folder",
    "run study --verbose --quiet": "got both; expected at most one of them",
    "run study --log none/run.log": "--log: got none/run.log: No such file",
    "run study --into other": "expected --set KEY=VALUE too",
    "run study --detach --quiet": "--detach: got the executor LocalProcesses",
    "check stiff": "the medians of the priors failed: got large_deflection at load = 1, E = 430, tilt = 0.02",
    "retry study --kind stalld": "stalld",
    "forward study --set E=nan": "--set: got E=nan; expected NAME=NUMBER",
    "forward study --set E=400 --set ' E =500'": "--set: got E for the second time; expected each name once",
    "forward study --set E=400": "a value for tilt too. Add --set tilt=VALUE.",
    "forward study --set E=4 --set tilt=0 --csv none/a.csv": "--csv: got none/a.csv, in a folder that does not exist",
    "forward study --set E=4 --set tilt=0 --plot": "got PythonModel; expected a model that offers its fields",
    "runs empty": "no such file; expected a ledger. Run the study first",
    "runs study --state fine": "got fine; expected one of ok, failed, timeout, killed, invalid, open, excl",
    "runs study --kind stalld": "got stalld; expected one of limit_point, non_finite, stalled, timeout, wor",
    "runs study --show a": "--show: got a; expected the beginning of the key of one run, not of 7",
    "runs study --show aa1 --state ok": "--show: got another option with it",
    "runs study --export runs.txt": "expected a file name that ends with .csv or .nc",
    "runs study --export runs.csv --kind stalled": "--export: got no run",
    "runs study --export runs.csv --json": "--json prints the runs, --export writes them",
    "runs study --exclude aa1": "expected --why REASON",
    "runs study --why odd": "--why alone",
    "noise edge.csv --unit inch": "--unit: got inch; expected one of mm",
    "noise edge.csv edge.csv --unit um --window 100": "--window: got 100 with 2 files",
    "noise edge.csv --unit um --read columns": "--read: got columns; expected NAME=VALUE",
    "init study": "there is a study already",
    "init edge.csv/study": "the folder cannot be made",
    "init new --example pendent-drop": "Did you mean pendant-drop?",
    "init new --example oct --unit mm --sd 3": "got --unit, --sd; expected --example alone",
    "init new --observed edge.csv --sd 3": "--unit of the observed interface: got nothing",
    "init new --observed edge.csv --unit mm --sd 0": "--sd: got 0; expected a number above 0",
    "what-if study --ask noise": "--ask: got noise; expected keys with values",
    "compare study stiff --odds one": "got one; expected numbers above 0",
    "specimens study --watch --processes 2": "--watch analyses one file at a time: leave out --processes.",
}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder with a study that has some runs, another that is wrong, and files that are none."""
    some_runs(write_study(tmp_path / "study"))
    write_study(tmp_path / "stiff", fixed={"load": 1.0})
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".hidden").touch()
    np.savetxt(tmp_path / "edge.csv", [[x, x * (1 - x)] for x in np.linspace(0, 1, 40)], delimiter=",")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_command_refuses_in_one_line_and_leaves_the_folder_as_it_was(home, capsys):
    before = contents(home)
    for words, told in REFUSALS.items():
        line = refused(capsys, *shlex.split(words))
        assert told in line, (words, line)
        assert contents(home) == before, words
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port: got {port}: " in refused(capsys, "view", "study", "--port", str(port))


def test_the_environment_is_checked_before_any_run(home, capsys, monkeypatch):
    before = contents(home)
    with monkeypatch.context() as patch:
        patch.setenv("TMPDIR", str(home / "none"))
        for words in ("run study", "check study", "forward study --set E=400 --set tilt=0.02"):
            line = refused(capsys, *words.split())
            assert f"TMPDIR = {home / 'none'}: No such file or directory" in line
    assert contents(home) == before
    for journal, words, lines in (("delete", [], 1), ("delete", ["--quiet"], 0), ("wal", [], 0)):
        monkeypatch.setenv("STRANDLINE_JOURNAL", journal)
        ends("run", "stiff", "--detach", *words)
        assert capsys.readouterr().err.count("rollback journal") == lines


@pytest.fixture
def handlers():
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_first_signal_counts(handlers):
    signals.end_as_ctrl_c()
    with pytest.raises(signals.Ended) as caught:
        signal.raise_signal(signal.SIGHUP)
    assert isinstance(caught.value, KeyboardInterrupt)
    assert caught.value.number == signal.SIGHUP
    signal.raise_signal(signal.SIGTERM)  # while everything is put in order


def test_nohup_is_heeded(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals.end_as_ctrl_c()
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(signals.Ended):
        signal.raise_signal(signal.SIGTERM)


def test_how_a_command_ends(handlers, capsys, monkeypatch):
    go_on = "; what is finished is kept; run the same command again to go on"
    for error, code, told in (
        (NumericsError("the sum is nan"), 1, str(NumericsError("the sum is nan"))),
        (KeyboardInterrupt(), 130, f"interrupted{go_on}"),
        (click.Abort(), 130, f"interrupted{go_on}"),
        (InvalidInput("x", value=1, expected="2", remedy="Go."), 2, "x: got 1; expected 2. Go."),
        (signals.Ended(signal.SIGTERM), 143, f"interrupted by SIGTERM{go_on}"),
    ):

        @click.command("doctor")
        def command(error=error):
            raise error

        monkeypatch.setattr("strandline.cli.doctor.command", command)
        assert ends("doctor") == code
        assert capsys.readouterr().err == f"strandline: {told}\n"
    assert ends() == 2  # no command is a question for help
    assert capsys.readouterr().err.startswith("Usage: strandline")


def test_the_shell_completes_folders_with_a_study_and_warnings_are_coloured(tmp_path, monkeypatch):
    for name in ("beam", "bubble", "studies/inner"):
        write_study(tmp_path / name)
    (tmp_path / "bare").mkdir()
    monkeypatch.chdir(tmp_path)
    for text, expected in (
        ("b", [("beam", "plain"), ("bubble", "plain")]),
        ("bu", [("bubble", "plain")]),
        ("studies/", [("studies/inner", "plain")]),
        ("ba", [("ba", "dir")]),
        ("nowhere/", [("nowhere/", "dir")]),
    ):
        completed = STUDY.shell_complete(click.Context(click.Command("run")), click.Argument(["study"]), text)
        assert [(one.value, one.type) for one in completed] == expected
    # Warnings are coloured unless the user objects.
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert results._warned("warning: look out") == "\x1b[33mwarning: look out\x1b[0m"
    monkeypatch.setenv("NO_COLOR", "1")
    assert results._warned("warning: look out") == "warning: look out"
