"""What all commands share: refusals in one line, signals."""

import shlex
import signal
import socket

import click
import pytest
from tests.unit.cli.command_line import contents, ends, refused
from tests.unit.cli.test_runs import some_runs

from strandline.cli import run
from strandline.cli.main import EndedBySignal, end_as_ctrl_c
from strandline.foundations import CampaignStopped, InvalidInput
from strandline.testing.studies import write_study

REFUSALS = {
    "rum study": "No such command 'rum'. Did you mean run? See `strandline --help`.",
    "run study --fast": "'--fast'. Did you mean",
    "run empty": "not a study folder",
    "doctor empty": "not a study folder",
    "run study --verbose --quiet": "--verbose shows more, --quiet less: leave one out",
    "run study --log none/run.log": "No such file or directory. See `strandline run --help`.",
    "run study --into other": "add --set KEY=VALUE",
    "run study --detach --quiet": "--detach: got the executor LocalProcesses",
    "check stiff": "the medians of the priors failed: got large_deflection at load = 1, E = 430, tilt = 0.02",
    "retry study --kind stalld": "stalld",
    "runs study --show zz": "See `strandline runs study` for the keys.",
    "forward study --set E=400 --set ' E =500'": "got E for the second time; expected each name once",
    "forward study --set E=400": "a value for tilt too. Add --set tilt=VALUE.",
    "runs empty": "no such file; expected a ledger. Run the study first",
    "runs study --kind stalld": "got stalld; expected one of limit_point, non_finite, stalled, timeout, wor",
    "runs study --show a": "--show: got a; expected the beginning of the key of one run, not of 7",
    "runs study --export runs.txt": "expected a file name that ends with .csv or .nc",
    "runs study --state done": "'done' is not one of 'ok', 'failed', 'timeout'",
    "runs study --exclude aa1": "--exclude needs --why REASON",
    "runs study --exclude aa1 --include aa1 --why x": "--exclude and --include do not go together",
    "runs study --show aa1 --limit 3": "--show and --limit do not go together",
    "runs study --why x": "--why is the reason for --exclude KEY or --include KEY",
    "runs study --export none/runs.csv": "No such file or directory; expected a folder with write permission",
    "runs study --export none/runs.nc": "expected a folder with write permission",
    "init study": "there is a study already",
    "init new --example pendent-drop": "Did you mean pendant-drop?",
    "init new --sd 3": "--sd: only for an observed interface; add --observed FILE",
    "init new --observed none.csv": "File 'none.csv' does not exist",
    "init new --observed study/study.yaml": "add --unit and --sd, such as --unit mm --sd 3 (µm)",
    "init new --observed study/study.yaml --unit mm --sd 0": "0.0 is not in the range x>0",
    "init new --observed study/study.yaml --unit mm --sd 1 --shift unknown": "'unknown' is not a valid float",
    "noise study/study.yaml": "Missing option '--unit'. Choose from: mm, um, µm, m. See",
    "noise study/study.yaml --unit inch": "'inch' is not one of 'mm', 'um', 'µm', 'm'",
    "noise empty --unit mm": "empty has no files",
    "forward study --set E=400 --set tilt=0 --csv none/edge.csv": "none/edge.csv is in a folder that does not exist",
    "forward study --set E=400 --set tilt=0 --plot": "--vtu and --plot draw the `fields` of a model",
    "forward study --set E=4x": "got E=4x; expected NAME=NUMBER, such as E=400",
    "forward study --set E=1e999": "got E=1e999; expected NAME=NUMBER, such as E=400",
    "what-if study --ask noise": "--ask: got noise; expected keys with values",
}


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A folder with a study that has some runs, another that is wrong, and a folder without one."""
    some_runs(write_study(tmp_path / "study"))
    write_study(tmp_path / "stiff", fixed={"load": 1.0})
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".hidden").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_command_refuses_in_one_line_and_leaves_the_folder_as_it_was(home, capsys, monkeypatch):
    before = contents(home)
    for words, told in REFUSALS.items():
        line = refused(capsys, *shlex.split(words))
        assert told in line, (words, line)
        assert contents(home) == before, words
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port: got {port}: " in refused(capsys, "view", "study", "--port", str(port))
    monkeypatch.setenv("TMPDIR", str(home / "none"))
    for command in ("run", "check"):
        assert f"TMPDIR = {home / 'none'}: No such file or directory" in refused(capsys, command, "study")
    assert contents(home) == before


@pytest.fixture
def handlers():
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_first_signal_counts(handlers):
    end_as_ctrl_c()
    with pytest.raises(EndedBySignal) as caught:
        signal.raise_signal(signal.SIGHUP)
    assert isinstance(caught.value, KeyboardInterrupt)
    assert caught.value.number == signal.SIGHUP
    signal.raise_signal(signal.SIGTERM)  # while everything is put in order


def test_nohup_is_heeded(handlers):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    end_as_ctrl_c()
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(EndedBySignal):
        signal.raise_signal(signal.SIGTERM)


def test_how_a_command_ends(handlers, capsys, monkeypatch):
    go_on = "; what is finished is kept; run the same command again to go on"
    for error, code, told in (
        (CampaignStopped("all runs failed"), 1, "all runs failed"),
        (KeyboardInterrupt(), 130, f"interrupted{go_on}"),
        (InvalidInput("x", value=1, expected="2", remedy="Go."), 2, "x: got 1; expected 2. Go."),
        (EndedBySignal(signal.SIGTERM), 143, f"interrupted by SIGTERM{go_on}"),
    ):

        @click.command("doctor")
        def command(error=error):
            raise error

        monkeypatch.setattr("strandline.cli.runs.doctor", command)
        assert ends("doctor") == code
        assert capsys.readouterr().err == f"strandline: {told}\n"


def test_the_shell_completes_the_keys_of_a_study_file():
    (option,) = (one for one in run.run.params if one.name == "settings")
    found = option.shell_complete(click.Context(run.run), "design.active.r")
    assert [(one.value, one.help[:22]) for one in found] == [("design.active.runs=", "Maximum number of runs")]
