"""Through a surrogate that is unsure, the expected likelihood is sampled, not that of the predicted interface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from tests.calibration.arches import SPACE
from tests.likelihood.test_near_field import LOCAL, around, by, knowledge, likelihood, widened

from strandline.calibration.method import _sample
from strandline.calibration.problem import Observer, Settings
from strandline.calibration.targets import FieldTarget
from strandline.design.active import Knowledge
from strandline.design.active.sampling import posterior_state
from strandline.discrepancy import Currents, NormalOffset
from strandline.posterior.weighted import Weighted
from strandline.smc import SMCSettings

WIDENING = 3e7
"""Makes the field more uncertain than the noise."""
KINDS = ["nearby", "no likelihood nearby"]


@cache
def unsure(kind: str) -> Knowledge:
    """Return what runs teach of arches, with a surrogate that is unsure of them."""
    found = likelihood(LOCAL) if kind == "nearby" else by(Currents(0.03, quadrature="centre"), 1.0, 0.004)[0]
    known = knowledge(NormalOffset(), {"": found.observations[0]})
    return replace(known, likelihood=widened(found, WIDENING))


@cache
def grid(kind: str, *, plug_in: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the posterior by direct sums, on finer and finer grids."""
    known, low, high = unsure(kind), SPACE.low, SPACE.high
    for _ in range(3):
        ends = [np.linspace(*pair, 40) for pair in zip(low, high, strict=True)]
        x = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
        found = Weighted(x, softmax(known.plug_in(x) if plug_in else known.expected(x)))
        reach = 5 * found.sd + (high - low) / 40
        low, high = np.maximum(found.mean - reach, SPACE.low), np.minimum(found.mean + reach, SPACE.high)
    return found.mean, found.sd


def effective(log_weights: np.ndarray, ratios: np.ndarray) -> float:
    """Return the share of particles that are effective when weighted by these log ratios."""
    return float(np.exp(2 * logsumexp(log_weights + ratios) - logsumexp(log_weights + 2 * ratios)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_closed_form_is_that_of_draws(kind: str) -> None:
    target, x = FieldTarget(unsure(kind), SPACE), around(LOCAL, 40)
    expected, plug_in = target.knowledge.expected(x), target.knowledge.plug_in(x)
    assert np.sqrt(np.mean((plug_in - expected) ** 2)) > 10 * np.sqrt(np.mean((target.values(x) - expected) ** 2))
    np.testing.assert_array_equal(target.compiled(x), target.values(x))


@pytest.mark.parametrize("kind", KINDS)
def test_the_expected_posterior_is_sampled(kind: str) -> None:
    target = FieldTarget(unsure(kind), SPACE)
    settings = Settings(particles=1500, smc=SMCSettings(rejuvenation_steps=8, zeta=0.5))
    sampling = _sample(target, SPACE, settings, Observer())
    posterior = target.posterior(sampling)
    mean, sd = grid(kind)
    assert np.abs((posterior.mean - mean) / sd).max() < 0.15
    assert np.abs(np.log(posterior.sd / sd)).max() < 0.12
    assert np.abs(np.log(grid(kind, plug_in=True)[1] / sd)).max() > 0.2
    assert effective(sampling.log_weights, posterior.log_likelihood - sampling.log_likelihood) > 0.95
    effect = target.checks(sampling, posterior, None, seed=1).field
    assert effect is not None
    assert effect.effect.effective < 0.9
    plain = grid(kind, plug_in=True)[1]
    np.testing.assert_allclose(np.log(effect.effect.sd_ratio), np.log(sd / plain), atol=0.15)


@pytest.mark.parametrize("kind", KINDS)
def test_an_active_design_weights_its_particles_to_it(kind: str) -> None:
    """It samples the likelihood of the predicted interface, so that its runs stay near what is known."""
    state = posterior_state(unsure(kind), SPACE, (3,))
    mean, sd = grid(kind)
    assert np.abs((state.mean - mean) / sd).max() < 0.2
    assert np.abs(np.log(state.sd / sd)).max() < 0.15
    plain = Weighted(state.positions, np.exp(state.log_weights_plug_in))
    assert np.abs(np.log(plain.sd / sd)).max() > 0.2
