"""`strandline runs`: the list, its filters, one run in full, exports, and runs that are left out."""

import csv
import json

import numpy as np
import pytest
import xarray as xr
from tests.unit.cli.command_line import printed, refused

from strandline.interface import Interface
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.ledger.overview import STATES
from strandline.testing.models import Cantilever, TwoLoads

LINE, QUOTED = Interface.polyline(np.arange(8.0).reshape(4, 2)), 'no "end",\nlong'
RECORDS = [
    RunRecord("aa1", {"E": 400.0, "nu": 1 / 3}, "ok", {"": LINE}, {"tip": 0.125}, 1.25),
    RunRecord("aa2", {"E": 300.0, "nu": 0.25}, "failed", {}, {"load": 0.5}, 2.5, "stalled", QUOTED, "a\nlog"),
    RunRecord("ab3", {"E": 301.0, "nu": 0.25}, "failed", {}, {}, 3.5, "limit_point", "bends"),
    RunRecord("ac4", {"E": 302.0, "nu": 0.25}, "timeout", seconds=60.0, failure_kind="timeout"),
    RunRecord("ad5", {"E": 303.0, "nu": 0.25}, "killed", failure_kind="worker_died"),
    RunRecord("ae6", {"E": 304.0, "nu": 0.25}, "invalid", failure_kind="non_finite"),
]


def keep(folder, records, *open_runs):
    folder.mkdir(exist_ok=True)
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1") as ledger:
        for record in records:
            ledger.started(RunRequest(record.key, record.inputs))
            ledger.finished(record)
        for request in open_runs:
            ledger.started(request)
    return folder


def some_runs(folder):
    """Write a ledger with all of `RECORDS`, the second open again, and one more under way."""
    return keep(folder, RECORDS, RunRequest("af7", {"E": 305.0, "nu": 0.25}), RunRequest("aa2", RECORDS[1].inputs))


@pytest.fixture
def folder(tmp_path):
    return some_runs(tmp_path / "study")


def listed(capsys, *arguments):
    heading, *lines = printed(capsys, "runs", *arguments).splitlines()
    assert heading.split()[:4] == ["key", "state", "kind", "seconds"]
    return [line.split() for line in lines]


def keys(capsys, *arguments):
    return [row[0] for row in listed(capsys, *arguments)[:-1]]


def test_all_runs_or_some_are_listed_in_the_order_of_their_last_start(folder, capsys):
    assert printed(capsys, "runs", str(folder)).splitlines() == [
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
    expected = {"open": ["af7", "aa2"], "failed": ["ab3"]}
    expected |= {record.state: [record.key] for record in RECORDS if record.state != "failed"}
    for state in STATES:
        *rows, last = listed(capsys, str(folder), "--state", state)
        assert [row[0] for row in rows] == expected[state]
        assert last == [str(len(rows)), "of", "7", "runs"]
    assert keys(capsys, str(folder), "--kind", "non_finite") == ["ae6"]
    assert keys(capsys, str(folder), "--kind", "stalled") == []  # that run is open again
    assert keys(capsys, str(folder), "--limit", "3") == ["ae6", "af7", "aa2"]
    (one,) = json.loads(printed(capsys, "runs", str(folder), "--json", "--state", "ok"))
    assert (one["key"], one["kind"], one["inputs"]) == ("aa1", None, dict(RECORDS[0].inputs))
    assert (one["seconds"], one["starts"], one["origin"]) == (1.25, 1, None)
    assert 0 < one["started_at"] <= one["finished_at"]


def test_one_run_in_full_with_how_it_ended_before(folder, capsys):
    shown = printed(capsys, "runs", str(folder), "--show", "aa1").splitlines()
    assert shown.pop(2).startswith("started: ")
    assert shown == ["key: aa1", "state: ok", "E = 400.0", "nu = 0.3333333333333333", "seconds: 1.25", "tip: 0.125"]
    shown = printed(capsys, "runs", str(folder), "--show", "aa2").splitlines()
    assert shown[1] == "state: open"
    assert shown[2].endswith("(start 2 of this run)")
    message, log = ["message:", '  no "end",', "  long"], ["log:", "  a", "  log"]
    assert shown[5:] == ["before: failed, stalled", "seconds: 2.5", "load: 0.5", *message, *log]


def test_a_csv_holds_all_of_it(folder, tmp_path, capsys):
    path = tmp_path / "runs.csv"
    assert printed(capsys, "runs", str(folder), "--export", str(path)) == f"wrote {path}: 7 runs\n"
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
    printed(capsys, "runs", str(folder), "--export", str(path), "--kind", "limit_point")
    assert path.read_text().splitlines()[1:] == ["ab3,failed,limit_point,3.5,bends,301.0,0.25"]


def test_a_netcdf_holds_the_interfaces_too(tmp_path, capsys):
    model, records = TwoLoads(Cantilever(nodes=5)), []
    for key, value in (("k0", 300.0), ("k1", 400.0)):
        run = model({"E": value, "load": 1e-5}, tmp_path)
        records.append(RunRecord(key, {"E": value, "load": 1e-5}, "ok", run.interfaces, run.diagnostics, 0.5))
    bad = RunRecord("bad", {"E": -1.0, "load": 1e-5}, "failed", failure_kind="nonpositive_stiffness", message="E\nx")
    folder, path = keep(tmp_path / "study", [records[0], bad, records[1]]), tmp_path / "runs.nc"
    assert printed(capsys, "runs", str(folder), "--export", str(path)) == f"wrote {path}: 3 runs\n"
    with xr.open_dataset(path, engine="h5netcdf") as found:
        assert found["run"].values.tolist() == ["k0", "bad", "k1"]
        assert found["message"].values.tolist() == ["", "E", ""]
        assert found["inputs"].sel(input="E").values.tolist() == [300.0, -1.0, 400.0]
        assert found["diagnostics"].sel(run="k1", diagnostic="tip_light") == records[1].diagnostics["tip_light"]
        assert np.isnan(found["diagnostics"].sel(run="bad")).all()
        for record in records:
            for condition, interface in record.interfaces.items():
                np.testing.assert_array_equal(found[f"interface_{condition}"].sel(run=record.key), interface.points)
                np.testing.assert_array_equal(found[f"cells_{condition}"], interface.cells)
        assert np.isnan(found["interface_heavy"].sel(run="bad")).all()


def test_a_run_is_excluded_and_included_again(folder, capsys):
    said = printed(capsys, "runs", str(folder), "--exclude", "aa1", "--why", "the mesh folded")
    assert said.startswith("run aa1 is excluded: it is not used and not made again")
    (row,) = listed(capsys, str(folder), "--state", "excluded")[:-1]
    assert row[:3] == ["aa1", "excluded", "excluded"]
    assert printed(capsys, "runs", str(folder), "--show", "aa1").splitlines()[-1].endswith(", the mesh folded")
    assert "included again" in printed(capsys, "runs", str(folder), "--include", "aa1")
    assert keys(capsys, str(folder), "--state", "ok") == ["aa1"]
    assert "not excluded" in refused(capsys, "runs", str(folder), "--include", "aa1")
    assert "no outcome yet" in refused(capsys, "runs", str(folder), "--exclude", "af7", "--why", "x")


def test_runs_that_the_analysis_set_aside_are_invalid(folder, capsys):
    one = {"key": "aa1", "inputs": {}, "kind": "not_comparable", "measure": "tracked_points", "why": "5 points"}
    summary = {"likelihood": {"discrepancy": "tracked_points"}, "set_aside": [one, {**one, "key": "ab3"}]}
    (folder / "summary.json").write_text(json.dumps(summary))
    rows = listed(capsys, str(folder), "--state", "invalid")[:-1]
    assert [row[:3] for row in rows] == [["aa1", "invalid", "not_comparable"], ["ae6", "invalid", "non_finite"]]
    assert keys(capsys, str(folder), "--state", "failed") == ["ab3"]
    shown = printed(capsys, "runs", str(folder), "--show", "aa1")
    assert "set aside by the last analysis: not_comparable, 5 points" in shown


def test_of_many_inputs_the_list_shows_the_first(tmp_path, capsys):
    inputs = {f"E_{k}": float(k) for k in range(1, 81)}
    text = printed(capsys, "runs", str(keep(tmp_path / "map", [RunRecord("aa1", inputs, "ok", {"": LINE})])))
    heading, _, rest, last = text.splitlines()
    assert heading.split()[-1] == "E_12"
    assert rest == "and 68 more inputs, E_13 to E_80: --json or --export tell them"
    assert last == "1 of 1 runs"
