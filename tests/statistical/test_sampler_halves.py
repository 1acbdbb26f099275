"""Two halves of the particles agree where the sampler is right, and tell where it is not, in four and five inputs."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.calibration.sampler_check import SamplerCheck, compare_halves
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.smc import SMCResult, in_halves, sample
from strandline.testing.densities import gaussian


@dataclass(frozen=True, eq=False)
class Target:
    log_likelihood: Callable[[Any], Any]
    low: Any
    high: Any

    @cached_property
    def space(self) -> ParameterSpace:
        ends = zip(self.low, self.high, strict=True)
        return ParameterSpace(tuple(Parameter(f"x{i}", Uniform(float(a), float(b))) for i, (a, b) in enumerate(ends)))

    def sampled(self, particles: int, seed: int) -> SMCResult:
        draws = np.random.default_rng(seed).uniform(self.low, self.high, (particles, len(self.low)))
        run = lambda key, initial: sample(key, self.log_likelihood, self.space.log_prior, initial)  # noqa: E731
        return in_halves(run, jax.random.key(seed), draws)

    def check(self, particles: int, seed: int) -> SamplerCheck:
        found = self.sampled(particles, seed)
        check = compare_halves(found, posterior_of(self.space, found))
        assert check is not None
        return check


def posterior_of(space: ParameterSpace, found: SMCResult) -> Posterior:
    parts = found.log_weights, found.log_likelihood, found.log_prior, found.log_evidence
    return Posterior(space, found.positions, *parts)


def _correlated() -> Target:
    A = np.random.default_rng(5).normal(size=(5, 5))
    known = gaussian(np.zeros(5), A @ A.T + 0.1 * np.eye(5))
    return Target(known.log_likelihood, known.low, known.high)


def _banana(x: Any) -> Any:
    rest = ((x[:, 2:] - 0.2) / 0.1) ** 2
    return -0.5 * (x[:, 0] ** 2 + ((x[:, 1] - 0.5 * x[:, 0] ** 2) / 0.3) ** 2 + rest.sum(axis=1))


def _cut(x: Any) -> Any:
    """A normal distribution around a corner of the box."""
    return -0.5 * ((x - np.array([0.1, 0.0, -1.0, -1.0, -1.0])) ** 2).sum(axis=1) / 0.2**2


def _two_modes(x: Any) -> Any:
    one, other = (-0.5 * ((x - centre) ** 2).sum(axis=1) / 0.3**2 for centre in (1.0, -1.0))
    return jnp.logaddexp(one + np.log(0.6), other + np.log(0.4))


def _funnel(x: Any) -> Any:
    """Four inputs with the standard deviation exp(v/2), v of N(0, 3²): Neal (2003), *Annals of Statistics* 31, 705."""
    v, rest = x[:, 0], x[:, 1:]
    return -(v**2) / 18 - 2 * v - 0.5 * (rest**2).sum(axis=1) * jnp.exp(-v)


def _narrow_mode(x: Any) -> Any:
    """70 % of the mass lies in a mode that is 20 times narrower than the other one in one of five inputs."""
    width = np.array([0.025, 0.5, 0.5, 0.5, 0.5])
    wide = -0.5 * ((x - 1.5) ** 2).sum(axis=1) / 0.5**2 - 5 * np.log(0.5)
    narrow = -0.5 * (((x + 1.5) / width) ** 2).sum(axis=1) - np.log(width).sum()
    return jnp.logaddexp(wide + np.log(0.3), narrow + np.log(0.7))


RIGHT = {
    "correlated": _correlated(),
    "banana": Target(_banana, np.array([-6.0, -4, -2, -2, -2]), np.array([6.0, 20, 2, 2, 2])),
    "cut": Target(_cut, np.array([0.1, 0.0, -1.0, -1.0, -1.0]), np.ones(5)),
    "two modes": Target(_two_modes, np.full(5, -4.0), np.full(5, 4.0)),
}
"""The sampler gets these right; the weights of the two modes have a standard deviation of 0.014."""
WRONG = {
    "funnel": Target(_funnel, np.array([-9.0] + 4 * [-60.0]), np.array([9.0] + 4 * [60.0])),
    "narrow mode": Target(_narrow_mode, np.full(5, -5.0), np.full(5, 5.0)),
}


def test_halves_agree_where_the_sampler_is_right() -> None:
    for name in ("cut", "two modes"):
        assert RIGHT[name].check(5000, 0).agree


def test_a_narrow_mode_is_reported() -> None:
    told = [check.verdict for check in (WRONG["narrow mode"].check(5000, seed) for seed in range(3)) if not check.agree]
    assert told
    assert all("funnel, a narrow mode" in words for words in told)


@pytest.mark.long
def test_few_false_alarms_and_few_misses() -> None:
    """Of 40 seeds each: 2 alarms or fewer if right, 24 or more if wrong."""
    alarms = {
        name: sum(not target.check(5000, 100 + seed).agree for seed in range(40))
        for name, target in {**RIGHT, **WRONG}.items()
    }
    assert all(alarms[name] <= 2 for name in RIGHT), alarms
    assert all(alarms[name] >= 24 for name in WRONG), alarms
