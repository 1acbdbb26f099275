"""The whole method, on a beam whose posterior is known; by a surrogate of the user's; of four inputs."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.study.calibration.beams import NOISE, ONE, SETTINGS, X, answer, exact, learnt, problem, summed

from strandline.calibration import Observer, Problem, calibrate
from strandline.calibration.in_notebook import cell_observer, observer_or_default
from strandline.cli.results import show
from strandline.design.refinement import Refinement
from strandline.discrepancy import ClosestPoint, TrackedPoints
from strandline.errors import ForwardModelError, InvalidInput, TooFewRuns
from strandline.interface import Interface, Observation
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.surrogate import fit_log_likelihood
from strandline.testing.models import TwoLoads
from strandline.testing.studies import beam, write_study

SHOWN = []
"""What a notebook shows below its cell, from step to step."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibrate")


@pytest.fixture(scope="module")
def found(folder):
    """Two measures; the first one makes the posterior."""
    asked = problem(space=ONE, noise=NOISE / 2, closest=ClosestPoint())
    return answer(folder, asked, SETTINGS, observer=cell_observer(SHOWN.append))


def test_the_posterior_is_exact_the_quadrature_agrees_and_each_measure_has_its_surrogate(found):
    """Planted: σ_N² taken as twice what it is."""
    exact(ONE, NOISE / 2).assert_off(found, 0.12, 0.07, 0.1)
    _, sd_error, evidence_error = exact(ONE, NOISE / np.sqrt(2.0)).off(found)
    assert sd_error > 0.2
    assert evidence_error > 0.25
    assert found.quadrature.converged
    assert abs(found.posterior.mean[0] - found.quadrature.mean[0]) < 0.12 * found.quadrature.sd[0]
    assert found.posterior.sd[0] == pytest.approx(found.quadrature.sd[0], rel=0.07)
    assert list(found.surrogates) == ["tracked", "closest"]
    assert found.surrogate is found.surrogates["tracked"]
    predicted = np.asarray(found.surrogate.process.mean(found.posterior.draws[:50]))
    np.testing.assert_allclose(predicted, found.posterior.log_likelihood[:50], rtol=1e-6, atol=1e-6)
    assert not np.array_equal(found.log_likelihoods["tracked"], found.log_likelihoods["closest"])
    squares = np.sum(((20 / found.training[:, :1] - 0.05) * X**2 * (3 - X)) ** 2, axis=1)
    expected = -0.5 * squares / (NOISE / 2) ** 2
    np.testing.assert_allclose(found.log_likelihoods["tracked"], expected, rtol=1e-9, atol=1e-12)


def test_a_notebook_shows_the_stages_and_how_far_each_has_got(found):
    last, shown = re.sub(r"<[^>]+>", "\n", SHOWN[-1]), []
    said = r"forward runs 32/32: 32 ok, 0 failed.*sampling tempering exponent 1\.0000, ESS \d+, accepted \d+%"
    assert re.search(said, last, re.DOTALL)
    assert len(SHOWN) > 34
    observer, own = cell_observer(shown.append), Observer()
    observer.note("before any stage")
    assert shown == []
    observer.stage("forward")
    observer.note("<b>bold</b>")
    assert "&lt;b&gt;bold&lt;/b&gt;" in shown[-1]
    assert observer_or_default(own) is own
    observer_or_default(None).note("nothing happens outside a notebook")


def backwards(model, requests):
    """Make all runs and hand their records over in reverse."""
    yield from reversed(list(InProcess()(model, requests)))


def test_same_bits_whatever_the_order_of_the_runs_and_without_a_ledger(found):
    other = calibrate(found.problem, SETTINGS, executor=backwards)
    np.testing.assert_array_equal(other.posterior.draws, found.posterior.draws)
    np.testing.assert_array_equal(other.posterior.log_weights, found.posterior.log_weights)
    assert other.posterior.log_evidence == found.posterior.log_evidence


def test_another_seed_gives_other_particles_of_the_same_runs(found, folder):
    runs, stages, temperatures = [], [], []
    observer = Observer(
        stage=stages.append,
        run=lambda record, progress: runs.append(record),
        step=lambda info: temperatures.append(float(info.temperature)),
    )
    path = folder / "ledger.sqlite"
    other = calibrate(found.problem, replace(SETTINGS, seed=2), ledger=str(path), observer=observer)
    assert runs == []
    assert stages == ["forward", "surrogate", "sampling", "check"] == list(other.seconds)
    assert temperatures == sorted(temperatures)
    assert temperatures[-1] == 1.0
    assert not np.array_equal(other.posterior.draws, found.posterior.draws)
    assert abs(other.posterior.mean[0] - found.posterior.mean[0]) < 0.15 * found.posterior.sd[0]
    with Ledger.open(path, model=None, read_only=True) as ledger:
        assert ledger.counts().total == 32


def test_every_calibration_says_whether_the_model_explains_the_observation(found):
    """Planted: a wave that no stiffness causes."""
    (seen,) = found.problem.observations
    bent = seen.interface.points + np.stack([0 * X, 0.03 * X * np.sin(3 * np.pi * X)], axis=1)
    observations = (replace(seen, interface=Interface.polyline(bent)),)
    right, wrong = found.misfit, calibrate(replace(found.problem, observations=observations), SETTINGS).misfit
    assert (right.flagged, wrong.flagged) == (False, True)
    assert wrong.verdict.startswith("The model does not explain the observation")
    assert len(right.conditions[0].residual) == 17
    assert any("best runs" in note for note in right.notes)
    assert "a wrong value of tilt, load" in right.notes[-1]


def half_beam(inputs, workdir):
    """Return the beam, failing above 430 Pa."""
    if inputs["E"] > 430:
        raise ForwardModelError("stalled", "above 430 Pa")
    return beam(inputs, workdir)


def test_failed_runs_are_left_out_of_the_training_and_too_few_are_refused(tmp_path):
    found = learnt(tmp_path / "half", problem(space=ONE, model=half_beam), SETTINGS).learnt
    kept, failed = ([one.inputs["E"] for one in found.records if one.ok is ok] for ok in (True, False))
    assert len(kept) + len(failed) == 32
    assert max(kept) <= 430 < min(failed)
    np.testing.assert_array_equal(found.training[:, 0], kept)
    for runs in (1, 2):
        with pytest.raises(TooFewRuns, match=f"too few successful forward runs: got {runs} of {runs}") as caught:
            learnt(tmp_path, problem(space=ONE), replace(SETTINGS, runs=runs))
        assert "at least 3" in caught.value.expected
    asked = replace(problem(space=ONE), fixed={"tilt": 0.02, "load": 1.0})
    said = r"every forward run failed: got 0 of 4 \(4 × large_deflection; e\.g\. the tip"
    with pytest.raises(TooFewRuns, match=said):
        learnt(tmp_path, asked, replace(SETTINGS, runs=4))


VARIANCES = {"light": 0.01**2, "heavy": 0.02**2}


def two_loads(*conditions):
    """Two experiments of one beam; the heavy load says more, its noise is larger."""
    seen = TwoLoads()({"E": 400.0, "load": 1e-5}, Path()).interfaces
    observations = tuple(Observation(seen[name], VARIANCES[name], name) for name in conditions)
    return Problem(TwoLoads(), ONE, {"load": 1e-5}, observations, {"tracked": TrackedPoints()})


def log_likelihoods_of_two_loads(E, *conditions):
    """Return log L of E: the displacement is that at 400 Pa times 400/E."""
    rest, seen = (TwoLoads()({"E": 400.0, "load": load}, Path()).interfaces for load in (0.0, 1e-5))
    squares = sum(np.sum((seen[name].points - rest[name].points) ** 2) / VARIANCES[name] for name in conditions)
    return np.asarray(-0.5 * (400.0 / E - 1.0) ** 2 * squares)


def test_two_conditions_give_the_product_of_their_likelihoods_and_one_that_the_model_lacks_is_refused(tmp_path):
    """Planted: one of the conditions is left out; the one's interface stands in for the other's."""
    asked = two_loads("light")
    wrong = replace(asked, observations=(replace(asked.observations[0], condition="lite"),))
    with pytest.raises(InvalidInput, match="got lite; expected one of light, heavy"):
        answer(tmp_path, wrong, SETTINGS)
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 0
    found, E = answer(tmp_path, two_loads(*VARIANCES), SETTINGS), np.linspace(300.0, 560.0, 20001)
    summed(E[:, None], log_likelihoods_of_two_loads(E, *VARIANCES)).assert_off(found, 0.12, 0.07, 0.1)
    for alone in VARIANCES:
        assert summed(E[:, None], log_likelihoods_of_two_loads(E, alone)).off(found)[1] > 0.15
    expected = log_likelihoods_of_two_loads(found.training[:, 0], *VARIANCES)
    np.testing.assert_allclose(found.log_likelihoods["tracked"], expected, rtol=1e-9, atol=1e-12)


TILTED = ParameterSpace((*ONE.parameters, Parameter("tilt", Uniform(0.0, 0.04), nuisance=True)))


def plain(x, y):
    """Return the Gaussian process behind another face, which knows neither JAX nor derivatives."""
    process = fit_log_likelihood(x, y).process
    return SimpleNamespace(mean=process.mean, variance=process.variance)


def no_surrogate(x, y):
    return float(y.mean())


def test_a_surrogate_of_the_users_is_exact_integrated_and_validated_and_what_is_none_is_refused(tmp_path):
    refined = replace(SETTINGS, refine=Refinement(1, 16), nuisance_values=4, fit=f"{__name__}:plain")
    own = answer(tmp_path, problem(space=TILTED), refined)
    exact(TILTED, NOISE).assert_off(own, 0.2, 0.15, 0.2)
    assert (np.abs(own.posterior.mean - own.quadrature.mean) < 0.15 * own.quadrature.sd).all()
    assert own.laplace.definite
    mean = np.mean([one.mean[0] for one in own.cut_quadrature])
    assert own.under_uncertainty.cut.mean[0] == pytest.approx(mean, abs=0.2 * own.posterior.sd[0])
    built_in = fit_log_likelihood(own.training, own.log_likelihoods["tracked"]).validation
    validation = own.surrogate.validation
    assert (len(own.records), own.surrogate.fit, len(validation.residuals)) == (48, None, len(own.training))
    assert 0 < validation.loo_rms < 100 * built_in.loo_rms
    said = {"no_surrogate": "mean and variance", "NOISE": "a function of inputs", "missing": "a name defined in"}
    for name, words in said.items():
        with pytest.raises(InvalidInput, match=words):
            answer(tmp_path, problem(space=TILTED), replace(SETTINGS, fit=f"{__name__}:{name}"))


def chain(inputs, workdir):
    """A polyline whose heights are the inputs' cumulated sums."""
    heights = np.cumsum([inputs[name] for name in "abcd"])
    return Simulation.of(Interface.polyline(np.stack([np.arange(5.0), np.append(0.0, heights)], axis=1)))


def test_a_study_of_four_inputs_says_whether_the_halves_of_the_particles_agree(tmp_path, capsys):
    """Above three inputs they are compared: in the summary, in the terminal and on the page."""
    content = {"model": {"python": {"function": f"{__name__}:chain"}}, "noise": {"sd": 0.2}, "surrogate": {"field": {}}}
    content["inputs"] = {name: {"prior": {"uniform": [0.0, 1.0]}} for name in "abcd"}
    content["observation"] = {"synthetic": dict.fromkeys("abcd", 0.5)}
    content["sampler"] = {"smc": {"particles": 1000, "rejuvenation_steps": 10}}
    folder = write_study(tmp_path, fixed=None, design={"sobol": {"runs": 32}}, draft=True, **content)
    outcome = run_study(load_study(folder), executor=InProcess())
    show(outcome.summary, outcome.report)
    summary, printed = json.loads((folder / "summary.json").read_text("utf-8")), capsys.readouterr().out
    check, page = summary["sampler_check"], html.unescape(outcome.report.read_text("utf-8"))
    assert check["agree"]
    assert set(check["mean_difference_sd"]) == set(check["sd_ratio"]) == set("abcd")
    assert np.exp(summary["log_evidence"]) == pytest.approx(np.mean(np.exp(check["log_evidence"])), rel=1e-6)
    assert check["verdict"] in printed
    assert check["verdict"] in page
    assert "steps of the first half" in page
    assert not any("independent halves" in warning for warning in summary["warnings"])
