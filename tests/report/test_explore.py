"""The data of the panels are those of the runs and of the posterior; the page stays small."""

import base64
import gzip
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from strandline.calibration import Calibration
from strandline.discrepancy.normal_offset import signed_distances
from strandline.interface import Interface
from strandline.report import explore as section
from strandline.report import write_report
from strandline.report.explore import explore
from strandline.report.figures import figure_groups
from strandline.report.inline import PLOTLY, script_hash
from strandline.report.lighter import fitted
from strandline.runs import InProcess, RunRecord
from strandline.runs.tables import LOG_TITLE
from strandline.studies import load_study, run_study
from strandline.testing.studies import write_study

LONG = "x" * 10_000


@pytest.fixture
def calibration(reported: Any) -> Calibration:
    found: Calibration = reported.outcome.calibration
    return found


def data_in(page: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="explore-data">(.*?)</script>', page, re.DOTALL)
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


def failed(record: RunRecord, message: str = "no </script> here", log: str = "") -> RunRecord:
    return replace(record, state="failed", interfaces={}, failure_kind="</script><b>", message=message, log=log)


def many(calibration: Calibration, number: int, *, points: int = 17, every_failed: int = 0) -> Calibration:
    """Return the calibration as if so many runs had been made: its own runs again, with other interfaces."""
    good = [record for record in calibration.records if record.ok]
    x = np.linspace(0.0, 1.0, points)
    records, rows = [], []
    for k in range(number):
        record = replace(good[k % len(good)], key=f"k{k}", diagnostics={f"figure {i}": 1 / (i + 3) for i in range(20)})
        if every_failed and k % every_failed == 0:
            records.append(failed(record, f"{LONG}\n{LOG_TITLE}\n{LONG}", LONG))
            continue
        line = Interface.polyline(np.stack([x, 0.1 * x**2 + 1e-4 * k / 7], axis=1))
        records.append(replace(record, interfaces={"": line}))
        rows.append(k % len(good))
    values = {name: one[rows] for name, one in calibration.log_likelihoods.items()}
    training = calibration.training[rows]
    return replace(calibration, records=tuple(records), log_likelihoods=values, training=training, made=())


def test_the_page_holds_the_runs_as_they_are(reported: Any, calibration: Calibration) -> None:
    data = data_in(reported.outcome.report.read_text("utf-8"))
    runs, records = data["runs"], calibration.all_runs
    assert runs["row"] == list(range(len(records)))
    assert runs["state"] == [record.state for record in records]
    for name in calibration.problem.space.names:
        assert runs["inputs"][name] == pytest.approx([record.inputs[name] for record in records], rel=1e-5)
    (seen,) = calibration.problem.observations
    assert len(data["interfaces"]) == len(records)
    for row in ("0", "17"):
        own = records[int(row)].interfaces[""]
        found = data["interfaces"][row][""]
        assert np.allclose(np.transpose(found["line"]), own.points, atol=1e-6)
        assert found["offsets"] == pytest.approx(
            (1e3 * signed_distances(seen.interface.points, own)).tolist(), rel=1e-3
        )
    assert np.allclose(np.transpose(data["facts"]["conditions"][0]["observed"]), seen.interface.points, atol=1e-6)
    assert data["facts"]["fixed"] == pytest.approx(dict(calibration.problem.fixed))


def test_the_page_holds_the_posterior(reported: Any) -> None:
    found = data_in(reported.outcome.report.read_text("utf-8"))["posterior"]
    for name, item in reported.outcome.summary["inputs"].items():
        assert found["mean"][name] == pytest.approx(item["mean"])
        assert found["sd"][name] == pytest.approx(item["sd"])
        draws = found["draws"][name]
        assert len(draws) == 2000
        assert float(np.mean(draws)) == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert float(np.std(draws)) == pytest.approx(item["sd"], rel=0.1)
    line, band = (np.array(found["bands"][""][name]) for name in ("line", "band"))
    upper, lower = band[:, : line.shape[1]], band[:, line.shape[1] :][:, ::-1]
    assert np.allclose((upper + lower) / 2, line, atol=2e-6)
    assert (np.linalg.norm(upper - lower, axis=0)[1:] > 0).all()


def test_a_failure_is_shown_with_its_message_and_log(calibration: Calibration) -> None:
    records = list(calibration.records)
    records[3] = failed(records[3], f"no </script> here\n{LOG_TITLE}\nlast", "\n".join(map(str, range(50))))
    ok = np.array([k for k in range(len(records)) if k != 3])
    values = {name: one[ok] for name, one in calibration.log_likelihoods.items()}
    other = replace(
        calibration, records=tuple(records), log_likelihoods=values, training=calibration.training[ok], made=()
    )
    found = explore(other, None)
    assert "<" not in found.data
    data = json.loads(found.data)
    assert (data["runs"]["state"][3], data["runs"]["kind"][3]) == ("failed", "</script><b>")
    assert data["details"]["3"]["message"] == "no </script> here"
    assert data["details"]["3"]["log"].splitlines() == [str(k) for k in range(42, 50)]
    assert "3" not in data["interfaces"]
    assert found.outlines == len(records) - 1


def test_of_many_runs_the_best_and_some_of_all_are_kept(calibration: Calibration) -> None:
    other = many(calibration, 3000, every_failed=10)
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


@pytest.mark.parametrize("points", [17, 3000])
def test_the_data_stay_small_whatever_a_run_returns(points: int, calibration: Calibration) -> None:
    """Long messages and logs, many figures, fine interfaces and observations of a thousand points."""
    (seen,) = calibration.problem.observations
    x = np.linspace(0.0, 1.0, 1000)
    observed = replace(seen, interface=Interface.polyline(np.stack([x, 0.1 * x**2], axis=1)))
    other = many(calibration, 1500, points=points, every_failed=3)
    problem = replace(other.problem, observations=(observed,))
    found = explore(replace(other, problem=problem), None)
    data = json.loads(found.data)
    assert all(len(one[""]["line"][0]) <= 100 for one in data["interfaces"].values())
    assert len(data["interfaces"]) == section.MOST_NUMBERS // 1200
    assert found.size < 2_200_000


def test_a_report_of_a_thousand_runs_can_be_sent(
    calibration: Calibration, reported: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With figures for print; the files beside the page keep their resolution."""
    monkeypatch.setattr("strandline.report.page.DOTS_PER_INCH", 300)
    monkeypatch.setattr("strandline.report.page.figure_groups", lambda *given: figure_groups(calibration, None))
    summary = reported.outcome.summary
    page = write_report(many(calibration, 1000), summary, study_text="", truth=None, folder=tmp_path)
    assert page.stat().st_size < 5_000_000
    assert len(data_in(page.read_text("utf-8"))["runs"]["row"]) == 1000
    for path in (tmp_path / "figures").glob("*.png"):
        with Image.open(path) as picture:
            assert picture.info["dpi"] == pytest.approx((300, 300), abs=0.1)


@pytest.mark.long
def test_a_study_of_a_thousand_runs_can_be_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own figures show all runs, and have more colours and lines than those of a small study."""
    monkeypatch.setattr("strandline.report.page.DOTS_PER_INCH", 300)
    measures: list[dict[str, Any]] = [{"normal_offset": {}}, {"tracked_points": {}}]
    folder = write_study(tmp_path / "beam", design={"sobol": {"runs": 1000}}, discrepancy=measures)
    page = run_study(load_study(folder), executor=InProcess()).report
    assert page.stat().st_size < 5_000_000
    assert len(data_in(page.read_text("utf-8"))["runs"]["row"]) == 1000


def test_the_largest_pictures_become_smaller_until_all_fit() -> None:
    random = np.random.default_rng(0)

    def noise(size: int) -> str:
        out = io.BytesIO()
        Image.fromarray(random.integers(0, 255, (size, size, 3), dtype=np.uint8)).save(out, format="png")
        return base64.b64encode(out.getvalue()).decode("ascii")

    small, large = noise(20), noise(80)
    whole = len(small) + len(large)
    assert fitted([small, large], whole) == [small, large]
    kept, halved = fitted([small, large], whole - 1)
    assert kept == small
    with Image.open(io.BytesIO(base64.b64decode(halved))) as picture:
        assert picture.size == (40, 40)
    both = fitted([small, large], 1)
    assert [len(one) < len(other) for one, other in zip(both, [small, large], strict=True)] == [True, True]


def test_the_library_is_whole_with_its_licence_and_its_digest(reported: Any) -> None:
    page = reported.outcome.report.read_text("utf-8")
    (packed,) = re.findall(r'<script type="application/gzip" id="explore-plotly">(.*?)</script>', page)
    text = gzip.decompress(base64.b64decode(packed)).decode("utf-8")
    assert text == PLOTLY.read_text(encoding="utf-8")
    assert f"'{script_hash(text)}'" in page
    assert "Permission is hereby granted" in page
    assert explore(reported.outcome.calibration, None).plotly == packed


def test_without_the_section_the_page_has_no_script(
    calibration: Calibration, reported: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*given: Any) -> Any:
        raise RuntimeError("no data")

    monkeypatch.setattr("strandline.report.page.explore", broken)
    monkeypatch.setattr("strandline.report.page.figure_groups", lambda *given: {})
    heard: dict[str, Exception] = {}
    given: dict[str, Any] = {"study_text": "", "truth": None, "folder": tmp_path, "on_failure": heard.__setitem__}
    text = write_report(calibration, reported.outcome.summary, **given).read_text("utf-8")
    assert list(heard) == ["the section Explore"]
    assert "the section Explore could not be written: RuntimeError: no data" in text
    assert "<script" not in text
    assert "script-src" not in text
    assert 'id="explore"' not in text
