"""A study's posterior checked with the true model: runs, numbers, files, report, and the command."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar
from unittest.mock import Mock

import numpy as np
import pytest
from tests.study.studies import exact

from strandline.calibration import Observer
from strandline.cli import main
from strandline.discrepancy import ClosestPoint
from strandline.errors import ForwardModelError, InvalidInput, TooFewRuns
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.posterior import from_datatree, read
from strandline.runs import InProcess, Ledger
from strandline.studies import check_posterior, load_study
from strandline.studies.check_file import read_check
from strandline.testing.studies import undeclared_beam, write_study

TITLE = "Checked with the true model"


@pytest.fixture
def folder(beam, copy_of):
    return copy_of(beam)


def without_report(folder):
    """Take report and figures away, so that a check draws no page."""
    shutil.rmtree(folder / "figures")
    (folder / "report.html").unlink()
    return folder


def checked(folder, *, draws=200, **changes):
    """Return what check.json says after a check, some fields of the study replaced."""
    found = check_posterior(replace(load_study(folder), **changes), draws=draws, executor=InProcess())
    content = json.loads((folder / "check.json").read_text("utf-8"))
    assert found.path == folder / "check.json"
    return content


@dataclass(frozen=True)
class Changed:
    """The beam as a model whose behaviour has changed behind its fingerprint's back."""

    weaker: float = 1.0
    fails_above: float = np.inf
    extra_nodes: bool = False
    fingerprint: ClassVar[str] = "test:beam-1"

    def __call__(self, inputs, workdir):
        if inputs["E"] > self.fails_above:
            raise ForwardModelError("snapped", f"E = {inputs['E']:g} Pa is too much")
        result = undeclared_beam({**inputs, "E": inputs["E"] / self.weaker}, workdir)
        if self.extra_nodes and inputs["E"] > 400:
            return Simulation.of(Interface.polyline(result.interface.points[::2]), {})
        return result


def test_moments_log_likelihoods_and_band_are_those_of_the_model(folder):
    """The clamped end does not move; at the tip the quantiles are those of the closed form."""
    content = checked(without_report(folder))
    posterior, particles = from_datatree(read(folder / "posterior.nc"), load_study(folder).space), content["particles"]
    assert (content["verdict"], content["runs"]["failed"]) == ("good", 0)
    expected, _ = exact.posterior(exact.tracked)
    for name, (mean, sd) in expected.items():
        found = content["inputs"][name]
        assert abs(found["reweighted_mean"] - mean) < 3 * sd / np.sqrt(content["ess"])
        assert abs(found["reweighted_sd"] / sd - 1) < 3 / np.sqrt(2 * content["ess"])
        assert found["shift"] == pytest.approx((found["reweighted_mean"] - found["mean"]) / found["sd"])
        assert found["sd_ratio"] == pytest.approx(found["reweighted_sd"] / found["sd"])
    np.testing.assert_array_equal(particles["surrogate"], posterior.log_likelihood[particles["number"]])
    true = [exact.tracked(*row) for row in posterior.draws[particles["number"]].tolist()]
    np.testing.assert_allclose(particles["true"], true, rtol=1e-9)
    difference = np.array(particles["true"]) - particles["surrogate"]
    assert content["log_likelihood"]["mean_difference"] == pytest.approx(difference.mean())
    assert content["log_likelihood"]["rms_difference"] == pytest.approx(difference.std())
    (item,) = content["interfaces"]
    displacement, offset = item["displacement"], item["offset"]
    assert (item["points"], item["note"], displacement["from"]) == (17, None, "median")
    E, tilt = posterior.draws[particles["number"]].T
    tips = np.quantile(40 / E + tilt, [0.05, 0.5, 0.95])
    found = [displacement["reference"][-1][1] + displacement[key][-1][1] for key in ("q05", "q50", "q95")]
    np.testing.assert_allclose(found, tips)
    assert offset["q05"][0] == offset["q95"][0] == 0.0
    cosine = 1 / np.hypot(1, 60 / np.median(E) + np.median(tilt))  # of the slope at the tip
    np.testing.assert_allclose(offset["q95"][-1], (tips[2] - tips[1]) * cosine, rtol=0.02)
    assert abs(offset["observed"][-1]) < offset["q95"][-1]
    assert [path.name for path in (folder / "figures").iterdir()] == ["check.png"]
    assert not (folder / "report.html").exists()


def test_a_check_makes_no_run_twice_and_goes_on_where_it_was_stopped(folder):
    stop = Mock(side_effect=[None] * 6 + [KeyboardInterrupt])
    ledger = (folder / "ledger.sqlite").read_bytes()
    with pytest.raises(KeyboardInterrupt):
        check_posterior(load_study(folder), draws=40, executor=InProcess(), observer=Observer(run=stop))
    assert not (folder / "check.json").exists()
    first = checked(without_report(folder), draws=40)
    second = checked(folder, draws=40)
    assert [(one["runs"]["new"], one["runs"]["reused"]) for one in (first, second)] == [(33, 7), (0, 40)]
    assert {**first, "runs": None, "seconds": None} == {**second, "runs": None, "seconds": None}
    assert checked(folder, draws=80)["runs"]["new"] == 40
    assert (folder / "ledger.sqlite").read_bytes() == ledger


def test_draws_that_fail_have_no_weight_and_are_told(folder):
    content = checked(folder, draws=60, model=Changed(fails_above=420.0))
    posterior = from_datatree(read(folder / "posterior.nc"), load_study(folder).space)
    above = posterior.draws[content["particles"]["number"], 0] > 420
    assert 6 < above.sum() < 54
    assert content["runs"]["failed"] == above.sum()
    assert content["runs"]["by_kind"] == {"snapped": int(above.sum())}
    for name in ("true", "log_weight"):
        assert [value is None for value in content["particles"][name]] == above.tolist()
    weights = np.array([0.0 if v is None else np.exp(v) for v in content["particles"]["log_weight"]])
    assert weights.sum() == pytest.approx(1.0)
    assert content["ess"] == pytest.approx(1 / np.sum(weights**2))
    assert f"{above.sum()} of 60 draws failed in the true model" in content["remarks"][-1]
    assert f"({above.sum()} × snapped)" in (folder / "report.html").read_text("utf-8")
    with Ledger.open(folder / "check.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().failed == above.sum()
    none = Changed(fails_above=0.0)
    shutil.copytree(folder, folder.parent / "none", ignore=shutil.ignore_patterns("check*"))
    with pytest.raises(TooFewRuns, match=r"failed at every draw of the posterior: got 0 of 20; e.g. snapped: E = "):
        checked(folder.parent / "none", draws=20, model=none)


def test_a_wrong_surrogate_is_caught(folder):
    content = checked(without_report(folder), draws=60, model=Changed(weaker=1.5))
    assert content["verdict"] == "bad"
    assert content["k_hat"] is None or content["k_hat"] > 0.7
    assert content["remarks"][0].startswith("DO NOT TRUST THE SURROGATE")
    assert "Remedy: more runs near the posterior" in content["remarks"][1]


def test_interfaces_of_other_nodes_have_no_band(folder):
    measures = {"closest_point": ClosestPoint()}
    content = checked(folder, draws=40, model=Changed(extra_nodes=True), discrepancies=measures)
    (item,) = content["interfaces"]
    assert item["note"] == "no band: the interfaces of the draws have from 9 to 17 points"
    assert item["displacement"] is None
    assert item["note"] in (folder / "report.html").read_text("utf-8")


def test_it_stands_in_the_report_once(folder, beam, capsys):
    before = (folder / "report.html").read_text("utf-8")
    assert TITLE not in before
    main(["posterior", "check", str(folder), "--draws", "30", "--workers", "1"])
    shown, page = capsys.readouterr(), (folder / "report.html").read_text("utf-8")
    content = json.loads((folder / "check.json").read_text("utf-8"))
    assert page.count(TITLE) == 1
    assert f"{content['inputs']['E']['reweighted_mean']:.4g}" in page
    begin, end = "<!-- check of the posterior -->", "<!-- end of the check -->"
    assert page.partition(begin)[0] == before.partition(begin)[0]
    assert page.partition(end)[2] == before.partition(end)[2]
    assert "beam: 30 draws of the posterior, 30 ok, 0 failed (30 new runs, 0 reused)" in shown.out
    assert f"Pareto k {content['k_hat']:.2f}: {content['verdict']}" in shown.out
    for name, item in content["inputs"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
        assert f"{item['reweighted_mean']:.4g}" in row
        assert f"{item['shift']:+.2f} ± {item['shift_error']:.2f}" in row
    assert content["remarks"][0] in shown.out
    assert shown.err.splitlines() == ["runs at draws …", "  30/30 30 ok, 0 failed", "figures and report …"]
    main(["posterior", "check", str(folder), "--draws", "30", "--quiet"])
    again = capsys.readouterr()
    assert again.err == ""
    assert "(0 new runs, 30 reused)" in again.out
    assert (folder / "report.html").read_text("utf-8").count(TITLE) == 1
    posterior = beam.outcome.calibration.posterior
    assert read_check(folder, posterior) is not None
    for other in ('{"posterior_sha256": "of another posterior"}', "{}", "[]", "not JSON"):
        (folder / "check.json").write_text(other)
        assert read_check(folder, posterior) is None


def test_what_is_refused(beam, tmp_path):
    content = json.loads((beam.folder / "study.yaml").read_text())
    unfinished = "no posterior to check: got a study that is not finished"
    for number, (draws, spoil, words) in enumerate(
        (
            (1001, lambda folder: None, "draws of the check: got 1001; expected from 20 to 1000"),
            (19, lambda folder: None, "draws of the check: got 19; expected from 20"),
            (20, lambda folder: (folder / "summary.json").unlink(), unfinished),
            (20, lambda folder: (folder / "posterior.nc").unlink(), unfinished),
            (20, lambda folder: (folder / "ledger.sqlite").unlink(), "0 of 65 forward runs"),
            (20, lambda folder: (folder / "posterior.nc").write_bytes(b"no"), "posterior.nc cannot be read"),
            (20, lambda folder: write_study(folder, **content | {"seed": 2}), "of an earlier study.yaml"),
        )
    ):
        folder = Path(shutil.copytree(beam.folder, tmp_path / str(number)))
        spoil(folder)
        before = sorted(path.name for path in folder.iterdir())
        with pytest.raises(InvalidInput, match=words):
            check_posterior(load_study(folder), draws=draws)
        assert [path.name for path in sorted(folder.iterdir()) if "-shm" not in path.name] == before
