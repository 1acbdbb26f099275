"""The whole method, on a beam whose posterior is known; by a surrogate of the user's; of four inputs."""

import html
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.study.calibration.beams import NOISE, ONE, SETTINGS, X, answer, exact, learnt, problem, summed

from strandline.calibration import Problem, calibrate
from strandline.calibration.problem import cell_observer, observer_or_default
from strandline.cli.run import show
from strandline.design.refinement import Refinement
from strandline.discrepancy import ClosestPoint, TrackedPoints
from strandline.foundations import ForwardModelError, InvalidInput, TooFewRuns
from strandline.interface import Interface, Observation
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.surrogate import fit_log_likelihood
from strandline.testing.models import TwoLoads
from strandline.testing.studies import beam, write_study

SHOWN = []
"""What a notebook shows below its cell, from step to step."""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Two measures; the first one makes the posterior."""
    asked = problem(space=ONE, noise=NOISE / 2, closest=ClosestPoint())
    return answer(tmp_path_factory.mktemp("calibrate"), asked, SETTINGS, observer=cell_observer(SHOWN.append))


def test_the_posterior_is_exact_the_quadrature_agrees_and_each_measure_has_its_surrogate(found):
    """Planted: σ_N² taken as twice what it is."""
    exact(ONE, NOISE / 2).assert_off(found, 0.12, 0.07, 0.1)
    _, sd_error, evidence_error = exact(ONE, NOISE / np.sqrt(2.0)).off(found)
    assert sd_error > 0.2
    assert evidence_error > 0.25
    assert found.quadrature.converged
    assert abs(found.posterior.mean[0] - found.quadrature.mean[0]) < 0.12 * found.quadrature.sd[0]
    assert found.posterior.sd[0] == pytest.approx(found.quadrature.sd[0], rel=0.07)
    assert not np.array_equal(found.log_likelihoods["tracked"], found.log_likelihoods["closest"])
    squares = np.sum(((20 / found.training[:, :1] - 0.05) * X**2 * (3 - X)) ** 2, axis=1)
    expected = -0.5 * squares / (NOISE / 2) ** 2
    np.testing.assert_allclose(found.log_likelihoods["tracked"], expected, rtol=1e-9, atol=1e-12)


def test_a_notebook_shows_the_stages_and_how_far_each_has_got(found):
    last = re.sub(r"<[^>]+>", "\n", SHOWN[-1])
    said = r"forward runs 32/32: 32 ok, 0 failed.*sampling tempering exponent 1\.0000, ESS \d+, accepted \d+%"
    assert re.search(said, last, re.DOTALL)
    observer_or_default(None).note("nothing happens outside a notebook")


def backwards(model, requests):
    """Make all runs and hand their records over in reverse."""
    yield from reversed(list(InProcess()(model, requests)))


def test_same_bits_whatever_the_order_of_the_runs_and_without_a_ledger(found):
    other = calibrate(found.problem, SETTINGS, executor=backwards)
    np.testing.assert_array_equal(other.posterior.draws, found.posterior.draws)
    assert other.posterior.log_evidence == found.posterior.log_evidence


def test_every_calibration_says_whether_the_model_explains_the_observation(found):
    """Planted: a wave that no stiffness causes."""
    (seen,) = found.problem.observations
    bent = seen.interface.points + np.stack([0 * X, 0.03 * X * np.sin(3 * np.pi * X)], axis=1)
    observations = (replace(seen, interface=Interface.polyline(bent)),)
    right, wrong = found.misfit, calibrate(replace(found.problem, observations=observations), SETTINGS).misfit
    assert (right.flagged, wrong.flagged) == (False, True)
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
    with pytest.raises(TooFewRuns, match="too few successful forward runs: got 2 of 2"):
        learnt(tmp_path, problem(space=ONE), replace(SETTINGS, runs=2))
    asked = replace(problem(space=ONE), fixed={"tilt": 0.02, "load": 1.0})
    with pytest.raises(
        TooFewRuns, match=r"every forward run failed: got 0 of 4 \(4 × large_deflection\).*; e\.g\. the"
    ):
        learnt(tmp_path, asked, replace(SETTINGS, runs=4))


def test_the_example_of_a_failure_keeps_its_remedy(tmp_path):
    told = f"nodes.txt has too few fields: {'1.0 ' * 40}; expected 4. Write blanks between the numbers."

    def fails(inputs, workdir):
        raise ForwardModelError("unreadable", told)

    with pytest.raises(TooFewRuns, match=re.escape(told)):
        learnt(tmp_path, problem(space=ONE, model=fails), replace(SETTINGS, runs=4))


VARIANCES = {"light": 0.01**2, "heavy": 0.02**2}
"""The heavy load says more, its noise is larger."""


def test_two_conditions_give_the_product_of_their_likelihoods_and_one_that_the_model_lacks_is_refused(tmp_path):
    """The displacement is that at 400 Pa times 400/E. Planted: one of the conditions is left out."""
    rest, seen = (TwoLoads()({"E": 400.0, "load": load}, tmp_path).interfaces for load in (0.0, 1e-5))
    observations = tuple(Observation(seen[name], variance, name) for name, variance in VARIANCES.items())
    asked = Problem(TwoLoads(), ONE, {"load": 1e-5}, observations, {"tracked": TrackedPoints()})
    found, E = answer(tmp_path, asked, SETTINGS), np.linspace(300.0, 560.0, 20001)
    squares = [np.sum((seen[name].points - rest[name].points) ** 2) / VARIANCES[name] for name in VARIANCES]
    both, *alone = (summed(E[:, None], -0.5 * (400 / E - 1) ** 2 * one) for one in (sum(squares), *squares))
    both.assert_off(found, 0.12, 0.07, 0.1)
    assert min(one.off(found)[1] for one in alone) > 0.15
    wrong = replace(asked, observations=(replace(observations[0], condition="lite"),))
    with pytest.raises(InvalidInput, match="got lite; expected one of light, heavy"):
        answer(tmp_path, wrong, SETTINGS)


@pytest.mark.stand_in
def test_what_calibrate_cannot_use_is_refused_before_any_run(tmp_path):
    seen = Observation(beam({"E": 400.0, "tilt": 0.0, "load": 1e-5}, tmp_path).interface, NOISE**2)
    asked = Problem(
        lambda *_: pytest.fail("a run was made"), ONE, {"load": 1e-5}, (seen,), {"tracked": TrackedPoints()}
    )
    for settings, executor, message in (
        ({"runs": 8}, None, "settings: got .*; expected Settings"),
        (SETTINGS, "local", "executor: got local; expected an executor"),
        (SETTINGS, InProcess, "executor: got <class"),
    ):
        with pytest.raises(InvalidInput, match=message):
            calibrate(asked, settings, executor=executor)
    with pytest.raises(InvalidInput, match=r"known inputs of the problem: got .*load.*heavy"):
        replace(asked, fixed={"load": "heavy"})
    with pytest.raises(InvalidInput, match="known too: got E"):
        replace(asked, fixed={"load": 1e-5, "E": 400.0})
    with pytest.raises(InvalidInput, match="measures of the problem"):
        replace(asked, discrepancies={})
    with pytest.raises(InvalidInput, match="a given run: got no E"):
        calibrate(asked, SETTINGS, given=[{"load": 1e-5}])
    kilo = ParameterSpace((replace(ONE.parameters[0], unit="kPa"),))
    with pytest.raises(InvalidInput, match="unit of E: got kPa; expected Pa"):
        calibrate(replace(asked, model=TwoLoads(), space=kilo), SETTINGS)


TILTED = ParameterSpace((*ONE.parameters, Parameter("tilt", Uniform(0.0, 0.04), nuisance=True)))


def plain(x, y):
    """Return the Gaussian process behind another face, which knows neither JAX nor derivatives."""
    process = fit_log_likelihood(x, y).process
    return SimpleNamespace(mean=process.mean, variance=process.variance)


def test_a_surrogate_of_the_users_is_exact_integrated_and_validated_and_what_is_none_is_refused(tmp_path):
    refined = replace(SETTINGS, refine=Refinement(1, 16), nuisance_values=4, fit=f"{__name__}:plain")
    own = answer(tmp_path, problem(space=TILTED), refined)
    exact(TILTED, NOISE).assert_off(own, 0.2, 0.15, 0.2)
    assert (np.abs(own.posterior.mean - own.quadrature.mean) < 0.15 * own.quadrature.sd).all()
    mean = np.mean([one.mean[0] for one in own.cut_quadrature])
    assert own.under_uncertainty.cut.mean[0] == pytest.approx(mean, abs=0.2 * own.posterior.sd[0])
    built_in = fit_log_likelihood(own.training, own.log_likelihoods["tracked"]).validation
    assert 0 < own.surrogate.validation.loo_rms < 100 * built_in.loo_rms
    with pytest.raises(InvalidInput, match="a name defined in"):
        answer(tmp_path, problem(space=TILTED), replace(SETTINGS, fit=f"{__name__}:missing"))


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
    check = outcome.summary["sampler_check"]
    assert check["agree"]
    assert np.exp(outcome.summary["log_evidence"]) == pytest.approx(np.mean(np.exp(check["log_evidence"])), rel=1e-6)
    assert check["verdict"] in capsys.readouterr().out
    assert check["verdict"] in html.unescape(outcome.report.read_text("utf-8"))
