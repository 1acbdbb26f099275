"""Two halves of the particles agree where the sampler is right, and tell where it is not, in four and five inputs."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.calibration.sampler_check import compare_halves
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.smc import in_halves, sample
from strandline.testing.densities import gaussian


@dataclass(frozen=True, eq=False)
class Target:
    log_likelihood: Any
    low: Any
    high: Any

    @cached_property
    def space(self):
        ends = zip(self.low, self.high, strict=True)
        return ParameterSpace(tuple(Parameter(f"x{i}", Uniform(float(a), float(b))) for i, (a, b) in enumerate(ends)))

    def check(self, seed):
        draws = np.random.default_rng(seed).uniform(self.low, self.high, (5000, len(self.low)))
        run = lambda key, initial: sample(key, self.log_likelihood, self.space.log_prior, initial)  # noqa: E731
        found = in_halves(run, jax.random.key(seed), draws)
        parts = found.log_weights, found.log_likelihood, found.log_prior, found.log_evidence
        return compare_halves(found, Posterior(self.space, found.positions, *parts))


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
    "correlated": Target(CORRELATED.log_likelihood, CORRELATED.low, CORRELATED.high),
    "banana": Target(banana, np.array([-6.0, -4, -2, -2, -2]), np.array([6.0, 20, 2, 2, 2])),
    "cut": Target(cut, EDGE, np.ones(5)),
    "two modes": Target(two_modes, np.full(5, -4.0), np.full(5, 4.0)),
}
"""The sampler gets these right; the weights of the two modes have a standard deviation of 0.014."""
WRONG = {
    "funnel": Target(funnel, np.array([-9.0] + 4 * [-60.0]), np.array([9.0] + 4 * [60.0])),
    "narrow mode": Target(narrow_mode, np.full(5, -5.0), np.full(5, 5.0)),
}


def test_halves_agree_where_the_sampler_is_right_and_a_narrow_mode_is_reported():
    assert RIGHT["cut"].check(0).agree
    assert RIGHT["two modes"].check(0).agree
    told = [check.verdict for check in map(WRONG["narrow mode"].check, range(3)) if not check.agree]
    assert told
    assert all("funnel, a narrow mode" in words for words in told)


@pytest.mark.long
def test_few_false_alarms_and_few_misses():
    """Of 40 seeds each: 2 alarms or fewer if right, 24 or more if wrong."""
    targets, seeds = {**RIGHT, **WRONG}, range(100, 140)
    alarms = {name: sum(not target.check(seed).agree for seed in seeds) for name, target in targets.items()}
    assert all(alarms[name] <= 2 for name in RIGHT), alarms
    assert all(alarms[name] >= 24 for name in WRONG), alarms
