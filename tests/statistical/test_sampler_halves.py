"""Two halves of the particles agree where the sampler is right, and tell where it is not, in four and five inputs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.densities import gaussian

from strandline.calibration.sampler_check import compare_halves
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Posterior
from strandline.smc import in_halves, sample


def target(log_likelihood, low, high):
    """Return a density in a box, with the box."""
    ends = zip(low, high, strict=True)
    space = tuple(Parameter(f"x{i}", Uniform(float(a), float(b))) for i, (a, b) in enumerate(ends))
    return log_likelihood, ParameterSpace(space)


def check(given, seed):
    log_likelihood, space = given
    draws = np.random.default_rng(seed).uniform(space.low, space.high, (5000, space.dim))
    run = lambda key, initial: sample(key, log_likelihood, space.log_prior, initial)  # noqa: E731
    found = in_halves(run, jax.random.key(seed), draws)
    parts = found.log_weights, found.log_likelihood, found.log_prior, found.log_evidence
    return compare_halves(found, Posterior(space, found.positions, *parts))


A = np.random.default_rng(5).normal(size=(5, 5))
CORRELATED = gaussian(np.zeros(5), A @ A.T + 0.1 * np.eye(5))
EDGE = np.array([0.1, 0.0, -1.0, -1.0, -1.0])


def banana(x):
    rest = ((x[:, 2:] - 0.2) / 0.1) ** 2
    return -0.5 * (x[:, 0] ** 2 + ((x[:, 1] - 0.5 * x[:, 0] ** 2) / 0.3) ** 2 + rest.sum(axis=1))


def cut(x):
    """A normal distribution around a corner of the box."""
    return -0.5 * ((x - EDGE) ** 2).sum(axis=1) / 0.2**2


def two_modes(x):
    one, other = (-0.5 * ((x - centre) ** 2).sum(axis=1) / 0.3**2 for centre in (1.0, -1.0))
    return jnp.logaddexp(one + np.log(0.6), other + np.log(0.4))


def funnel(x):
    """Four inputs with the standard deviation exp(v/2), v of N(0, 3²): Neal (2003), *Annals of Statistics* 31, 705."""
    v, rest = x[:, 0], x[:, 1:]
    return -(v**2) / 18 - 2 * v - 0.5 * (rest**2).sum(axis=1) * jnp.exp(-v)


def narrow_mode(x):
    """70 % of the mass lies in a mode that is 20 times narrower than the other one in one of five inputs."""
    width = np.array([0.025, 0.5, 0.5, 0.5, 0.5])
    wide = -0.5 * ((x - 1.5) ** 2).sum(axis=1) / 0.5**2 - 5 * np.log(0.5)
    narrow = -0.5 * (((x + 1.5) / width) ** 2).sum(axis=1) - np.log(width).sum()
    return jnp.logaddexp(wide + np.log(0.3), narrow + np.log(0.7))


RIGHT = {
    "correlated": target(CORRELATED.log_likelihood, CORRELATED.low, CORRELATED.high),
    "banana": target(banana, np.array([-6.0, -4, -2, -2, -2]), np.array([6.0, 20, 2, 2, 2])),
    "cut": target(cut, EDGE, np.ones(5)),
    "two modes": target(two_modes, np.full(5, -4.0), np.full(5, 4.0)),
}
"""The sampler gets these right; the weights of the two modes have a standard deviation of 0.014."""
WRONG = {
    "funnel": target(funnel, np.array([-9.0] + 4 * [-60.0]), np.array([9.0] + 4 * [60.0])),
    "narrow mode": target(narrow_mode, np.full(5, -5.0), np.full(5, 5.0)),
}


def test_halves_agree_where_the_sampler_is_right_and_a_narrow_mode_is_reported():
    assert check(RIGHT["cut"], 0).agree
    assert check(RIGHT["two modes"], 0).agree
    told = [one.verdict for one in (check(WRONG["narrow mode"], seed) for seed in range(3)) if not one.agree]
    assert told
    assert "funnel, a narrow mode" in told[0]


@pytest.mark.long
def test_few_false_alarms_and_few_misses():
    """Of 40 seeds each: 2 alarms or fewer if right, 24 or more if wrong."""
    targets, seeds = {**RIGHT, **WRONG}, range(100, 140)
    alarms = {name: sum(not check(one, seed).agree for seed in seeds) for name, one in targets.items()}
    assert all(alarms[name] <= 2 for name in RIGHT), alarms
    assert all(alarms[name] >= 24 for name in WRONG), alarms
