"""A log-likelihood of NumPy arrays is sampled as a compiled one is: the same proposals, the same tosses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.errors import NumericsError
from strandline.smc import SMCSettings, sample, sample_each

SETTINGS = SMCSettings(rejuvenation_steps=4, zeta=0.5)
MEAN = np.array([0.3, 0.4])
NUMBER = 400


@dataclass(frozen=True)
class Host:
    """A function that is called with NumPy arrays."""

    function: Callable[..., Any]
    on_host = True

    def __call__(self, *arguments: np.ndarray) -> Any:
        assert all(type(one) is np.ndarray for one in arguments)
        return self.function(*arguments)


def log_prior(x: Any) -> Any:
    """Uniform on the unit square."""
    return jnp.where(jnp.all((x >= 0) & (x <= 1), axis=-1), 0.0, -jnp.inf)


def compiled(x: Any) -> Any:
    return -0.5 * jnp.sum(((x - MEAN) / 0.1) ** 2, axis=-1)


def on_host(x: np.ndarray) -> np.ndarray:
    return np.asarray(-0.5 * np.sum(((x - MEAN) / 0.1) ** 2, axis=-1))


def given_compiled(x: Any, theta: Any) -> Any:
    return -0.5 * jnp.sum(((x - theta) / 0.1) ** 2, axis=-1)


def given_on_host(x: np.ndarray, theta: np.ndarray) -> np.ndarray:
    return np.asarray(-0.5 * np.sum(((x - theta) / 0.1) ** 2, axis=-1))


@pytest.fixture(scope="module")
def initial() -> np.ndarray:
    return np.random.default_rng(1).random((NUMBER, 2))


def test_the_same_particles_as_compiled(initial: np.ndarray) -> None:
    key = jax.random.key(3)
    there = sample(key, compiled, log_prior, initial, settings=SETTINGS)
    here = sample(key, Host(on_host), log_prior, initial, settings=SETTINGS)
    assert len(here.steps) == len(there.steps) > 1
    np.testing.assert_allclose(here.positions, there.positions, rtol=1e-9)
    np.testing.assert_allclose(here.log_weights, there.log_weights, rtol=1e-9)
    np.testing.assert_allclose(here.log_likelihood, there.log_likelihood, rtol=1e-7, atol=1e-9)
    assert here.log_evidence == pytest.approx(there.log_evidence, rel=1e-9)
    assert here.likelihood_evaluations == there.likelihood_evaluations
    shifted = sample(key, Host(lambda x: on_host(x - 0.05)), log_prior, initial, settings=SETTINGS)
    weights = np.exp(np.asarray(shifted.log_weights))  # planted: the function is shifted
    assert np.abs(weights @ shifted.positions - MEAN).min() > 0.03


def test_nothing_is_asked_where_the_prior_is_zero(initial: np.ndarray) -> None:
    asked: list[np.ndarray] = []

    def function(x: np.ndarray) -> np.ndarray:
        asked.append(x)
        return -20.0 * np.sum(x, axis=1)

    found = sample(jax.random.key(1), Host(function), log_prior, initial, settings=SETTINGS)
    everything = np.concatenate(asked)
    assert everything.min() >= 0.0
    assert everything.max() <= 1.0
    assert len(everything) < found.likelihood_evaluations


def test_undefined_values_are_refused(initial: np.ndarray) -> None:
    with pytest.raises(NumericsError, match="the log-likelihood is nan at"):
        sample(jax.random.key(1), Host(lambda x: np.full(len(x), np.nan)), log_prior, initial, settings=SETTINGS)
    calls: list[int] = []

    def later(x: np.ndarray) -> np.ndarray:
        calls.append(len(x))
        return on_host(x) if len(calls) < 3 else np.full(len(x), np.inf)

    with pytest.raises(NumericsError, match="NaN or \\+inf"):
        sample(jax.random.key(1), Host(later), log_prior, initial, settings=SETTINGS)


def test_each_case_on_the_host_has_its_own_posterior(initial: np.ndarray) -> None:
    """Far inside the unit square the posterior is normal, and the evidence 2πσ²."""
    given = np.array([[0.3, 0.4], [0.7, 0.5], [0.5, 0.6]])
    starts = np.stack([initial, initial, np.random.default_rng(2).random((NUMBER, 2))])
    few = SMCSettings(rejuvenation_steps=8, zeta=0.5)
    found = sample_each(jax.random.key(5), Host(given_on_host), log_prior, starts, given, settings=few)
    for one, mean in zip(found, given, strict=True):
        weights = np.exp(np.asarray(one.log_weights))
        np.testing.assert_allclose(weights @ one.positions, mean, atol=0.025)
        assert one.log_evidence == pytest.approx(np.log(2 * np.pi * 0.1**2), abs=0.35)


@pytest.mark.long
def test_each_case_is_as_compiled(initial: np.ndarray) -> None:
    """One of them needs fewer steps than the others, and is asked nothing more."""
    given = np.array([[0.3, 0.4], [0.7, 0.2], [30.0, 40.0]])
    soft = [Host(lambda x, t: given_on_host(x, t) / (1 + 1e5 * (t[:, 0] > 1)))]
    key, starts = jax.random.key(5), np.stack([initial] * 3)

    def reference(x: Any, theta: Any) -> Any:
        return given_compiled(x, theta) / (1 + 1e5 * (theta[0] > 1))

    there = sample_each(key, reference, log_prior, starts, given, settings=SETTINGS)
    here = sample_each(key, soft[0], log_prior, starts, given, settings=SETTINGS)
    assert len(here[2].steps) < len(here[0].steps)
    for one, other in zip(here, there, strict=True):
        assert len(one.steps) == len(other.steps)
        np.testing.assert_allclose(one.positions, other.positions, rtol=1e-9)
        np.testing.assert_allclose(one.log_weights, other.log_weights, rtol=1e-9)
        assert one.log_evidence == pytest.approx(other.log_evidence, rel=1e-9)
