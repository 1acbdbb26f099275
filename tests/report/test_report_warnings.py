"""Each warning is there where it is deserved, alone, and not elsewhere."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Calibration
from strandline.calibration.sampler_check import SamplerCheck, Split
from strandline.discrepancy import Currents
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal
from strandline.report.warnings import find_warnings


@pytest.fixture(scope="module")
def good(reported: Any) -> Calibration:
    """The finished calibration, its sampler's result put on that of the quadrature so that no warning is due."""
    calibration = reported.outcome.calibration
    exact = calibration.quadrature
    validation = replace(calibration.surrogate.validation, loo_rms_near_mode=0.1)
    surrogate = replace(calibration.surrogate, validation=validation)
    exact = replace(exact, mean=calibration.posterior.mean, sd=calibration.posterior.sd, converged=True)
    return replace(calibration, quadrature=exact, surrogates={"tracked_points": surrogate})


def with_validation(calibration: Calibration, **changes: Any) -> Calibration:
    surrogate = calibration.surrogate
    return replace(
        calibration,
        surrogates={"measure": replace(surrogate, validation=replace(surrogate.validation, **changes))},
    )


def with_failures(calibration: Calibration, number: int) -> Calibration:
    records = [replace(record, state="failed", interfaces={}) for record in calibration.records[:number]]
    return replace(calibration, records=(*records, *calibration.records[number:]))


def moved(calibration: Calibration, column: int, share: float, value: float) -> Calibration:
    """Put the first `share` of the particles' weight at one place of the unit cube."""
    posterior = calibration.posterior
    draws = posterior.draws.copy()
    chosen = np.cumsum(posterior.weights) <= share
    unit = posterior.space.to_unit(draws)
    unit[chosen, column] = value
    changed = replace(posterior, draws=posterior.space.to_physical(unit))
    assert calibration.quadrature is not None
    exact = replace(calibration.quadrature, mean=changed.mean, sd=changed.sd)
    return replace(calibration, posterior=changed, quadrature=exact)


def with_measure(calibration: Calibration, measure: Any) -> Calibration:
    return replace(calibration, problem=replace(calibration.problem, discrepancies={"measure": measure}))


def with_quadrature(calibration: Calibration, **changes: Any) -> Calibration:
    assert calibration.quadrature is not None
    return replace(calibration, quadrature=replace(calibration.quadrature, **changes))


def with_cut_prior(calibration: Calibration) -> Calibration:
    stiffness = Parameter("E", LogNormal(6.0, 0.2), "Pa", (300.0, 560.0))
    space = ParameterSpace((stiffness, calibration.problem.space["tilt"]))
    return replace(calibration, problem=replace(calibration.problem, space=space))


def indefinite(calibration: Calibration) -> Calibration:
    from strandline.posterior import laplace

    return replace(calibration, laplace=laplace(np.diag([-1.0, 1.0]), calibration.posterior.map_estimate))


def with_halves(calibration: Calibration, difference: float) -> Calibration:
    """The halves of the sampler have means that differ by so many standard deviations, all else is alike."""
    zero = np.zeros(2)
    check = SamplerCheck(
        names=calibration.problem.space.names,
        effective=(1000.0, 900.0),
        mean_difference=np.array([difference, 0.0]),
        mean_error=np.full(2, 0.09),
        log_sd_ratio=zero,
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


CASES: dict[str, tuple[Callable[[Calibration], Calibration], str]] = {
    "failures": (lambda c: with_failures(c, 20), "20 of 64 forward runs failed"),
    "prior": (with_cut_prior, "prior of E was truncated to the design box [300, 560] Pa: 11"),
    "impossible": (
        lambda c: replace(c, posterior=replace(c.posterior, log_likelihood=c.posterior.log_likelihood + 50.0)),
        "DO NOT TRUST",
    ),
    "surrogate": (lambda c: with_validation(c, loo_rms_near_mode=0.6), "leave-one-out error near the mode is 0.6"),
    "samples": (lambda c: replace(c, sampling=replace(c.sampling, ess=39.0)), "Only 39 effective samples among 400"),
    "weights": (of_one_draw, "Only 1 effective samples among 400"),
    "not converged": (lambda c: with_quadrature(c, converged=False), "has not converged"),
    "means": (
        lambda c: with_quadrature(c, mean=c.posterior.mean + np.array([0.06, 0.0]) * c.posterior.sd),
        "means by up to 0.060 standard deviations",
    ),
    "deviations": (lambda c: with_quadrature(c, sd=c.posterior.sd * 1.07), "standard deviations by up to 6.5%"),
    "halves": (
        lambda c: with_halves(c, -0.4),
        "differ by more than 1000 and 900 effective samples explain (p = 5e-05): means by up to 0.40",
    ),
    "lower": (lambda c: moved(c, 0, 0.05, 0.01), "posterior of E reaches the lower end of its box, 300 Pa: "),
    "upper": (lambda c: moved(c, 1, 0.05, 0.99), "posterior of tilt reaches the upper end of its box, 0.04: "),
    "three ends": (
        lambda c: moved(moved(moved(c, 0, 0.05, 0.01), 1, 0.1, 0.01), 1, 0.04, 0.99),
        "posterior reaches 3 ends of its box, with the mass within 2% of each: E from 300 Pa (",
    ),
    "laplace": (indefinite, "no Laplace approximation"),
}


def test_none_where_all_is_well(good: Calibration) -> None:
    assert list(find_warnings(good)) == []


@pytest.mark.parametrize("case", CASES)
def test_exactly_the_one_that_is_deserved(good: Calibration, case: str) -> None:
    change, words = CASES[case]
    (warning,) = find_warnings(change(good))
    assert words in warning


@pytest.mark.parametrize(
    "change",
    [
        lambda c: with_failures(c, 19),
        lambda c: with_validation(c, loo_rms_near_mode=0.5),
        lambda c: replace(c, sampling=replace(c.sampling, ess=41.0)),
        lambda c: with_quadrature(c, mean=c.posterior.mean + 0.04 * c.posterior.sd),
        lambda c: with_quadrature(c, sd=c.posterior.sd * 1.04),
        lambda c: with_halves(c, 0.25),
        lambda c: moved(c, 0, 0.005, 0.01),
        lambda c: moved(c, 0, 0.5, 0.03),
        lambda c: replace(c, quadrature=None),
    ],
    ids=[
        "failures",
        "surrogate",
        "samples",
        "means",
        "deviations",
        "halves",
        "little at the bound",
        "near it",
        "no quadrature",
    ],
)
def test_none_just_below_a_limit(good: Calibration, change: Callable[[Calibration], Calibration]) -> None:
    assert list(find_warnings(change(good))) == []


def test_an_observation_that_was_turned(good: Calibration) -> None:
    assert [w.partition(" ran")[0] for w in find_warnings(good, turned=("slow",))] == ["The observed points of slow"]
    (warning,) = find_warnings(good, turned=("",))
    assert "turned round" in warning


def test_the_remedy_for_a_rough_measure_is_named_only_where_there_is_one(good: Calibration) -> None:
    rough = with_validation(good, loo_rms_near_mode=2.0)
    (centre,) = find_warnings(with_measure(rough, Currents(0.005, quadrature="centre")))
    (refined,) = find_warnings(with_measure(rough, Currents(0.005)))
    assert "refined quadrature" in centre
    assert "refined quadrature" not in refined
