"""Every refusal of the command line: code 2, one line with what is wrong, and a folder left as it was."""

import socket
from pathlib import Path

import numpy as np
import pytest
from tests.unit.cli.command_line import ALL_SET, Shown, contents, refused
from tests.unit.cli.ledgers import some_runs

from strandline.cli import main
from strandline.testing.studies import write_study

REFUSALS: dict[str, list[tuple[list[str], str]]] = {
    "": [
        (["rum", "study"], "No such command 'rum'. Did you mean run? See `strandline --help`."),
        (["what_if", "study"], "Did you mean what-if?"),
        (["xyzzy"], "No such command 'xyzzy'. See `strandline --help`."),
        (["run"], "'STUDY'. See `strandline run --help`."),
        (["run", "study", "--fast"], "'--fast'. Did you mean"),
        (["posterior", "check", "study", "--draws", "many"], "strandline posterior check --help"),
        (["init", ""], "an argument is empty: got ''"),
    ],
    "run": [
        (["empty"], "not a study folder"),
        (["wrong"], "unknown key: got colour; expected"),
        (["study", "--workers", "0"], "--workers"),
        (["study", "--device", "abacus"], "'abacus' is not one of 'cpu', 'gpu'"),
        (["study", "--verbose", "--quiet"], "got both; expected at most one of them"),
        (["study", "--log", "none/run.log"], "--log: got none/run.log: No such file"),
        (["study", "--into", "other"], "expected --set KEY=VALUE too"),
        (["study", "--set", "sed=3"], "--set: study.yaml: unknown key: got sed"),
        (["study", "--detach", "--quiet"], "--detach: got the executor LocalProcesses"),
    ],
    "check": [(["stiff"], "the medians of the priors failed: got large_deflection at load = 1, E = 430, tilt = 0.02")],
    "report": [(["study"], "0 of 65 forward runs done")],
    "retry": [(["study"], "--kind"), (["study", "--kind", "stalld"], "stalld")],
    "posterior": [(["check", "study", "--draws", "19"], "draws of the check: got 19")],
    "forward": [
        (["study", "--set", "E=400", "--set", "tild=0"], "--set.tild: the model has no such input: got tild"),
        (["study", "--set", "E=stiff"], "--set: got E=stiff; expected NAME=NUMBER"),
        (["study", "--set", "E=nan"], "--set: got E=nan; expected NAME=NUMBER"),
        (["study", "--set", "E=400", "--set", " E =500"], "--set: got E for the second time; expected each name once"),
        (["study", "--set", "E=-3", "--set", "tilt=0"], "--set.E: got -3"),
        (["study", "--set", "E=400"], "a value for tilt too. Add --set tilt=VALUE."),
        (["study", *ALL_SET, "--csv", "none/a.csv"], "--csv: got none/a.csv, in a folder that does not exist"),
        (["study", *ALL_SET, "--csv", "study"], "--csv: got study, a folder"),
        (["study", *ALL_SET, "--plot"], "--vtu and --plot: got PythonModel; expected a model that offers its fields"),
    ],
    "runs": [
        (["empty"], "no such file; expected a ledger. Run the study first"),
        (["study", "--state", "fine"], "got fine; expected one of ok, failed, timeout, killed, invalid, open, excl"),
        (["study", "--kind", "stalld"], "got stalld; expected one of limit_point, non_finite, stalled, timeout, wor"),
        (["study", "--show", "a"], "--show: got a; expected the beginning of the key of one run, not of 7"),
        (["study", "--show", "zz"], "--show: got zz: none of the 7 keys begins with zz; expected the beginning"),
        (["study", "--show", "aa1", "--state", "ok"], "--show: got another option with it"),
        (["study", "--show", "aa1", "--json"], "--show KEY alone"),
        (["study", "--limit", "0"], "--limit"),
        (["study", "--export", "runs.txt"], "expected a file name that ends with .csv or .nc"),
        (["study", "--export", "none/runs.csv"], "expected a file in a folder that exists"),
        (["study", "--export", "folder.nc"], "expected a file in a folder that exists"),
        (["study", "--export", "runs.csv", "--kind", "stalled"], "--export: got no run"),
        (["study", "--export", "runs.csv", "--json"], "--json prints the runs, --export writes them"),
        (["study", "--exclude", "aa1"], "expected --why REASON"),
        (["study", "--why", "odd"], "--why alone"),
        (["study", "--exclude", "aa1", "--include", "aa2", "--why", "odd"], "either --exclude KEY"),
        (["study", "--exclude", "aa1", "--why", "odd", "--state", "ok"], "either --exclude KEY"),
        (["study", "--exclude", "a", "--why", "odd"], "--exclude: got a; expected the beginning of the key of one"),
        (["study", "--include", "a"], "--include: got a; expected the beginning of the key of one"),
    ],
    "noise": [
        (["edge.csv", "--unit", "inch"], "--unit: got inch; expected one of mm"),
        (["none.csv", "--unit", "um"], "none.csv"),
        (["empty", "--unit", "um"], "folder of contours: got empty, without files"),
        (["edge.csv", "edge.csv", "--unit", "um", "--window", "100"], "--window: got 100 with 2 files"),
        (["edge.csv", "--unit", "um", "--read", "columns"], "--read: got columns; expected NAME=VALUE"),
        (["edge.csv", "--unit", "um", "--read", "colums=[x,y]"], "Did you mean columns?"),
    ],
    "init": [
        (["study"], "there is a study already"),
        (["study", "--example", "python"], "there is a study already"),
        (["edge.csv/study"], "the folder cannot be made"),
        (["new", "--example", "pendent-drop"], "Did you mean pendant-drop?"),
        (["new", "--example", "oct", "--unit", "mm", "--sd", "3"], "got --unit, --sd; expected --example alone"),
        (["new", "--sd", "3"], "--sd describes an observed interface: got none; expected --observed FILE too."),
        (["new", "--observed", "none.csv", "--unit", "mm", "--sd", "3"], "--observed: got none.csv; expected a file"),
        (["new", "--observed", "edge.csv", "--sd", "3"], "--unit of the observed interface: got nothing"),
        (["new", "--observed", "edge.csv", "--unit", "mm"], "--sd of the observed interface: got nothing"),
        (["new", "--observed", "edge.csv", "--unit", "mm", "--sd", "0"], "--sd: got 0; expected a number above 0"),
        (["new", "--observed", "edge.csv", "--unit", "mm", "--sd", "-1"], "'--sd': -1.0 is not in the range"),
        (["new", "--observed", "edge.csv", "--unit", "mm", "--sd", "few"], "'--sd': 'few' is not a valid"),
    ],
    "view": [(["none"], "none"), (["study", "--port", "70000"], "--port")],
    "what-if": [
        (["study", "--ask", "noise"], "--ask: got noise; expected keys with values"),
        (["study", "--seed", "-1"], "--seed"),
    ],
    "coverage": [(["study", "--from", "somewhere"], "--from"), (["study", "--seed", "-1"], "--seed")],
    "compare": [
        (["study", "study", "--seed", "-1"], "--seed"),
        (["study", "stiff", "--odds", "one"], "got one; expected numbers above 0"),
    ],
    "specimens": [
        (["study", "--watch", "--refine", "3"], "--watch makes no forward runs"),
        (["study", "--watch", "--processes", "2"], "--watch analyses one file at a time: leave out --processes."),
        (["study", "--processes", "0"], "--processes"),
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study that has some runs, others that are wrong, and files that are none."""
    home = tmp_path_factory.mktemp("home")
    some_runs(write_study(home / "study"))
    write_study(home / "wrong", colour="blue")
    write_study(home / "stiff", fixed={"load": 1.0})
    for name in ("empty", "folder.nc"):
        (home / name).mkdir()
    (home / "empty" / ".hidden").touch()
    np.savetxt(home / "edge.csv", [[x, x * (1 - x)] for x in np.linspace(0, 1, 40)], delimiter=",")
    return home


@pytest.mark.parametrize("command", REFUSALS)
def test_a_command_refuses_in_one_line(
    command: str, home: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(home)
    before = contents(home)
    for words, told in REFUSALS[command]:
        line = refused(capsys, *([command] if command else []), *words)
        assert told in line, (words, line)
        assert contents(home) == before, words


def test_a_folder_for_temporary_files_that_is_not_there(
    home: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(home)
    monkeypatch.setenv("TMPDIR", str(home / "none"))
    before = contents(home)
    for words in (["run", "study"], ["check", "study"], ["forward", "study", *ALL_SET]):
        line = refused(capsys, *words)
        assert f"TMPDIR = {home / 'none'}: No such file or directory" in line
        assert "Make the folder, or correct TMPDIR" in line
    assert contents(home) == before


def test_an_unknown_journal_is_refused_and_a_slow_one_told(
    home: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(home)
    monkeypatch.setenv("STRANDLINE_JOURNAL", "memory")
    assert "STRANDLINE_JOURNAL in the environment: got memory" in refused(capsys, "run", "study", "--quiet")
    for journal, words, lines in (("delete", [], 1), ("delete", ["--quiet"], 0), ("wal", [], 0)):
        monkeypatch.setenv("STRANDLINE_JOURNAL", journal)
        with pytest.raises(SystemExit):
            main(["run", "stiff", "--detach", *words])
        said = capsys.readouterr().err.splitlines()
        assert sum("rollback journal" in line for line in said) == lines


def test_a_port_in_use_is_refused(home: Path, capsys: Shown) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"port: got {port}: " in refused(capsys, "view", str(home / "study"), "--port", str(port))
