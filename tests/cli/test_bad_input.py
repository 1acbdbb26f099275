"""Bad input: exit code 2, one line that says what, value, expected and remedy, and a folder left as it was."""

import contextlib
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from strandline.cli import main
from strandline.interface import Interface
from strandline.runs import Ledger
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, write_study

E: dict[str, Any] = BEAM_STUDY["inputs"]["E"]
BIOFILM: dict[str, Any] = {
    "model": {"biofilm": {"mesh": "coarse"}},
    "fixed": {"V_in": 100},
    "inputs": {
        "E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"},
        "nu": {"prior": {"uniform": [-0.8, 0.5]}},
    },
    "observation": {"synthetic": {"E": 400, "nu": 0.3, "V_in": 100}},
}


def inputs(**item: Any) -> dict[str, Any]:
    return {"inputs": {**BEAM_STUDY["inputs"], "E": {**E, **item}}}


def changed(**changes: Any) -> Callable[[Path], list[str]]:
    """Return a case: `strandline run` on a study with these changes."""
    return lambda folder: ["run", str(write_study(folder, **changes))]


def observed(text: str | None, unit: str | None = "mm") -> Callable[[Path], list[str]]:
    def case(folder: Path) -> list[str]:
        source = {"file": "observed.csv"} | ({"unit": unit} if unit else {})
        write_study(folder, observation=source)
        if text is not None:
            (folder / "observed.csv").write_text(text)
        return ["run", str(folder)]

    return case


def raw(text: str) -> Callable[[Path], list[str]]:
    def case(folder: Path) -> list[str]:
        folder.mkdir()
        (folder / "study.yaml").write_text(text)
        return ["run", str(folder)]

    return case


def forward(*options: str) -> Callable[[Path], list[str]]:
    return lambda folder: ["forward", str(write_study(folder)), *options]


@dataclass(frozen=True)
class Flat:
    """A measure that is the same for all interfaces, so that no noise of the points has a rule."""

    unit: ClassVar[str] = "mm²"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        return 1.0


def no_rule(folder: Path) -> list[str]:
    measure, noise = {f"{__name__}:Flat": {}}, {"sd": 3, "unit": "um"}
    return ["check", str(write_study(folder, discrepancy=measure, noise=noise))]


def no_study(folder: Path) -> list[str]:
    folder.mkdir()
    return ["run", str(folder)]


def study_file(folder: Path) -> list[str]:
    return ["run", str(write_study(folder) / "study.yaml")]


def foreign_ledger(folder: Path) -> list[str]:
    write_study(folder)
    Ledger.open(folder / "ledger.sqlite", model="biofilm:r2:mesh=default").close()
    return ["run", str(folder)]


def garbage_ledger(folder: Path) -> list[str]:
    write_study(folder)
    (folder / "ledger.sqlite").write_bytes(b"this is no ledger at all" * 200)
    return ["run", str(folder)]


def foreign_reuse(folder: Path) -> list[str]:
    write_study(folder / "other")
    Ledger.open(folder / "other" / "ledger.sqlite", model="biofilm:r2:mesh=default").close()
    return ["run", str(write_study(folder, reuse=["other"]))]


def unfinished_report(folder: Path) -> list[str]:
    return ["report", str(write_study(folder))]


def occupied_init(folder: Path) -> list[str]:
    return ["init", str(write_study(folder))]


def init_below_a_file(folder: Path) -> list[str]:
    folder.mkdir()
    (folder / "file").touch()
    return ["init", str(folder / "file" / "study")]


def free(**item: Any) -> dict[str, Any]:
    """Return inputs of a model that declares nothing, E changed."""
    return {"model": {"python": {"function": "strandline.testing.studies:undeclared_beam"}}} | inputs(**item)


def named(name: str) -> Callable[[Path], list[str]]:
    return changed(**{"inputs": {**BEAM_STUDY["inputs"], name: {"prior": {"uniform": [0, 1]}}}})


def quoted(old: str, new: str) -> Callable[[Path], list[str]]:
    """Return a case: the study's text with `old` replaced by what only YAML can say."""

    def case(folder: Path) -> list[str]:
        path = write_study(folder) / "study.yaml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return ["run", str(folder)]

    return case


def ledger_without(row: str) -> Callable[[Path], list[str]]:
    def case(folder: Path) -> list[str]:
        write_study(folder)
        path = folder / "ledger.sqlite"
        Ledger.open(path, model="test:beam-1").close()
        with contextlib.closing(sqlite3.connect(path)) as connection, connection:
            connection.execute("DELETE FROM meta WHERE key = ?", (row,))
        return ["run", str(folder)]

    return case


def deep_template(folder: Path) -> list[str]:
    command = {"templates": {"a.j2": "a"}, "command": ["true"], "result": {"file": "a.csv", "unit": "mm"}}
    write_study(folder, model={"command": command})
    (folder / "a.j2").write_text("{{ " + "(" * 3000 + "E" + ")" * 3000 + " }}")
    return ["run", str(folder)]


CASES: dict[str, tuple[Callable[[Path], list[str]], list[str]]] = {
    "unknown key": (changed(colour="blue"), ["unknown key: got colour", "Remove colour."]),
    "misspelt key": (changed(noise={"varience": 1e-4}), ["got noise.varience", "Did you mean variance?"]),
    "wrong type": (changed(design={"sobol": {"runs": "many"}}), ["design.sobol.runs: got many", "a whole number"]),
    "a truth value for a number": (changed(noise={"sd": True}), ["noise.sd: got True; expected a number"]),
    "key twice": (raw("version: 1\nname: a\nname: b\n"), ["line 3: a key for the second time: got name"]),
    "not YAML": (raw("version: 1\nname: [a\n"), ["line 3", "not valid YAML"]),
    "no version": (raw("name: a\n"), ["version: got nothing", "version: 1"]),
    "prior outside the box": (changed(**inputs(box=[300, 500])), ["prior of E", "box [300, 500]", "Widen the box"]),
    "prior without a box": (changed(**inputs(prior={"normal": [400, 50]})), ["Give E a box"]),
    "nu above 0.5": (
        changed(**BIOFILM | {"inputs": BIOFILM["inputs"] | {"nu": {"prior": {"uniform": [-0.8, 0.6]}}}}),
        ["inputs.nu", "got 0.6", "(-1, 0.5]", "Poisson's ratio"],
    ),
    "negative E": (
        changed(**inputs(prior={"uniform": [-100, 560]})),
        ["inputs.E", "got -100", "(0, inf] Pa", "Young's modulus"],
    ),
    "unit missing": (changed(**inputs(unit=None)), ["unit of inputs.E: got nothing", "Write `unit: Pa`"]),
    "wrong unit": (changed(**inputs(unit="kPa")), ["unit of inputs.E: got kPa; expected Pa"]),
    "unit of the observation missing": (observed("0,0\n1,1\n", None), ["unit of the coordinates", "`unit: mm`"]),
    "observation missing": (observed(None), ["observation observed.csv is missing"]),
    "observation empty": (observed(""), ["observation observed.csv holds no points"]),
    "observation of one point": (observed("x,y\n0,0\n"), ["too few points", "got 1 point(s)"]),
    "observation crosses itself": (observed("0,0\n1,1\n1,0\n0,1\n"), ["crosses itself", "(0.5, 0.5) mm"]),
    "observation with NaN": (observed("0,0\nnan,1\n2,0\n"), ["point 1", "not finite"]),
    "observation of three columns": (observed("0,0,0\n1,1,1\n"), ["line 1", "got 0 0 0"]),
    "not a study folder": (no_study, ["not a study folder", "strandline init"]),
    "the file instead of the folder": (study_file, ["not a study folder", "Give the folder"]),
    "ledger of another model": (foreign_ledger, ["another model", "biofilm:r2:mesh=default in the ledger"]),
    "ledger that is none": (garbage_ledger, ["damaged or not a ledger", "Restore it"]),
    "reused ledger of another model": (foreign_reuse, ["other/ledger.sqlite keeps the runs of another model"]),
    "reused folder missing": (changed(reuse=["../none"]), ["reuse: got ../none"]),
    "design smaller than the surrogate needs": (
        changed(design={"sobol": {"runs": 3}}),
        ["design.sobol.runs: got 3", "at least 4 runs for 2 input(s)"],
    ),
    "Python model missing": (changed(model={"python": {"function": "nowhere:f"}}), ["got nowhere:f", "PYTHONPATH"]),
    "check of an unfinished posterior": (
        lambda folder: ["posterior", "check", str(write_study(folder))],
        ["no posterior to check: got a study that is not finished", "strandline run"],
    ),
    "check with too few draws": (
        lambda folder: ["posterior", "check", str(write_study(folder)), "--draws", "19"],
        ["draws of the check: got 19; expected from 20"],
    ),
    "draws not a number": (
        lambda folder: ["posterior", "check", str(write_study(folder)), "--draws", "many"],
        ["--draws", "strandline posterior check --help"],
    ),
    "report of an unfinished study": (unfinished_report, ["0 of 65 forward runs done", "strandline run"]),
    "init over a study": (occupied_init, ["there is a study already", "Choose another folder"]),
    "init below a file": (init_below_a_file, ["folder cannot be made"]),
    "--set of an unknown name": (
        forward("--set", "E=400", "--set", "tild=0"),
        ["--set.tild", "got tild", "Did you mean tilt?"],
    ),
    "--set without a number": (forward("--set", "E=stiff"), ["--set: got E=stiff", "NAME=NUMBER"]),
    "--set twice": (forward("--set", "E=400", "--set", "E=500"), ["E for the second time", "each name once"]),
    "--set of NaN": (forward("--set", "E=nan"), ["--set: got E=nan"]),
    "--set out of range": (forward("--set", "E=-3", "--set", "tilt=0"), ["--set.E: got -3", "(0, inf] Pa"]),
    "--set forgotten": (forward("--set", "E=400"), ["a value for tilt too", "Add --set tilt=VALUE."]),
    "--csv in a folder that is not there": (
        lambda folder: [*forward(*ALL_SET)(folder), "--csv", str(folder / "none" / "a.csv")],
        ["--csv: got", "in a folder that does not exist", "Choose another path."],
    ),
    "--csv onto a folder": (lambda folder: [*forward(*ALL_SET)(folder), "--csv", str(folder)], ["--csv", "a folder"]),
    "unknown command": (lambda folder: ["rum", str(write_study(folder))], ["rum", "strandline --help"]),
    "unknown option": (lambda folder: ["run", str(write_study(folder)), "--fast"], ["--fast", "strandline run --help"]),
    "no argument": (lambda folder: ["run"], ["STUDY", "strandline run --help"]),
    "5000 brackets": (raw("version: 1\nname: " + "[" * 5000), ["study.yaml, line 2", "at most 40"]),
    "no truth value": (quoted('"seed": 1', '"seed": !!bool maybe'), ["'maybe', which is no bool"]),
    "a number with an underscore": (
        quoted('"runs": 64', '"runs": 6_4'),
        ["design.sobol.runs: got 6_4", "a whole number"],
    ),
    "a number in quotes": (changed(design={"sobol": {"runs": "80"}}), ["design.sobol.runs: got 80", "without quotes"]),
    "Arabic digits": (changed(noise={"sd": "١٢"}), ["noise.sd: got ١٢", "a number"]),
    "Arabic digits as an option": (changed(discrepancy={"currents": {"width": "١"}}), ["currents.width: got ١"]),
    "lognormal of 1000": (
        changed(**inputs(prior={"lognormal": [1000, 1]}, box=[300, 560])),
        ["inputs.E.prior.lognormal", "mu", "got 1000.0", "mean of log x"],
    ),
    "1e12 runs": (changed(design={"sobol": {"runs": 1e12}}), ["design.sobol.runs", "equal to 1000000"]),
    "2147483648 runs": (changed(design={"sobol": {"runs": 2**31}}), ["design.sobol.runs", "equal to 1000000"]),
    "10^30 runs": (changed(design={"active": {"runs": 10**30}}), ["design.active.runs", "equal to 1000000"]),
    "noise of 1e200": (changed(noise={"sd": 1e200}), ["noise: got", "from 1e-30 to 1e+30"]),
    "noise of 1e-200": (changed(noise={"sd": 1e-200}), ["noise: got", "from 1e-30 to 1e+30"]),
    "timeout of 1e9": (changed(executor={"local": {"timeout": 1e9}}), ["local.timeout", "at most 31622400 (a year)"]),
    "timeout of 1e300": (changed(executor={"local": {"timeout": 1e300}}), ["local.timeout", "31622400 (a year)"]),
    "reuse of 5000 characters": (changed(reuse=["a" * 5000]), ["reuse: got aaa", "the folder of another study"]),
    "width of 1e300": (changed(discrepancy={"currents": {"width": 1e300}}), ["width", "from 1e-09 to 1e+09"]),
    "1e9 lines": (changed(discrepancy={"measurement_lines": {"lines": 10**9}}), ["1000000000 lines", "1 to 100000"]),
    "NUL in a file name": (changed(observation={"file": "a\0b.csv", "unit": "mm"}), ["line ", "got \\x00"]),
    "ledger without its version": (ledger_without("schema_version"), ["damaged", "no row schema_version"]),
    "ledger without its model": (ledger_without("model"), ["damaged", "no row model"]),
    "template of 3000 parentheses": (deep_template, ["the template a.j2 cannot be compiled"]),
    "newline in a name": (named("a\nb"), ["inputs.a b", "a short name on one line"]),
    "slash in a name": (named("a/b"), ["inputs.a/b", "without /"]),
    "reserved name": (named("draw"), ["inputs.draw", "none of the names that the results use"]),
    "reserved name of a free model": (
        changed(**free() | {"inputs": {"weight": E, **BEAM_STUDY["inputs"]}}),
        ["inputs.weight", "the names that the results use themselves"],
    ),
    "unit of a formula": (changed(**free(unit="$\\frac{$")), ["inputs.E.unit: got $\\frac{$", "without $"]),
    "prior of 1e308": (changed(**free(prior={"uniform": [-1e308, 1e308]})), ["uniform", "at most 1e+100"]),
    "prior of one ulp": (
        changed(**free(prior={"uniform": [400, 400.00000000000006]})),
        ["uniform", "differ by at least"],
    ),
    "two ways of learning": (
        changed(design={"active": {"runs": 60}}, surrogate={"log_likelihood": {}}),
        ["design and surrogate do not fit together: got an active design with a surrogate of the log-likelihood;"],
    ),
    "batch larger than the budget": (
        changed(design={"active": {"runs": 60, "batch": 100}}),
        ["design.active.batch: got 100", "at most 52"],
    ),
    "measure without a rule": (no_rule, ["noise of Flat", "a noise variance for such errors", "normal_offset"]),
    "init without a name": (lambda folder: ["init", ""], ["an argument is empty: got ''"]),
    "workers not a number": (lambda folder: [*changed()(folder), "--workers", "0"], ["--workers"]),
}
ALL_SET = ("--set", "E=400", "--set", "tilt=0")


def contents(folder: Path) -> dict[str, bytes | None]:
    """Names and bytes, but for the files that SQLite lays beside a ledger in order to read it."""
    paths = [path for path in folder.rglob("*") if not path.name.endswith(("-wal", "-shm"))]
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in paths}


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command line, which must end with code 2 and one line; return the line."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    shown = capsys.readouterr()
    assert ended.value.code == 2
    assert shown.out == ""
    return one_line(shown.err)


def one_line(text: str) -> str:
    lines = text.splitlines()
    assert len(lines) == 1, text
    assert lines[0].startswith("strandline: ")
    assert "Traceback" not in lines[0]
    return lines[0]


@pytest.mark.parametrize("case", CASES)
def test_bad_input(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    build, words = CASES[case]
    arguments = build(tmp_path / "study")
    before = contents(tmp_path)
    line = refused(arguments, capsys)
    for word in words:
        assert word in line
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        (
            "every run failed",
            {"fixed": {"load": 1.0}, "design": {"sobol": {"runs": 6}}},
            ["every forward run failed: got 0 of 6 (6 × large_deflection; e.g. the tip would move by", "at least 4"],
        ),
        (
            "too few successful runs",
            {**inputs(prior={"uniform": [1, 100]}), "design": {"sobol": {"runs": 4}}},
            ["too few successful forward runs: got 2 of 4 (2 × large_deflection", "Enlarge the design"],
        ),
        (
            "synthetic observation fails",
            {"observation": {"synthetic": {"E": 400, "tilt": 0, "load": 1}}},
            ["synthetic observation could not be made: got large_deflection at E = 400, tilt = 0, load = 1"],
        ),
    ],
)
def test_runs_that_fail_are_kept_and_nothing_else_is_written(
    name: str, changes: dict[str, Any], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_study(tmp_path / "study", **changes)
    line = refused(["run", str(folder), "--quiet"], capsys)
    for word in words:
        assert word in line
    assert sorted(contents(folder)) == ["ledger.lock", "ledger.sqlite", "study.yaml"]


def test_check_tells_of_a_failed_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "study", fixed={"load": 1.0})
    line = refused(["check", str(folder)], capsys)
    assert "the forward run at the medians of the priors failed: got large_deflection at load = 1, E = 430" in line
    assert sorted(contents(folder)) == ["study.yaml"]


@contextmanager
def another_driver(folder: Path) -> Iterator[int]:
    """Keep the study's ledger open in another process; give its process id."""
    code = (
        "import sys, pathlib; from strandline.runs import Ledger\n"
        f"with Ledger.open(pathlib.Path({str(folder / 'ledger.sqlite')!r}), model='test:beam-1'):\n"
        "    print('open', flush=True); sys.stdin.read()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stdout.readline() == b"open\n"
    try:
        yield process.pid
    finally:
        process.stdin.close()
        process.wait(10)
        process.stdout.close()


def test_second_driver(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_study(tmp_path / "study")
    with another_driver(folder) as pid:
        before = contents(folder)
        line = refused(["run", str(folder), "--quiet"], capsys)
        assert "ledger.sqlite is locked" in line
        assert f"process {pid} on " in line
        assert "Wait for the other run to end" in line
        assert contents(folder) == before
        main(["status", str(folder)])
        assert "0 of 64 runs" in capsys.readouterr().out


def denied(arguments: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process that permissions bind, the superuser's too."""
    command = [sys.executable, "-c", "from strandline.cli import main; main()", *arguments]
    if os.geteuid() == 0:
        tool = shutil.which("setpriv")
        if tool is None:
            pytest.skip("the superuser passes all permissions, and there is no setpriv to drop that right")
        command = [tool, "--bounding-set=-dac_override", "--inh-caps=-dac_override", *command]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


@pytest.mark.parametrize("subcommand", ["run", "check"])
def test_unwritable_folder(subcommand: str, tmp_path: Path) -> None:
    folder = write_study(tmp_path / "study")
    before = contents(folder)
    folder.chmod(0o555)
    try:
        ended = denied([subcommand, str(folder)])
    finally:
        folder.chmod(0o755)
    assert ended.returncode == 2
    assert ended.stdout == ""
    line = one_line(ended.stderr)
    assert f"the study folder cannot be written to: got {folder}: Permission denied" in line
    assert "copy the study elsewhere" in line
    assert contents(folder) == before


def test_csv_without_permission_is_found_before_the_run(tmp_path: Path) -> None:
    """The load would fail the run, which would be told instead had it been made."""
    folder = write_study(tmp_path / "study")
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    csv = str(closed / "a.csv")
    ended = denied(["forward", str(folder), *ALL_SET, "--set", "load=1", "--csv", csv])
    assert ended.returncode == 2
    assert "without write permission" in one_line(ended.stderr)


def test_a_wrong_input_in_a_real_process_ends_with_code_2(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from strandline.cli import main; main()", "run", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert "not a study folder" in one_line(ended.stderr)


@pytest.mark.parametrize("subcommand", [["run"], ["check"], ["forward", "--set", "E=400", "--set", "tilt=0"]])
def test_temporary_folder_missing(
    subcommand: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_study(tmp_path / "study")
    before = contents(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "none"))
    line = refused([subcommand[0], str(folder), *subcommand[1:]], capsys)
    assert f"TMPDIR = {tmp_path / 'none'}: No such file or directory" in line
    assert "Make the folder, or correct TMPDIR" in line
    assert contents(tmp_path) == before


def test_merge_keys_work(tmp_path: Path) -> None:
    path = write_study(tmp_path / "study") / "study.yaml"
    text = path.read_text().rstrip()[:-1] + ', "executor": {"local": &a {"workers": 1}}}'
    text = text.replace('"executor": {\n    "local": {\n      "workers": 1,\n      "timeout": 60\n    }\n  },', "", 1)
    path.write_text(text.replace('"smc": {', '"smc": {<<: {"particles": 300}, ', 1).replace('"particles": 4000,', ""))
    assert load_study(path.parent).settings.particles == 300
