"""A finished study by a surrogate of the interface: noise of its points, a nuisance input, both of its readings."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.study.conftest import NOISY, SAMPLER, finish
from tests.study.studies import exact

from strandline.interface import PointErrors
from strandline.posterior import read
from strandline.report.warnings import find_warnings
from strandline.runs import InProcess
from strandline.studies import check_posterior, load_study
from strandline.studies.load.observed import SyntheticNoise, noisy
from strandline.studies.write.summary import summarise
from strandline.testing.studies import beam as simulator

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
INPUTS = {
    "tilt": {"prior": {"beta": [2.0, 4.0, 0.0, 0.04]}, "nuisance": True},
    "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
}


@pytest.fixture(scope="module")
def uncertain(tmp_path_factory):
    """A surrogate of the log-likelihood, with a nuisance input: its cut reading has a quadrature beside it."""
    sampler = {**SAMPLER, "cut": {"values": 4}}
    return finish(tmp_path_factory.mktemp("uncertain") / "beam", report="none", inputs=INPUTS, sampler=sampler)


def test_the_posterior_is_that_of_the_model_and_the_report_shows_both_readings(field):
    expected, evidence = exact.posterior(exact.likelihood_of(field.outcome.calibration.problem))
    for name, (mean, sd) in expected.items():
        found = field.outcome.summary["inputs"][name]
        assert abs(found["mean"] - mean) < 0.2 * sd
        assert found["sd"] == pytest.approx(sd, rel=0.15)
    assert field.outcome.summary["log_evidence"] == pytest.approx(evidence, abs=0.3)
    page = field.outcome.report.read_text()
    assert "with tilt uncertain" in " ".join(page.split())
    for reading in ("joint", "cut"):
        assert f"{field.outcome.summary['under_uncertainty'][reading]['inputs']['E']['mean']:.4g}" in page


def test_errors_of_a_picture_that_contradict_each_other_are_among_the_results(field):
    seen = SimpleNamespace(name="beam.png", picture=SimpleNamespace(sha256="0"), notes=())
    observed = {one.condition: one.interface for one in field.outcome.calibration.problem.observations}
    study = replace(load_study(field.folder), observed=observed, pictures={"": seen})
    for scale, warned in ((0.05, 1), (0.0, 0)):
        noisy_picture = replace(study, noises={"": PointErrors(0.01, scale=scale)})
        found = summarise(noisy_picture, field.outcome.calibration, new_runs=0, reused_runs=0)["warnings"]
        assert sum("contradict each other" in line for line in found) == warned
        assert all(line.startswith("The ") and line.endswith(".") for line in found if "contradict each" in line)


def test_both_readings_are_those_of_the_model(uncertain):
    """The cut reading is the mean over values of the nuisance input, each with the posterior given it."""
    both, s = uncertain.outcome.summary["under_uncertainty"], np.clip(exact.GRID[:, 1] / 0.04, 1e-12, 1 - 1e-12)
    values = np.array([exact.tracked(*row) for row in exact.GRID.tolist()]) + np.log(s) + 3 * np.log1p(-s)
    joint = exact.moments(values, exact.GRID[:, 0])
    E = np.linspace(300, 560, 501)
    given = [[exact.tracked(e, tilt) for e in E.tolist()] for tilt in both["cut"]["nuisance_values"]["tilt"]]
    means, sds = np.array([exact.moments(np.array(values), E) for values in given]).T
    cut = means.mean(), np.sqrt(np.mean(sds**2 + (means - means.mean()) ** 2))
    for name, (mean, sd) in (("joint", joint), ("cut", cut)):
        found = both[name]["inputs"]["E"]
        assert abs(found["mean"] - mean) < 0.15 * sd
        assert found["sd"] == pytest.approx(sd, rel=0.1)
    check = both["cut"]["quadrature_check"]
    assert (check["E"]["mean"], check["E"]["sd"]) == pytest.approx(cut, rel=0.05)
    assert max(check["max_mean_error_sd"], check["max_sd_ratio_error"]) < 0.1
    assert both["joint"]["inputs"]["E"]["mean"] == pytest.approx(uncertain.outcome.summary["inputs"]["E"]["mean"])
    assert abs(joint[0] - cut[0]) > 0.2 * joint[1] or abs(joint[1] / cut[1] - 1) > 0.2, "exchanged: unseen"


def test_a_doubtful_cut_reading_is_told(uncertain):
    """Planted: a quadrature that finds another mean, draws at a bound."""
    calibration = uncertain.outcome.calibration
    parts, found = calibration.cut_quadrature, calibration.under_uncertainty
    moved = replace(calibration, cut_quadrature=tuple(replace(part, mean=part.mean + 10.0) for part in parts))
    draws = found.cut.extended.draws.copy()
    draws[found.cut.value_index == 0, 1] = 301.0
    cut = replace(found.cut, extended=replace(found.cut.extended, draws=draws))
    bound = replace(calibration, under_uncertainty=replace(found, cut=cut))
    for doubtful, words in (
        (moved, "quadrature of the cut reading differ"),
        (bound, "The cut reading of E reaches the lower end of its box, 300 Pa"),
    ):
        told = [any(words in warning for warning in find_warnings(one)) for one in (calibration, doubtful)]
        assert told == [False, True]


def test_the_noisy_interface_is_what_was_observed_also_by_the_check_of_the_posterior(field, copy_of):
    (seen,) = field.outcome.calibration.problem.observations
    true = simulator(TRUTH, Path()).interface
    np.testing.assert_array_equal(seen.interface.points, noisy({"": true}, SyntheticNoise(0.003, 1))[""].points)
    stored = read(field.folder / "posterior.nc")["observed_data"]
    assert any(np.array_equal(stored[name].values, seen.interface.points) for name in stored.data_vars)
    scatter = field.outcome.calibration.field.scatter
    assert field.outcome.summary["surrogate"]["scatter"]["rms_um"] == pytest.approx(1000 * scatter.rms, abs=0)
    (condition,) = field.outcome.summary["likelihood"]["conditions"]
    assert (condition["point_sd"], condition["correlation_length"], condition["noise_variance"]) == (0.003, 0.0, 1.0)
    # The surrogate is nearly exact, so it agrees with the true log-likelihood; without the noise it would not.
    content = check_posterior(load_study(copy_of(field)), draws=20, executor=InProcess()).content
    assert abs(content["log_likelihood"]["mean_difference"]) < 1.0


def test_a_study_with_unknown_noise(tmp_path):
    noise = {"sd": [1, 9], "length": "unknown", "unit": "um", "model_error": True}
    content = {**NOISY, "discrepancy": {"normal_offset": {}}, "noise": noise, "design": {"sobol": {"runs": 32}}}
    summary = finish(tmp_path / "beam", report="none", **content).outcome.summary
    found = summary["likelihood"]["inferred_noise"]
    assert 1.0 < found["sd_um"]["q05"] < found["sd_um"]["median"] < found["sd_um"]["q95"] < 9.0
    assert 0 <= found["model_error"]["probability"] <= 1
    without, with_it = found["without_model_error"]["E"], summary["inputs"]["E"]
    assert 0 < without["sd"] < 1.3 * with_it["sd"]
    assert abs(without["mean"] - 400.0) < 4 * without["sd"]
