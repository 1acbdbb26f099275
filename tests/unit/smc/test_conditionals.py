"""Several posteriors side by side are what the sampler of one gives, and NumPy's functions what compiled ones give."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.foundations import InvalidInput, NumericsError
from strandline.smc import SMCSettings, sample, sample_each

QUICK = SMCSettings(rejuvenation_steps=4, zeta=0.5)
GIVEN = np.array([[-1.0, 0.3], [0.0, 0.1], [2.0, 1.0]])
"""Centre and width of each likelihood."""
INITIAL = np.random.default_rng(1).normal(size=(3, 1000, 2))


def log_likelihood(x, given):
    return -0.5 * ((x[:, 0] - given[0]) / given[1]) ** 2 - 0.5 * (x[:, 1] + given[0]) ** 2


def log_prior(x):
    return -0.5 * (x**2).sum(axis=-1) - np.log(2 * np.pi)


def run(log_likelihood=log_likelihood, initial=INITIAL, given=GIVEN, settings=QUICK):
    return sample_each(jax.random.key(0), log_likelihood, log_prior, initial, given, settings=settings)


@pytest.fixture(scope="module")
def together():
    return run()


def assert_same(found, other, evidence=1e-9):
    np.testing.assert_allclose(found.positions, other.positions, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.log_weights, other.log_weights, rtol=1e-9)
    np.testing.assert_allclose(found.log_likelihood, other.log_likelihood, rtol=1e-7, atol=1e-9)
    assert found.log_evidence == pytest.approx(other.log_evidence, rel=evidence)
    assert found.likelihood_evaluations == other.likelihood_evaluations
    assert len(found.steps) == len(other.steps)


@pytest.mark.long
def test_each_case_is_what_the_sampler_gives_with_its_value_fixed(together):
    for case, found in enumerate(together):
        key, alone = jax.random.fold_in(jax.random.key(0), case), lambda x, at=GIVEN[case]: log_likelihood(x, at)
        assert_same(found, sample(key, alone, log_prior, INITIAL[case], settings=QUICK), evidence=1e-12)
        np.testing.assert_allclose(found.log_likelihood, log_likelihood(found.positions, GIVEN[case]), rtol=1e-9)
    assert len({len(found.steps) for found in together}) > 1, "all end at once: nobody stands still"


def test_evidence_and_moments_are_exact(together):
    """x0: N(0, 1) times exp(-½((x0 - c)/w)²); x1 likewise with centre -c and width 1."""
    for (centre, width), found in zip(GIVEN, together, strict=True):
        total = 1 + width**2
        log_evidence = np.log(width) - 0.5 * np.log(total) - 0.5 * centre**2 / total - 0.5 * np.log(2) - centre**2 / 4
        assert found.log_evidence == pytest.approx(log_evidence, abs=0.25)
        weights = np.exp(found.log_weights)
        assert weights @ found.positions[:, 0] == pytest.approx(centre / total, abs=0.2 * width)
        assert weights @ found.positions[:, 1] == pytest.approx(-centre / 2, abs=0.16)


def test_cases_do_not_share_their_random_numbers():
    same = run(initial=np.stack([INITIAL[0]] * 3), given=np.stack([GIVEN[0]] * 3))
    assert not np.array_equal(same[0].positions, same[1].positions)


def test_failures_name_the_value():
    def undefined(x, given):
        return jnp.where(given[0] > 1.0, jnp.nan, jnp.where(given[0] == 0.0, -jnp.inf, log_likelihood(x, given)))

    for rows, words in (([0, 2, 2], r"given \[2\.0, 1\.0\]: the log"), ([0, 1, 1], r"given \[0\.0, 0\.1\]: all 1000")):
        with pytest.raises(NumericsError, match=words):
            run(undefined, given=GIVEN[rows])
    with pytest.raises(InvalidInput, match="3 sets for"):
        run(given=GIVEN[:2])
    with pytest.raises(NumericsError, match="1 tempering steps reached only"):
        run(settings=replace(QUICK, maximum_steps=1))


MEAN, NUMBER = np.array([0.3, 0.4]), 400
UNIT = np.random.default_rng(1).random((NUMBER, 2))


def on_host(function):
    """Return the function as one that is called with NumPy arrays."""

    def called(*arguments):
        assert all(type(one) is np.ndarray for one in arguments)
        return function(*arguments)

    called.on_host = True
    return called


def in_unit(x):
    return jnp.where(jnp.all((x >= 0) & (x <= 1), axis=-1), 0.0, -jnp.inf)


def bell(x, theta=MEAN):
    return -0.5 * (((x - theta) / 0.1) ** 2).sum(axis=-1)


def hosted(function, key=1):
    return sample(jax.random.key(key), on_host(function), in_unit, UNIT, settings=QUICK)


def test_the_same_particles_as_compiled():
    """Planted: the function is shifted."""
    here, there = hosted(bell, key=3), sample(jax.random.key(3), bell, in_unit, UNIT, settings=QUICK)
    assert_same(here, there)
    assert len(here.steps) > 1
    shifted = hosted(lambda x: bell(x - 0.05), key=3)
    assert np.abs(np.exp(shifted.log_weights) @ shifted.positions - MEAN).min() > 0.03


def test_nothing_is_asked_where_the_prior_is_zero_and_undefined_values_are_refused():
    asked = []

    def function(x):
        asked.append(x)
        return -20.0 * np.sum(x, axis=1)

    found, everything = hosted(function), np.concatenate(asked)
    assert 0.0 <= everything.min() < everything.max() <= 1.0
    assert len(everything) < found.likelihood_evaluations
    calls = []

    def later(x):
        calls.append(len(x))
        return bell(x) if len(calls) < 3 else np.full(len(x), np.inf)

    with pytest.raises(NumericsError, match=r"NaN or \+inf"):
        hosted(later)


def test_each_case_on_the_host_has_its_own_posterior():
    """Far inside the unit square the posterior is normal, and the evidence 2πσ²."""
    given, few = np.array([[0.3, 0.4], [0.7, 0.5], [0.5, 0.6]]), SMCSettings(rejuvenation_steps=8, zeta=0.5)
    starts = np.stack([UNIT, UNIT, np.random.default_rng(2).random((NUMBER, 2))])
    found = sample_each(jax.random.key(5), on_host(bell), in_unit, starts, given, settings=few)
    for one, mean in zip(found, given, strict=True):
        np.testing.assert_allclose(np.exp(one.log_weights) @ one.positions, mean, atol=0.025)
        assert one.log_evidence == pytest.approx(np.log(2 * np.pi * 0.1**2), abs=0.35)
