"""Two halves of the particles agree by chance, or differ: the figures, and what is said of them."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from strandline.calibration.sampler_check import LEVEL, SamplerCheck, compare_halves
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.smc import SMCResult, StepInfo, halves, in_halves
from strandline.smc.halves import joined

SPACE = ParameterSpace(tuple(Parameter(f"x{i}", Uniform(-10.0, 10.0)) for i in range(4)))
STEPS = (StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0),)


def normal(seed: int, *, mean: float = 0.0, sd: float = 1.0, log_evidence: float = -3.0) -> SMCResult:
    """A thousand equal particles of a normal distribution in four inputs, which has log L = -½|x|²."""
    x = np.random.default_rng(seed).standard_normal((1000, 4))
    x[:, 0] = mean + sd * x[:, 0]
    values = -0.5 * (x**2).sum(axis=1)
    equal = np.full(1000, -np.log(1000))
    return SMCResult(x, equal, values, np.full(1000, -4 * np.log(20)), log_evidence, 1000.0, STEPS, 16_000)


def compared(found: SMCResult, weighted: SMCResult | None = None) -> SamplerCheck:
    by = weighted or found
    posterior = Posterior(SPACE, by.positions, by.log_weights, by.log_likelihood, by.log_prior, by.log_evidence)
    check = compare_halves(found, posterior)
    assert check is not None
    return check


def test_the_union_is_weighted_by_evidence_and_number() -> None:
    one, other = normal(1, log_evidence=-3.0), normal(2, log_evidence=-3.0 + np.log(3.0))
    found = joined(one, other)
    assert found.log_evidence == pytest.approx(-3.0 + np.log(2.0))
    weights = np.exp(found.log_weights)
    assert weights[:1000].sum() == pytest.approx(0.25)
    assert weights.sum() == pytest.approx(1.0)
    assert found.ess == pytest.approx(1.0 / (weights**2).sum())
    assert found.likelihood_evaluations == 32_000
    assert found.halves == (one, other)
    np.testing.assert_array_equal(found.positions[1000:], other.positions)
    first = {name: getattr(one, name)[:500] for name in ("positions", "log_likelihood", "log_prior")}
    found = joined(one, replace(one, **first, log_weights=np.full(500, -np.log(500))))
    np.testing.assert_allclose(np.exp(found.log_weights), 1 / 1500)
    assert found.log_evidence == pytest.approx(-3.0)


def test_the_halves_have_their_own_particles_and_keys_and_repeat_to_the_bit() -> None:
    calls: list[Any] = []

    def run(key: Any, initial: Any) -> SMCResult:
        calls.append((jax.random.key_data(key).tolist(), initial))
        return normal(len(calls) % 2)

    initial = np.arange(28.0).reshape(7, 4)
    for _ in range(2):
        in_halves(run, jax.random.key(3), initial)
    (first, a), (second, b), (again, _), _ = calls
    assert first != second
    assert first == again
    np.testing.assert_array_equal(np.concatenate([a, b]), initial)
    assert (len(a), len(b)) == (4, 3)
    alone = in_halves(run, jax.random.key(3), initial[: halves.FEWEST - 1])
    assert alone.halves is None
    posterior = Posterior(
        SPACE, alone.positions, alone.log_weights, alone.log_likelihood, alone.log_prior, alone.log_evidence
    )
    assert compare_halves(alone, posterior) is None


def test_figures_of_halves_that_differ() -> None:
    check = compared(joined(normal(1), normal(2, mean=1.0, sd=2.0, log_evidence=-2.0)))
    x, y = normal(1).positions, normal(2, mean=1.0, sd=2.0).positions
    assert check.effective == pytest.approx((1000, 1000))
    np.testing.assert_allclose(np.exp(check.log_sd_ratio), x.std(axis=0) / y.std(axis=0))
    weights = np.repeat([1.0, np.e], 1000) / (1000 * (1 + np.e))
    pooled = np.concatenate([x, y])
    sd = np.sqrt(weights @ (pooled - weights @ pooled) ** 2)
    np.testing.assert_allclose(check.mean_difference, (x.mean(axis=0) - y.mean(axis=0)) / sd)
    assert check.log_evidence == pytest.approx((-3.0, -2.0))
    split = check.splits[0]
    assert split.shares == pytest.approx(((x[:, 0] <= split.at).mean(), (y[:, 0] <= split.at).mean()))
    grid = np.linspace(-8, 8, 2001)[:, None]
    apart = (x[:, 0] <= grid).mean(axis=1) - (y[:, 0] <= grid).mean(axis=1)
    assert split.difference == pytest.approx(np.abs(apart).max(), abs=0.005)
    told = " ".join(check.differences)
    for words in ("means by up to", "(x0)", "by a factor of up to 2.0", "of the mass has", "log-evidences by 1.00"):
        assert words in told
    assert check.p < 1e-6


def test_each_difference_is_found_and_what_a_thousand_related_particles_explain_is_none() -> None:
    """Planted: most of one half lies in two clumps, with the same mean and nearly the same width."""
    assert compared(joined(normal(1), normal(2))).agree
    clumps = normal(2).positions.copy()
    clumps[:400, 1], clumps[400:800, 1] = -0.95, 0.95
    for other, words in (
        (normal(2, mean=0.5), "means by up to 0."),
        (normal(2, sd=1.3), "a factor of up to 1.3"),
        (normal(2, log_evidence=-2.5), "log-evidences by 0.50"),
        (replace(normal(2), positions=clumps), "of the mass has x1 up to"),
    ):
        check = compared(joined(normal(1), other))
        assert not check.agree
        assert check.p < LEVEL
        assert words in check.verdict
        assert "funnel, a narrow mode" in check.verdict
    check = compared(joined(normal(1), normal(2, mean=0.2, sd=1.15)))
    assert np.abs(check.mean_difference).max() > 0.1
    assert check.agree
    assert check.p > LEVEL


def test_equal_values_are_one_place() -> None:
    one, other = (replace(normal(seed), log_likelihood=np.zeros(1000)) for seed in (1, 2))
    assert compared(joined(one, other)).splits[-1].difference == pytest.approx(0.0, abs=1e-9)


def test_weights_of_another_likelihood_count() -> None:
    """The posterior's weights may follow from an expected likelihood; each half is weighted by it alone."""
    found = joined(normal(1), normal(2))
    tilt = 0.5 * found.positions[:, 0]
    log_weights = found.log_weights + tilt
    increment = float(np.logaddexp.reduce(log_weights))
    moved = replace(
        found,
        log_weights=log_weights - increment,
        log_likelihood=found.log_likelihood + tilt,
        log_evidence=found.log_evidence + increment,
    )
    check, first = compared(found, moved), np.exp(tilt[:1000])
    assert check.log_evidence[0] == pytest.approx(-3.0 + np.log(first.mean()))
    assert check.effective[0] == pytest.approx(first.sum() ** 2 / (first**2).sum())
    assert np.logaddexp(*check.log_evidence) - np.log(2) == pytest.approx(moved.log_evidence)
    assert check.agree
