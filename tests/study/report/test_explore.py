"""The data of the panels are those of the runs and of the posterior; the page stays small."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.study.conftest import Finished
from tests.study.report.pages import data_in

from strandline.calibration import Calibration
from strandline.discrepancy.normal_offset import signed_distances
from strandline.interface import Interface
from strandline.report import explore as section
from strandline.report.explore import explore
from strandline.runs import RunRecord
from strandline.runs.tables import LOG_TITLE

LONG = "x" * 10_000


@pytest.fixture
def calibration(beam: Finished) -> Calibration:
    found: Calibration = beam.outcome.calibration
    return found


def failed(record: RunRecord, message: str, log: str) -> RunRecord:
    return replace(record, state="failed", interfaces={}, failure_kind="</script><b>", message=message, log=log)


def with_runs(calibration: Calibration, records: list[RunRecord], rows: list[int]) -> Calibration:
    """Return the calibration with other runs; `rows` says which of its own stand for those that succeeded."""
    values = {name: one[rows] for name, one in calibration.log_likelihoods.items()}
    training = calibration.training[rows]
    return replace(calibration, records=tuple(records), log_likelihoods=values, training=training, made=())


def many(calibration: Calibration, number: int, *, points: int, every_failed: int) -> Calibration:
    """Return the calibration as if so many runs had been made: its own runs again, with other interfaces."""
    good = [record for record in calibration.records if record.ok]
    x = np.linspace(0.0, 1.0, points)
    records, rows = [], []
    for k in range(number):
        record = replace(good[k % len(good)], key=f"k{k}", diagnostics={f"figure {i}": 1 / (i + 3) for i in range(20)})
        if k % every_failed == 0:
            records.append(failed(record, f"{LONG}\n{LOG_TITLE}\n{LONG}", LONG))
            continue
        line = Interface.polyline(np.stack([x, 0.1 * x**2 + 1e-4 * k / 7], axis=1))
        records.append(replace(record, interfaces={"": line}))
        rows.append(k % len(good))
    return with_runs(calibration, records, rows)


def test_the_page_holds_the_runs_as_they_are_and_the_posterior(beam: Finished, calibration: Calibration) -> None:
    data = data_in((beam.folder / "report.html").read_text("utf-8"))
    runs, records = data["runs"], calibration.all_runs
    assert runs["row"] == list(range(len(records)))
    assert runs["state"] == [record.state for record in records]
    for name in calibration.problem.space.names:
        assert runs["inputs"][name] == pytest.approx([record.inputs[name] for record in records], rel=1e-5)
    (seen,) = calibration.problem.observations
    assert len(data["interfaces"]) == len(records)
    for row in (0, 17):
        own, found = records[row].interfaces[""], data["interfaces"][str(row)][""]
        assert np.allclose(np.transpose(found["line"]), own.points, atol=1e-6)
        off = 1e3 * signed_distances(seen.interface.points, own)
        assert found["offsets"] == pytest.approx(off.tolist(), rel=1e-3)
    assert np.allclose(np.transpose(data["facts"]["conditions"][0]["observed"]), seen.interface.points, atol=1e-6)
    assert data["facts"]["fixed"] == pytest.approx(dict(calibration.problem.fixed))
    posterior = data["posterior"]
    for name, item in beam.outcome.summary["inputs"].items():
        assert posterior["mean"][name] == pytest.approx(item["mean"])
        assert posterior["sd"][name] == pytest.approx(item["sd"])
        draws = posterior["draws"][name]
        assert len(draws) == 2000
        assert float(np.mean(draws)) == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert float(np.std(draws)) == pytest.approx(item["sd"], rel=0.1)
    line, band = (np.array(posterior["bands"][""][name]) for name in ("line", "band"))
    upper, lower = band[:, : line.shape[1]], band[:, line.shape[1] :][:, ::-1]
    assert np.allclose((upper + lower) / 2, line, atol=2e-6)
    assert (np.linalg.norm(upper - lower, axis=0)[1:] > 0).all()


def test_a_failure_is_shown_with_its_message_and_log(calibration: Calibration) -> None:
    records = list(calibration.records)
    message = f"no </script> here\n{LOG_TITLE}\nlast"
    records[3] = failed(records[3], message, "\n".join(map(str, range(50))))
    found = explore(with_runs(calibration, records, [k for k in range(len(records)) if k != 3]), None)
    assert "<" not in found.data
    data: Any = json.loads(found.data)
    assert (data["runs"]["state"][3], data["runs"]["kind"][3]) == ("failed", "</script><b>")
    assert data["details"]["3"]["message"] == "no </script> here"
    assert data["details"]["3"]["log"].splitlines() == [str(k) for k in range(42, 50)]
    assert "3" not in data["interfaces"]
    assert found.outlines == len(records) - 1


def test_of_many_runs_the_best_and_some_of_all_are_kept(calibration: Calibration) -> None:
    other = many(calibration, 3000, points=17, every_failed=10)
    found = explore(other, None)
    data = json.loads(found.data)
    rows = data["runs"]["row"]
    assert (found.runs, found.of, found.outlines) == (1000, 3000, 200)
    assert rows == sorted(set(rows))
    assert len(rows) == 1000
    values, used = next(iter(other.log_likelihoods.values())), [k for k in range(3000) if k % 10]
    best = [used[i] for i in np.argsort(-values, kind="stable")]
    assert set(best[:500]) <= set(rows)
    assert {str(row) for row in best[:100]} <= set(data["interfaces"])
    assert max(np.diff(rows)) < 40
    assert 20 < data["runs"]["state"].count("failed") < 300
    assert set(data["interfaces"]) <= {str(row) for row in rows}


def test_the_data_stay_small_whatever_a_run_returns(calibration: Calibration) -> None:
    """Long messages and logs, many figures, fine interfaces and observations of a thousand points."""
    (seen,) = calibration.problem.observations
    x = np.linspace(0.0, 1.0, 1000)
    observed = replace(seen, interface=Interface.polyline(np.stack([x, 0.1 * x**2], axis=1)))
    other = many(calibration, 1500, points=1000, every_failed=3)
    found = explore(replace(other, problem=replace(other.problem, observations=(observed,))), None)
    data = json.loads(found.data)
    assert all(len(one[""]["line"][0]) <= 100 for one in data["interfaces"].values())
    assert len(data["interfaces"]) == section.MOST_NUMBERS // 1200
    assert found.size < 2_200_000
