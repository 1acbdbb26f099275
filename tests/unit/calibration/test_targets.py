"""What is sampled: the expected likelihood where a surrogate is unsure, its derivatives; whether two halves agree."""

import re
from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from tests.unit.calibration.arches import SPACE, knowledge
from tests.unit.likelihood.near_arches import LOCAL, around, by, likelihood, widened

from strandline.calibration import method
from strandline.calibration.method import _sample
from strandline.calibration.problem import Observer, Settings
from strandline.calibration.sampler_check import LEVEL, compare_halves
from strandline.calibration.targets import FieldTarget, central_hessian
from strandline.design.active import Active
from strandline.discrepancy import Currents, NormalOffset
from strandline.foundations import InvalidInput
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Posterior, Weighted
from strandline.smc import SMCResult, SMCSettings, StepInfo, combined, in_halves
from strandline.smc.combined import joined


def on_grid(log_likelihood):
    """Return mean and sd of the posterior by direct sums, on finer and finer grids."""
    low, high = SPACE.low, SPACE.high
    for _ in range(3):
        ends = [np.linspace(*pair, 24) for pair in zip(low, high, strict=True)]
        x = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
        found = Weighted(x, softmax(log_likelihood(x)))
        reach = 5 * found.sd + (high - low) / 24
        low, high = np.maximum(found.mean - reach, SPACE.low), np.minimum(found.mean + reach, SPACE.high)
    return found.mean, found.sd


@pytest.mark.parametrize("nearby", [True, False])
def test_the_expected_posterior_is_sampled(nearby):
    """The surrogate is less certain than the noise."""
    found = likelihood(LOCAL) if nearby else by(Currents(0.03, quadrature="centre"), 0.004)
    known = replace(knowledge(NormalOffset(), {"": found.observations[0]}), likelihood=widened(found, 3e7))
    target, x = FieldTarget(known, SPACE), around(LOCAL, 40)
    expected, plug_in = known.expected(x), known.plug_in(x)
    assert np.sqrt(np.mean((plug_in - expected) ** 2)) > 10 * np.sqrt(np.mean((target.values(x) - expected) ** 2))
    np.testing.assert_array_equal(target.compiled(x), target.values(x))

    settings = Settings(particles=600, smc=SMCSettings(rejuvenation_steps=6, zeta=0.5))
    sampling = _sample(target, SPACE, settings, Observer())
    posterior = target.posterior(sampling)
    (mean, sd), (_, plain) = on_grid(known.expected), on_grid(known.plug_in)
    assert np.abs((posterior.mean - mean) / sd).max() < 0.15
    assert np.abs(np.log(posterior.sd / sd)).max() < 0.12
    assert np.abs(np.log(plain / sd)).max() > 0.2
    log_weights, ratios = sampling.log_weights, posterior.log_likelihood - sampling.log_likelihood
    assert np.exp(2 * logsumexp(log_weights + ratios) - logsumexp(log_weights + 2 * ratios)) > 0.95
    effect = target.checks(sampling, posterior, None, seed=1)["field"].effect
    assert effect.effective < 0.9
    np.testing.assert_allclose(np.log(effect.sd_ratio), np.log(sd / plain), atol=0.15)


@pytest.mark.stand_in
@pytest.mark.parametrize(("spread", "kept"), [(1e6, True), (1.0, False)])
def test_a_posterior_of_which_draws_would_leave_one_particle_keeps_its_weights(spread, kept):
    """Noise thousands of times too small, and a surrogate that is unsure: draws of the interface decide nothing."""
    x, equal = (
        SPACE.low + np.random.default_rng(1).random((200, 2)) * (SPACE.high - SPACE.low),
        np.full(200, -np.log(200)),
    )
    known = SimpleNamespace(
        plug_in=lambda x: np.zeros(200), expected=lambda x, plug_in: spread * x[:, 0] / np.ptp(x[:, 0])
    )
    sampling = SimpleNamespace(
        positions=x, log_weights=equal, log_likelihood=np.zeros(200), log_prior=np.zeros(200), log_evidence=-3.0
    )
    posterior = FieldTarget(known, SPACE).posterior(sampling)
    assert (posterior.ess > 199.99, posterior.log_evidence == -3.0, (posterior.sd > 0).all()) == (kept, kept, True)


def test_an_active_design_needs_a_surrogate_of_the_field_and_begins_with_the_runs_of_the_settings():
    assert Settings(runs=8, active=Active(30), surrogate="field").active == Active(30, initial=8)
    with pytest.raises(InvalidInput, match="got log_likelihood; expected field"):
        Settings(runs=8, active=Active(30))
    with pytest.raises(InvalidInput, match="after the first 8 runs: runs: got 10; expected at least 14"):
        Settings(runs=8, active=Active(10), surrogate="field")
    with pytest.raises(InvalidInput, match="the first ones: got 8; expected initial=9"):
        Settings(runs=8, active=Active(30, initial=9), surrogate="field")


@pytest.mark.stand_in
@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("runs", "ten", "a whole number"),
        ("runs", True, "a whole number"),
        ("runs", 2.5, "a whole number"),
        ("runs", -3, "a whole number, 0 or above"),
        ("particles", -5, "a whole number, 2 or above"),
        ("seed", "x", "a whole number"),
        ("surrogate", "feild", "log_likelihood or field"),
        ("active", 30, "Active or None"),
        ("draft", 1, "True or False"),
        ("smc", {"zeta": 0.5}, "SMCSettings"),
    ],
)
def test_settings_refuse_a_value_of_another_type_or_out_of_range(name, value, expected):
    with pytest.raises(InvalidInput, match=re.escape(f"{name}: got {value!r}; expected {expected}")):
        Settings(**{name: value})


@pytest.mark.stand_in
def test_nothing_is_drawn_twice_with_the_same_random_numbers_if_particles_cannot_be_carried_over(monkeypatch):
    keys = []
    monkeypatch.setattr(method, "sample", lambda key, *_, **__: keys.append(key) or "particles")
    monkeypatch.setattr(method, "carried_over", lambda key, *_, **__: keys.append(key))
    _sample(SimpleNamespace(warm_up_densities=(1, 2), compiled=3), SPACE, Settings(particles=8), Observer())
    assert len(keys) == len({tuple(jax.random.key_data(key).tolist()) for key in keys}) == 5


LOW, HIGH = np.array([-1.0, 0.0, 100.0]), np.array([1.0, 2.0, 800.0])
A = np.array([[3.0, 0.5, 0.01], [0.5, 2.0, -0.02], [0.01, -0.02, 0.001]])


def test_the_hessian_of_a_quadratic_is_exact_at_the_edge_too_and_its_error_of_second_order():
    """Points outside the box are not asked for, whatever the step."""

    def quadratic(x):
        assert ((x >= LOW) & (x <= HIGH)).all()
        return 1.0 + x @ np.array([1.0, -2.0, 0.3]) - 0.5 * np.einsum("pi,ij,pj->p", x, A, x)

    for x in ([0.1, 0.7, 300.0], [-1.0, 2.0, 100.0], [1.0, 1e-9, 799.9]):
        for step in (0.01, 10.0):
            found = central_hessian(quadratic, np.array(x), step * np.array([1.0, 1.0, 100.0]), LOW, HIGH)
            np.testing.assert_allclose(found, -A, rtol=1e-5, atol=1e-6)

    def wavy(x):
        return np.sin(2 * x[:, 0] + x[:, 1]) + 1e-6 * x[:, 2] ** 2

    x, step = np.array([0.1, 0.7, 300.0]), np.array([0.1, 0.1, 20.0])
    exact = np.diag([0, 0, 2e-6]) - np.sin(0.9) * np.array([[4, 2, 0], [2, 1, 0], [0, 0, 0]])
    errors = [np.abs(central_hessian(wavy, x, step / k, LOW, HIGH) - exact).max() for k in (1, 2)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


FOUR = ParameterSpace(tuple(Parameter(f"x{i}", Uniform(-10.0, 10.0)) for i in range(4)))


def normal(seed, *, mean=0.0, sd=1.0, log_evidence=-3.0):
    """Return a thousand equal particles of a normal distribution in four inputs, which has log L = -½|x|²."""
    x = np.random.default_rng(seed).standard_normal((1000, 4))
    x[:, 0] = mean + sd * x[:, 0]
    equal, log_prior = np.full(1000, -np.log(1000)), np.full(1000, -4 * np.log(20))
    steps = (StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0),)
    return SMCResult(x, equal, -0.5 * (x**2).sum(axis=1), log_prior, log_evidence, 1000.0, steps, 16_000)


def compared(found):
    parts = found.log_weights, found.log_likelihood, found.log_prior, found.log_evidence
    return compare_halves(found, Posterior(FOUR, found.positions, *parts))


def test_the_halves_have_their_own_particles_and_keys_and_repeat_to_the_bit():
    calls, initial = [], np.arange(28.0).reshape(7, 4)

    def run(key, initial):
        calls.append((jax.random.key_data(key).tolist(), initial))
        return normal(len(calls) % 2)

    for _ in range(2):
        found = in_halves(run, jax.random.key(3), initial)
    (first, a), (second, b), (again, _), _ = calls
    assert again == first != second
    np.testing.assert_array_equal(np.concatenate([a, b]), initial)
    np.testing.assert_array_equal(found.positions, np.concatenate([one.positions for one in found.halves]))
    assert in_halves(run, jax.random.key(3), initial[: combined.FEWEST - 1]).halves is None


def test_figures_of_halves_that_differ():
    check = compared(joined(normal(1), normal(2, mean=1.0, sd=2.0, log_evidence=-2.0)))
    x, y = normal(1).positions, normal(2, mean=1.0, sd=2.0).positions
    assert check.effective == pytest.approx((1000, 1000))
    np.testing.assert_allclose(np.exp(check.log_sd_ratio), x.std(axis=0) / y.std(axis=0))
    weights = np.repeat([1.0, np.e], 1000) / (1000 * (1 + np.e))
    pooled = np.concatenate([x, y])
    sd = np.sqrt(weights @ (pooled - weights @ pooled) ** 2)
    np.testing.assert_allclose(check.mean_difference, (x.mean(axis=0) - y.mean(axis=0)) / sd)
    assert check.log_evidence == pytest.approx((-3.0, -2.0))
    grid = np.linspace(-8, 8, 2001)[:, None]
    apart = (x[:, 0] <= grid).mean(axis=1) - (y[:, 0] <= grid).mean(axis=1)
    assert check.splits[0].difference == pytest.approx(np.abs(apart).max(), abs=0.005)


def test_each_difference_is_found_and_what_a_thousand_related_particles_explain_is_none():
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
        assert (check.agree, check.p < LEVEL) == (False, True)
        assert words in check.verdict
    check = compared(joined(normal(1), normal(2, mean=0.2, sd=1.15)))
    assert np.abs(check.mean_difference).max() > 0.1
    assert (check.agree, check.p > LEVEL) == (True, True)
