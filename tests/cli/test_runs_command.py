"""`strandline runs`: the list, its filters, one run in full, exports, and what is refused."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from strandline.cli import main
from strandline.interface import Interface
from strandline.models.command.model import CommandModel
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest
from strandline.runs.overview import STATES
from strandline.runs.record import with_log
from strandline.testing.models import Cantilever, TwoLoads

LINE = Interface.polyline(np.arange(8.0).reshape(4, 2))
LOG = "a\nlog"
RECORDS = [
    RunRecord("aa1", {"E": 400.0, "nu": 1 / 3}, "ok", {"": LINE}, {"tip": 0.125}, 1.25),
    RunRecord("aa2", {"E": 300.0, "nu": 0.25}, "failed", {}, {"load": 0.5}, 2.5, "stalled", 'no "end",\nlong', LOG),
    RunRecord("ab3", {"E": 301.0, "nu": 0.25}, "failed", {}, {}, 3.5, "limit_point", "bends"),
    RunRecord("ac4", {"E": 302.0, "nu": 0.25}, "timeout", seconds=60.0, failure_kind="timeout"),
    RunRecord("ad5", {"E": 303.0, "nu": 0.25}, "killed", failure_kind="worker_died"),
    RunRecord("ae6", {"E": 304.0, "nu": 0.25}, "invalid", failure_kind="non_finite"),
]  # fmt: skip


def keep(folder: Path, records: list[RunRecord], *open_runs: RunRequest) -> Path:
    folder.mkdir(exist_ok=True)
    with Ledger.open(folder / "ledger.sqlite", model="m") as ledger:
        for record in records:
            ledger.started(RunRequest(record.key, record.inputs))
            ledger.finished(record)
        for request in open_runs:
            ledger.started(request)
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    again = RunRequest("aa2", RECORDS[1].inputs)
    return keep(tmp_path / "study", RECORDS, RunRequest("af7", {"E": 305.0, "nu": 0.25}), again)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    main(["runs", *arguments])
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


def listed(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[list[str]]:
    """Return the rows of the list, and last its number of runs."""
    heading, *lines = printed(capsys, *arguments).splitlines()
    assert heading.split()[:4] == ["key", "state", "kind", "seconds"]
    return [line.split() for line in lines]


def test_the_list_is_in_the_order_of_the_last_start(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, str(folder)).splitlines()
    assert shown == [
        "key  state    kind         seconds    E        nu",
        "aa1  ok       -              1.250  400  0.333333",
        "ab3  failed   limit_point    3.500  301      0.25",
        "ac4  timeout  timeout       60.000  302      0.25",
        "ad5  killed   worker_died    0.000  303      0.25",
        "ae6  invalid  non_finite     0.000  304      0.25",
        "af7  open     -                  -  305      0.25",
        "aa2  open     -                  -  300      0.25",
        "7 of 7 runs",
    ]


@pytest.mark.parametrize("state", STATES)
def test_only_one_state(folder: Path, state: str, capsys: pytest.CaptureFixture[str]) -> None:
    expected = {"open": ["af7", "aa2"], "failed": ["ab3"]}
    expected |= {r.state: [r.key] for r in RECORDS if r.state != "failed"}
    *rows, last = listed(capsys, str(folder), "--state", state)
    assert [row[0] for row in rows] == expected[state]
    assert last == [str(len(rows)), "of", "7", "runs"]


def test_only_one_kind_and_the_last_few(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert [row[0] for row in listed(capsys, str(folder), "--kind", "non_finite")[:-1]] == ["ae6"]
    assert [row[0] for row in listed(capsys, str(folder), "--kind", "stalled")] == ["0"]  # that run is open again
    assert [row[0] for row in listed(capsys, str(folder), "--limit", "3")[:-1]] == ["ae6", "af7", "aa2"]
    assert [row[0] for row in listed(capsys, str(folder), "--limit", "1", "--state", "ok")[:-1]] == ["aa1"]


def test_one_run_in_full(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, str(folder), "--show", "aa1").splitlines()
    assert [line for line in shown if not line.startswith("started: ")] == [
        "key: aa1",
        "state: ok",
        "E = 400.0",
        "nu = 0.3333333333333333",
        "seconds: 1.25",
        "tip: 0.125",
    ]


def test_a_run_that_is_open_again_shows_how_it_ended_before(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = printed(capsys, str(folder), "--show", "aa2").splitlines()
    assert shown[1] == "state: open"
    assert shown[2].endswith("(start 2 of this run)")
    assert shown[5:] == [
        "before: failed, stalled",
        "seconds: 2.5",
        "load: 0.5",
        "message:",
        '  no "end",',
        "  long",
        "log:",
        "  a",
        "  log",
    ]
    assert "before" not in printed(capsys, str(folder), "--show", "af7")


def test_seconds_and_log_of_a_command_out_of_time_are_shown_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    command = ["/bin/sh", "-c", "seq 12; sleep 60"]
    slow = CommandModel(command, result={"file": "out.csv", "unit": "mm"}, timeout=0.5, folder=folder)
    (record,) = InProcess()(slow, [RunRequest("aa1", {"E": 1.0})])
    shown = printed(capsys, str(keep(folder, [record])), "--show", "aa1").splitlines()
    assert shown[1] == "state: timeout, timeout"
    assert shown[4:] == [
        f"seconds: {record.seconds:.6g}",
        "message:",
        "  still running after 0.5 s, and ended with all its processes",
        f"  its folder: {folder / 'runs' / 'aa1-1'}",
        "log:",
        *(f"  {number}" for number in range(1, 13)),
    ]


def test_a_message_with_the_end_of_another_log_is_shown_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = with_log(with_log(RECORDS[2], "of the command\n"), "of the worker\n")
    shown = printed(capsys, str(keep(tmp_path / "study", [record])), "--show", "ab3").splitlines()
    lines = ["  bends", "  last lines of its log:", "  of the command", "log:", "  of the worker"]
    assert shown[-5:] == lines


def test_a_csv_holds_all_of_it(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "runs.csv"
    assert printed(capsys, str(folder), "--export", str(path)) == f"wrote {path}: 7 runs\n"
    with path.open(encoding="utf-8", newline="") as stream:
        rows = {row["key"]: row for row in csv.DictReader(stream)}
    assert list(rows) == ["aa1", "ab3", "ac4", "ad5", "ae6", "af7", "aa2"]
    for record in RECORDS:
        row = rows[record.key]
        assert {name: float(row[f"input.{name}"]) for name in record.inputs} == record.inputs
        if record.key != "aa2":
            assert (row["state"], row["kind"]) == (record.state, record.failure_kind or "")
            assert float(row["seconds"]) == record.seconds
            assert row["message"] == (record.message or "").split("\n")[0]
    assert (rows["aa1"]["diagnostic.tip"], rows["ab3"]["diagnostic.tip"]) == ("0.125", "")
    assert (rows["aa2"]["state"], rows["aa2"]["seconds"]) == ("open", "")


def test_a_csv_holds_the_chosen_ones(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "runs.csv"
    printed(capsys, str(folder), "--export", str(path), "--kind", "limit_point")
    assert path.read_text().splitlines() == [
        "key,state,kind,seconds,message,input.E,input.nu",
        "ab3,failed,limit_point,3.5,bends,301.0,0.25",
    ]


def two_loads(folder: Path, modulus: list[float]) -> tuple[Path, list[RunRecord]]:
    model, records = TwoLoads(Cantilever(nodes=5)), []
    for number, value in enumerate(modulus):
        inputs = {"E": value, "load": 1e-5}
        run = model(inputs, folder)
        records.append(RunRecord(f"k{number}", inputs, "ok", run.interfaces, run.diagnostics, 0.5))
    bad = RunRecord("bad", {"E": -1.0, "load": 1e-5}, "failed", failure_kind="nonpositive_stiffness", message="E\nx")
    return keep(folder, [records[0], bad, *records[1:]]), records


def test_a_netcdf_holds_the_interfaces_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, records = two_loads(tmp_path / "study", [300.0, 400.0])
    path = tmp_path / "runs.nc"
    assert printed(capsys, str(folder), "--export", str(path)) == f"wrote {path}: 3 runs\n"
    with xr.open_dataset(path, engine="h5netcdf") as found:
        assert found["run"].values.tolist() == ["k0", "bad", "k1"]
        assert found["state"].values.tolist() == ["ok", "failed", "ok"]
        assert found["kind"].values.tolist() == ["", "nonpositive_stiffness", ""]
        assert found["message"].values.tolist() == ["", "E", ""]
        assert found["inputs"].sel(input="E").values.tolist() == [300.0, -1.0, 400.0]
        assert found["diagnostics"].sel(run="k1", diagnostic="tip_light") == records[1].diagnostics["tip_light"]
        assert np.isnan(found["diagnostics"].sel(run="bad")).all()
        for record in records:
            for condition, interface in record.interfaces.items():
                np.testing.assert_array_equal(found[f"interface_{condition}"].sel(run=record.key), interface.points)
                np.testing.assert_array_equal(found[f"cells_{condition}"], interface.cells)
        assert np.isnan(found["interface_heavy"].sel(run="bad")).all()


def test_interfaces_of_different_numbers_of_points_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    longer = Interface.polyline(np.arange(10.0).reshape(5, 2))
    folder = keep(tmp_path / "study", [RECORDS[0], RunRecord("b", {"E": 1.0, "nu": 0.0}, "ok", {"": longer})])
    shown = printed(capsys, str(folder), "--export", str(tmp_path / "runs.nc"))
    assert shown.endswith("2 runs; left out, as the numbers of points differ: the interface\n")
    with xr.open_dataset(tmp_path / "runs.nc", engine="h5netcdf") as found:
        assert set(found.data_vars) == {"state", "kind", "message", "seconds", "inputs", "diagnostics"}
    printed(capsys, str(folder), "--export", str(tmp_path / "runs.nc"), "--limit", "1")
    with xr.open_dataset(tmp_path / "runs.nc", engine="h5netcdf") as found:
        np.testing.assert_array_equal(found["interface"].values[0], longer.points)


def test_runs_without_figures_or_interfaces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = keep(tmp_path / "study", RECORDS[3:])
    printed(capsys, str(folder), "--export", str(tmp_path / "runs.nc"))
    with xr.open_dataset(tmp_path / "runs.nc", engine="h5netcdf") as found:
        assert set(found.data_vars) == {"state", "kind", "message", "seconds", "inputs"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--state", "fine"],
            "--state: got fine; expected one of ok, failed, timeout, killed, invalid, open, excl",
        ),
        (
            ["--kind", "stalld"],
            "--kind: got stalld; expected one of limit_point, non_finite, stalled, timeout, worker_died.",
        ),
        (["--show", "a"], "--show: got a; expected the beginning of the key of one run, not of 7"),
        (["--show", "zz"], "--show: got zz: none of the 7 keys begins with zz; expected the beginning of the key"),
        (["--show", ""], "an argument is empty"),
        (["--show", "aa1", "--state", "ok"], "--show: got another option with it"),
        (["--limit", "0"], "--limit"),
        (["--export", "runs.txt"], "expected a file name that ends with .csv or .nc"),
        (["--export", "runs"], "expected a file name that ends with .csv or .nc"),
        (["--export", "nowhere/runs.csv"], "expected a file in a folder that exists"),
        (["--export", "folder.nc"], "expected a file in a folder that exists"),
        (["--export", "runs.csv", "--kind", "stalled"], "--export: got no run"),
        (["--export", "runs.csv", "--kind", "stalld"], "--kind: got stalld"),
    ],
)
def test_what_is_refused(
    folder: Path,
    options: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = folder.parent
    (here / "folder.nc").mkdir()
    monkeypatch.chdir(here)
    before = sorted(here.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        main(["runs", str(folder), *options])
    shown: Any = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert message in shown.err
    assert len(shown.err.splitlines()) == 1
    assert sorted(here.rglob("*")) == before


def test_a_study_that_was_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["runs", str(tmp_path)])
    assert ended.value.code == 2
    assert "no such file; expected a ledger. Run the study first" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_kind_where_no_run_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = keep(tmp_path / "study", RECORDS[:1])
    with pytest.raises(SystemExit) as ended:
        main(["runs", str(folder), "--kind", "timeout"])
    assert ended.value.code == 2
    assert "--kind: got timeout; expected a failed run; there is none." in capsys.readouterr().err


@pytest.mark.parametrize("name", ["ledger-v1.sqlite", "ledger-v2.sqlite"])
def test_earlier_ledgers_are_listed(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(Path(__file__).parents[1] / "data" / name, tmp_path / "ledger.sqlite")
    *rows, _ = listed(capsys, str(tmp_path))
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert len(rows) == ledger.counts().total
        assert sum(row[1] == "ok" for row in rows) == ledger.counts().ok
    printed(capsys, str(tmp_path), "--export", str(tmp_path / "runs.nc"))


def test_a_run_is_excluded_and_included_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = printed(capsys, str(folder), "--exclude", "aa1", "--why", "the mesh folded")
    assert said.startswith("run aa1 is excluded: it is not used and not made again")
    assert [row[:3] for row in listed(capsys, str(folder), "--state", "excluded")[:-1]] == [
        ["aa1", "excluded", "excluded"]
    ]
    assert printed(capsys, str(folder), "--show", "aa1").splitlines()[-1].endswith(", the mesh folded")
    assert "included again" in printed(capsys, str(folder), "--include", "aa1")
    assert [row[1] for row in listed(capsys, str(folder))[:-1] if row[0] == "aa1"] == ["ok"]


def test_runs_that_the_analysis_set_aside_are_invalid(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    aside = {"key": "aa1", "inputs": {}, "kind": "not_comparable", "measure": "tracked_points", "why": "5 points"}
    summary = {"likelihood": {"discrepancy": "tracked_points"}, "set_aside": [aside]}
    (folder / "summary.json").write_text(json.dumps(summary))
    rows = listed(capsys, str(folder), "--state", "invalid")[:-1]
    assert [row[:3] for row in rows] == [["aa1", "invalid", "not_comparable"], ["ae6", "invalid", "non_finite"]]
    assert "set aside by the last analysis: not_comparable, 5 points" in printed(capsys, str(folder), "--show", "aa1")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--exclude", "aa1"], "expected --why REASON"),
        (["--exclude", "aa1", "--why", ""], "an argument is empty"),
        (["--why", "odd"], "--why alone"),
        (["--exclude", "aa1", "--include", "aa2", "--why", "odd"], "either --exclude KEY"),
        (["--exclude", "aa1", "--why", "odd", "--state", "ok"], "either --exclude KEY"),
        (
            ["--exclude", "a", "--why", "odd"],
            "--exclude: got a; expected the beginning of the key of one run, not",
        ),
        (["--exclude", "af7", "--why", "odd"], "no outcome yet"),
        (["--include", "aa1"], "not excluded"),
    ],
)
def test_what_cannot_be_excluded_or_included(
    folder: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["runs", str(folder), *options])
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out, shown.err.count("\n")) == (2, "", 1)
    assert message in shown.err
