"""Pareto smoothing: against ArviZ, against samples of known shape, and at the edges."""

import math
import warnings
from itertools import product

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.posterior.pareto_smoothing import (
    GeneralisedPareto,
    SmoothedWeights,
    fit_generalised_pareto,
    largest_usual_k_hat,
    pareto_smoothed,
    reliability_threshold,
    verdict_on,
)

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import arviz

RATIOS = {
    "bounded": lambda rng, n: np.log(rng.uniform(size=n)),
    "normal log ratios, narrow": lambda rng, n: 0.3 * rng.normal(size=n),
    "normal log ratios, wide": lambda rng, n: 4.0 * rng.normal(size=n) + 300.0,
    "exponential": lambda rng, n: np.log(rng.exponential(size=n)),
    "Pareto, k = 0.5": lambda rng, n: 0.5 * rng.exponential(size=n),
    "Pareto, k = 1": lambda rng, n: rng.exponential(size=n),
    "Student, 3 degrees of freedom": lambda rng, n: 0.4 * rng.standard_t(3, size=n),
}


@pytest.mark.skipif(not hasattr(arviz, "psislw"), reason="ArviZ 1.x has no psislw and other tails")
def test_weights_and_shape_are_those_of_arviz() -> None:
    for number, ratios in product((25, 200, 1000), RATIOS.values()):
        log_ratios = ratios(np.random.default_rng(3), number)
        found = pareto_smoothed(log_ratios)
        wanted, k_hat = arviz.psislw(log_ratios)
        np.testing.assert_allclose(found.log_weights, wanted, rtol=0, atol=1e-10)
        assert found.k_hat == pytest.approx(float(k_hat), abs=1e-10)
        assert found.ess == pytest.approx(1 / np.sum(np.exp(wanted) ** 2))
    log_ratios = np.random.default_rng(4).normal(size=200)
    log_ratios[:150:2] = -np.inf
    kept, found = np.isfinite(log_ratios), pareto_smoothed(log_ratios)
    wanted, k_hat = arviz.psislw(np.where(kept, log_ratios, -1e5))
    assert found.k_hat == pytest.approx(float(k_hat), abs=1e-10)
    np.testing.assert_allclose(found.log_weights[kept], wanted[kept], atol=1e-10)
    assert (found.weights[~kept] == 0).all()


def test_the_fit_finds_shape_and_scale_of_its_own_samples() -> None:
    """Standard errors of maximum likelihood: (1 + k)/√n for k, σ √(2(1 + k)/n) for σ (Smith 1987)."""
    for shape in (-0.3, 0.0, 0.8):
        truth, number, rng = GeneralisedPareto(shape, 2.0), 1000, np.random.default_rng(5)
        fits = [fit_generalised_pareto(np.sort(truth.quantile(rng.uniform(size=number)))) for _ in range(200)]
        z_shape = np.array([(fit.shape - shape) * math.sqrt(number) / (1 + shape) for fit in fits])
        z_scale = np.array([(fit.scale / 2 - 1) * math.sqrt(number / (2 * (1 + shape))) for fit in fits])
        for z in (z_shape, z_scale):
            assert abs(z.mean()) < 0.25, "three and a half standard errors"
            assert 0.8 < z.std() < 1.2


def test_the_quantile_inverts_the_distribution() -> None:
    p = np.array([0.01, 0.5, 0.99])
    for shape in (-0.5, 0.7):
        x = GeneralisedPareto(shape, 3.0).quantile(p)
        np.testing.assert_allclose((1 + shape * x / 3.0) ** (-1 / shape), 1 - p)
    np.testing.assert_allclose(GeneralisedPareto(0.0, 3.0).quantile(p), -3 * np.log1p(-p))
    np.testing.assert_allclose(GeneralisedPareto(1e-9, 3.0).quantile(p), -3 * np.log1p(-p), rtol=1e-7)


def test_a_constant_changes_nothing_and_the_largest_raw_weight_is_kept_to() -> None:
    log_ratios = 2.0 * np.random.default_rng(6).normal(size=400)
    one, other = pareto_smoothed(log_ratios), pareto_smoothed(log_ratios - 1234.0)
    np.testing.assert_allclose(one.log_weights, other.log_weights, atol=1e-9)
    assert one.weights.sum() == pytest.approx(1.0)
    gain = (one.log_weights - log_ratios)[np.argsort(log_ratios)[:300]]
    np.testing.assert_allclose(gain, gain[0], err_msg="the body keeps its ratios")
    assert one.log_weights.max() <= log_ratios.max() + gain[0] + 1e-12


def test_equal_weights_have_no_tail_and_a_few_that_have_all_the_weight_are_bad() -> None:
    rng = np.random.default_rng(7)
    for log_ratios in (np.full(50, 3.0), 100.0 + 1e-13 * rng.normal(size=50)):
        found = pareto_smoothed(log_ratios)
        assert found.k_hat == -math.inf
        assert verdict_on(found) == "good"
        np.testing.assert_allclose(found.weights, 1 / 50)
    log_ratios = np.full(50, -np.inf)
    log_ratios[:4] = [0.0, -0.1, -0.3, -1.0]
    found = pareto_smoothed(log_ratios)
    assert found.k_hat == math.inf
    assert verdict_on(found) == "bad"
    np.testing.assert_allclose(found.weights[:4], np.exp(log_ratios[:4]) / np.exp(log_ratios[:4]).sum())


def test_the_verdict_depends_on_the_number_of_draws_and_on_how_much_the_weights_differ() -> None:
    """k̂ has no scale: a hundredth of a Cauchy tail changes no estimate, the tail itself rules it."""
    assert reliability_threshold(100) == pytest.approx(0.5)
    assert reliability_threshold(1000) == pytest.approx(2 / 3)
    assert reliability_threshold(100_000) == 0.7

    def verdicts(number: int, *shapes: float) -> list[str]:
        log_ratios = np.random.default_rng(number).normal(size=number)
        weights = np.asarray(log_ratios - np.log(np.exp(log_ratios).sum()))
        return [verdict_on(SmoothedWeights(weights, k)) for k in shapes]

    assert verdicts(10_000, 0.49, 0.5, 0.69, 0.7, 3.0) == ["good", "usable", "usable", "bad", "bad"]
    assert verdicts(20, 0.2, 0.25) == ["good", "bad"]
    tail = np.abs(np.random.default_rng(8).standard_cauchy(500))
    slight, heavy = pareto_smoothed(np.log1p(1e-4 * tail)), pareto_smoothed(np.log(tail))
    assert min(slight.k_hat, heavy.k_hat) > 0.7
    assert [verdict_on(found) for found in (slight, heavy)] == ["good", "bad"]


def test_ratios_that_are_none_are_refused() -> None:
    for wrong in ([0.0] * 4, [0.0] * 9 + [math.nan], [0.0] * 9 + [math.inf], [-math.inf] * 9):
        with pytest.raises(InvalidInput, match="log ratios of importance sampling"):
            pareto_smoothed(np.array(wrong))
    assert pareto_smoothed(np.zeros(5)).ess == pytest.approx(5)


def test_the_usual_k_hat_is_exceeded_by_one_set_of_normal_log_ratios_in_a_hundred() -> None:
    """Few draws show a heavy tail less often than many do. Sets of the same rounded spread share their limit."""
    random = np.random.default_rng(5)
    base = 0.2 * random.standard_normal(43)
    limit = largest_usual_k_hat(base)
    above = [pareto_smoothed(0.2 * random.standard_normal(43)).k_hat > limit for _ in range(300)]
    assert 0.0 <= np.mean(above) <= 0.03
    with_nothing = np.concatenate([np.full(10, -np.inf), base[:33]])
    assert largest_usual_k_hat(with_nothing) == pytest.approx(largest_usual_k_hat(base[:33]), abs=0.2)
    heavy = [pareto_smoothed(np.log(1.0 + random.pareto(0.8, size=43))).k_hat for _ in range(100)]
    assert np.mean([k_hat > max(limit, 0.5) for k_hat in heavy]) > 0.2
