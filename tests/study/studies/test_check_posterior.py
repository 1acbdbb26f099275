"""A study's posterior checked with the true model: runs, numbers, files, report, and the command."""

import json
import shutil
from dataclasses import dataclass, replace
from typing import ClassVar
from unittest.mock import Mock

import numpy as np
import pytest
from tests.study.studies import exact

from strandline.calibration import Observer
from strandline.cli import main
from strandline.foundations import ForwardModelError, InvalidInput, TooFewRuns
from strandline.posterior import from_datatree, read
from strandline.runs import InProcess
from strandline.studies import check_posterior, load_study
from strandline.studies.foresight.check import read_check
from strandline.testing.studies import undeclared_beam, write_study


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
    check_posterior(replace(load_study(folder), **changes), draws=draws, executor=InProcess())
    return json.loads((folder / "check.json").read_text("utf-8"))


@dataclass(frozen=True)
class Changed:
    """The beam as a model whose behaviour has changed behind its fingerprint's back."""

    weaker: float = 1.0
    fails_above: float = np.inf
    fingerprint: ClassVar[str] = "test:beam-1"

    def __call__(self, inputs, workdir):
        if inputs["E"] > self.fails_above:
            raise ForwardModelError("snapped", f"E = {inputs['E']:g} Pa is too much")
        return undeclared_beam({**inputs, "E": inputs["E"] / self.weaker}, workdir)


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
    np.testing.assert_array_equal(particles["surrogate"], posterior.log_likelihood[particles["number"]])
    true = [exact.tracked(*row) for row in posterior.draws[particles["number"]].tolist()]
    np.testing.assert_allclose(particles["true"], true, rtol=1e-9)
    (item,) = content["interfaces"]
    displacement, offset = item["displacement"], item["offset"]
    E, tilt = posterior.draws[particles["number"]].T
    tips = np.quantile(40 / E + tilt, [0.05, 0.5, 0.95])
    found = [displacement["reference"][-1][1] + displacement[key][-1][1] for key in ("q05", "q50", "q95")]
    np.testing.assert_allclose(found, tips)
    assert offset["q05"][0] == offset["q95"][0] == 0.0
    cosine = 1 / np.hypot(1, 60 / np.median(E) + np.median(tilt))  # of the slope at the tip
    np.testing.assert_allclose(offset["q95"][-1], (tips[2] - tips[1]) * cosine, rtol=0.02)


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
    assert 0 < first["seconds"] < 600
    assert (folder / "ledger.sqlite").read_bytes() == ledger


def test_draws_that_fail_have_no_weight_and_are_told(folder):
    content = checked(without_report(folder), draws=60, model=Changed(fails_above=420.0))
    posterior = from_datatree(read(folder / "posterior.nc"), load_study(folder).space)
    above = posterior.draws[content["particles"]["number"], 0] > 420
    assert 6 < above.sum() < 54
    assert content["runs"]["by_kind"] == {"snapped": int(above.sum())}
    for name in ("true", "log_weight"):
        assert [value is None for value in content["particles"][name]] == above.tolist()
    weights = np.array([0.0 if v is None else np.exp(v) for v in content["particles"]["log_weight"]])
    assert content["ess"] == pytest.approx(1 / np.sum(weights**2))
    assert f"{above.sum()} of 60 draws failed in the true model" in content["remarks"][-1]
    (folder / "check.sqlite").unlink()
    with pytest.raises(
        TooFewRuns, match=r"failed at every draw of the posterior: got 0 of 20;.*lies\. E\.g\. snapped: E = "
    ):
        checked(folder, draws=20, model=Changed(fails_above=0.0))


def test_a_wrong_surrogate_is_caught(folder):
    content = checked(without_report(folder), draws=60, model=Changed(weaker=1.5))
    assert content["verdict"] == "bad"
    assert content["remarks"][0].startswith("DO NOT TRUST THE SURROGATE")


def test_it_stands_in_the_report_once(folder, beam, capsys):
    before = (folder / "report.html").read_text("utf-8")
    main(["posterior", "check", str(folder), "--draws", "30", "--workers", "1"])
    shown, page = capsys.readouterr(), (folder / "report.html").read_text("utf-8")
    content = json.loads((folder / "check.json").read_text("utf-8"))
    assert f"{content['inputs']['E']['reweighted_mean']:.4g}" in page
    begin, end = "<!-- check of the posterior -->", "<!-- end of the check -->"
    assert page.partition(begin)[0] == before.partition(begin)[0]
    assert page.partition(end)[2] == before.partition(end)[2]
    assert "beam: 30 draws of the posterior, 30 ok, 0 failed (30 new runs, 0 reused)" in shown.out
    assert f"{content['inputs']['E']['shift']:+.2f} ± {content['inputs']['E']['shift_error']:.2f}" in shown.out
    main(["posterior", "check", str(folder), "--draws", "30", "--quiet"])
    assert "(0 new runs, 30 reused)" in capsys.readouterr().out
    assert (folder / "report.html").read_text("utf-8").count("Checked with the true model") == 1
    posterior = beam.outcome.calibration.posterior
    assert read_check(folder, posterior) is not None
    (folder / "check.json").write_text('{"posterior_sha256": "of another posterior"}')
    assert read_check(folder, posterior) is None


def test_what_is_refused(beam, tmp_path):
    content = json.loads((beam.folder / "study.yaml").read_text())
    unfinished = "no posterior to check: got a study that is not finished"
    for number, (draws, spoil, words) in enumerate(
        (
            (1001, lambda folder: None, "draws of the check: got 1001; expected from 20 to 1000"),
            (20, lambda folder: (folder / "summary.json").unlink(), unfinished),
            (20, lambda folder: (folder / "posterior.nc").write_bytes(b"no"), "posterior.nc cannot be read"),
            (20, lambda folder: write_study(folder, **content | {"seed": 2}), "of an earlier study.yaml"),
        )
    ):
        folder = beam.copied(tmp_path / str(number))
        spoil(folder)
        before = sorted(path.name for path in folder.iterdir())
        with pytest.raises(InvalidInput, match=words):
            check_posterior(load_study(folder), draws=draws)
        assert [path.name for path in sorted(folder.iterdir()) if "-shm" not in path.name] == before
