"""Each warning is there where it is deserved, alone, and not elsewhere."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.study.conftest import Finished
from tests.unit.report.fits import BAD, FINE, condition, misfit

from strandline.calibration import Calibration
from strandline.calibration.sampler_check import SamplerCheck, Split
from strandline.discrepancy import Currents
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import laplace
from strandline.priors import LogNormal
from strandline.report.warnings import LOO_LIMIT, find_warnings, reason_to_doubt


@pytest.fixture
def good(beam: Finished) -> Calibration:
    """The finished calibration, its sampler's result put on that of the quadrature so that no warning is due."""
    calibration = beam.outcome.calibration
    assert calibration.quadrature is not None
    posterior = calibration.posterior
    exact = replace(calibration.quadrature, mean=posterior.mean, sd=posterior.sd, converged=True)
    return with_validation(replace(calibration, quadrature=exact), loo_rms_near_mode=0.1)


def with_validation(calibration: Calibration, **changes: Any) -> Calibration:
    surrogate = calibration.surrogate
    changed = replace(surrogate, validation=replace(surrogate.validation, **changes))
    return replace(calibration, surrogates={"tracked_points": changed})


def with_failures(calibration: Calibration, number: int) -> Calibration:
    records = [replace(record, state="failed", interfaces={}) for record in calibration.records[:number]]
    return replace(calibration, records=(*records, *calibration.records[number:]))


def moved(calibration: Calibration, column: int, share: float, value: float) -> Calibration:
    """Put the first `share` of the particles' weight at one place of the unit cube."""
    posterior = calibration.posterior
    unit = posterior.space.to_unit(posterior.draws.copy())
    unit[np.cumsum(posterior.weights) <= share, column] = value
    changed = replace(posterior, draws=posterior.space.to_physical(unit))
    return with_quadrature(replace(calibration, posterior=changed), mean=changed.mean, sd=changed.sd)


def with_measure(calibration: Calibration, measure: Any) -> Calibration:
    return replace(calibration, problem=replace(calibration.problem, discrepancies={"measure": measure}))


def with_quadrature(calibration: Calibration, **changes: Any) -> Calibration:
    assert calibration.quadrature is not None
    return replace(calibration, quadrature=replace(calibration.quadrature, **changes))


def with_cut_prior(calibration: Calibration) -> Calibration:
    stiffness = Parameter("E", LogNormal(6.0, 0.2), "Pa", (300.0, 560.0))
    space = ParameterSpace((stiffness, calibration.problem.space["tilt"]))
    return replace(calibration, problem=replace(calibration.problem, space=space))


def raised(calibration: Calibration) -> Calibration:
    """Log-likelihoods far above 0, which are impossible."""
    posterior = calibration.posterior
    return replace(calibration, posterior=replace(posterior, log_likelihood=posterior.log_likelihood + 50.0))


def with_halves(calibration: Calibration, difference: float) -> Calibration:
    """The halves of the sampler have means that differ by so many standard deviations, all else is alike."""
    check = SamplerCheck(
        names=calibration.problem.space.names,
        effective=(1000.0, 900.0),
        mean_difference=np.array([difference, 0.0]),
        mean_error=np.full(2, 0.09),
        log_sd_ratio=np.zeros(2),
        log_sd_error=np.full(2, 0.06),
        log_evidence=(-3.0, -3.0),
        log_evidence_error=0.2,
        splits=(Split("E", 400.0, (0.5, 0.5)),),
    )
    return replace(calibration, sampler_check=check)


def of_one_draw(calibration: Calibration) -> Calibration:
    """The last weighting leaves one of many particles."""
    posterior = calibration.posterior
    log_weights = np.full(posterior.number, -1000.0)
    log_weights[posterior.map_index] = 0.0
    return replace(calibration, quadrature=None, posterior=replace(posterior, log_weights=log_weights))


def with_ess(calibration: Calibration, ess: float) -> Calibration:
    return replace(calibration, sampling=replace(calibration.sampling, ess=ess))


def indefinite(calibration: Calibration) -> Calibration:
    return replace(calibration, laplace=laplace(np.diag([-1.0, 1.0]), calibration.posterior.map_estimate))


def far(calibration: Calibration, share: float) -> Calibration:
    posterior = calibration.posterior
    return with_quadrature(calibration, mean=posterior.mean + np.array([share, 0.0]) * posterior.sd)


CASES: list[tuple[Callable[[Calibration], Calibration], str]] = [
    (lambda c: with_failures(c, 20), "20 of 64 forward runs failed"),
    (with_cut_prior, "prior of E was truncated to the design box [300, 560] Pa: 11"),
    (raised, "DO NOT TRUST"),
    (lambda c: with_validation(c, loo_rms_near_mode=0.6), "leave-one-out error near the mode is 0.6"),
    (lambda c: with_ess(c, 99.0), "Only 99 effective samples among 1000"),
    (of_one_draw, "Only 1 effective samples among 1000"),
    (lambda c: with_quadrature(c, converged=False), "has not converged"),
    (lambda c: far(c, 0.06), "means by up to 0.060 standard deviations"),
    (lambda c: with_quadrature(c, sd=c.posterior.sd * 1.07), "standard deviations by up to 6.5%"),
    (
        lambda c: with_halves(c, -0.4),
        "differ by more than 1000 and 900 effective samples explain (p = 5e-05): means by up to 0.40",
    ),
    (lambda c: moved(c, 0, 0.05, 0.01), "posterior of E reaches the lower end of its box, 300 Pa: "),
    (lambda c: moved(c, 1, 0.05, 0.99), "posterior of tilt reaches the upper end of its box, 0.04: "),
    (
        lambda c: moved(moved(moved(c, 0, 0.05, 0.01), 1, 0.1, 0.01), 1, 0.04, 0.99),
        "posterior reaches 3 ends of its box, with the mass within 2% of each: E from 300 Pa (",
    ),
    (indefinite, "no Laplace approximation"),
]
JUST_BELOW: list[Callable[[Calibration], Calibration]] = [
    lambda c: c,
    lambda c: with_failures(c, 19),
    lambda c: with_validation(c, loo_rms_near_mode=0.5),
    lambda c: with_ess(c, 101.0),
    lambda c: far(c, 0.04),
    lambda c: with_quadrature(c, sd=c.posterior.sd * 1.04),
    lambda c: with_halves(c, 0.25),
    lambda c: moved(c, 0, 0.005, 0.01),
    lambda c: moved(c, 0, 0.5, 0.03),
    lambda c: replace(c, quadrature=None),
]


def test_exactly_the_one_that_is_deserved_and_none_just_below_a_limit(good: Calibration) -> None:
    for change, words in CASES:
        found = list(find_warnings(change(good)))
        assert len(found) == 1, (words, found)
        assert words in found[0]
    assert [list(find_warnings(change(good))) for change in JUST_BELOW] == [[]] * len(JUST_BELOW)


def test_an_observation_that_was_turned_and_a_model_that_does_not_fit(good: Calibration) -> None:
    assert [w.partition(" ran")[0] for w in find_warnings(good, turned=("slow",))] == ["The observed points of slow"]
    (warning,) = find_warnings(good, turned=("",))
    assert "turned round" in warning
    flagged = misfit(condition(BAD))
    remedy = " Find out what is wrong, or let the model err: `model_error: true` in `noise`."
    assert list(find_warnings(replace(good, misfit=flagged))) == [flagged.verdict + remedy]
    for fine in (misfit(condition(FINE)), None):
        assert not list(find_warnings(replace(good, misfit=fine)))


def test_the_remedy_for_a_rough_measure_is_named_only_where_there_is_one(good: Calibration) -> None:
    rough = with_validation(good, loo_rms_near_mode=2.0)
    (centre,) = find_warnings(with_measure(rough, Currents(0.005, quadrature="centre")))
    (refined,) = find_warnings(with_measure(rough, Currents(0.005)))
    assert "refined quadrature" in centre
    assert "refined quadrature" not in refined


def test_reasons_to_doubt(good: Calibration) -> None:
    assert reason_to_doubt(good) is None
    assert reason_to_doubt(good, {"verdict": "good"}) is None
    assert "check with the true model" in str(reason_to_doubt(good, {"verdict": "bad"}))
    rough = with_validation(good, loo_rms_near_mode=LOO_LIMIT + 0.4)
    assert "leave-one-out error near the mode 0.9" in str(reason_to_doubt(rough))
    assert good.misfit is not None
    wrong = replace(good, misfit=replace(good.misfit, flagged=True))
    assert reason_to_doubt(wrong) == "the model does not explain what was observed"
    assert "above 0" in str(reason_to_doubt(raised(good)))
