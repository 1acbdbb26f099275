"""Through a surrogate that is unsure, the expected likelihood is sampled, not that of the predicted interface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from tests.unit.calibration.arches import SPACE, knowledge
from tests.unit.likelihood.near_arches import LOCAL, around, by, likelihood, widened

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


@cache
def unsure(kind: str) -> Knowledge:
    """Return what runs teach of arches, with a surrogate that is unsure of them."""
    found = likelihood(LOCAL) if kind == "nearby" else by(Currents(0.03, quadrature="centre"), 0.004)
    known = knowledge(NormalOffset(), {"": found.observations[0]})
    return replace(known, likelihood=widened(found, WIDENING))


def on_grid(known: Knowledge, *, plug_in: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and sd of the posterior by direct sums, on finer and finer grids."""
    low, high = SPACE.low, SPACE.high
    for _ in range(3):
        ends = [np.linspace(*pair, 24) for pair in zip(low, high, strict=True)]
        x = np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 2)
        found = Weighted(x, softmax(known.plug_in(x) if plug_in else known.expected(x)))
        reach = 5 * found.sd + (high - low) / 24
        low, high = np.maximum(found.mean - reach, SPACE.low), np.minimum(found.mean + reach, SPACE.high)
    return found.mean, found.sd


@pytest.mark.parametrize("kind", ["nearby", "no likelihood nearby"])
def test_the_expected_posterior_is_sampled(kind: str) -> None:
    """An active design samples the likelihood of the predicted interface, and weights its particles to it."""
    known, x = unsure(kind), around(LOCAL, 40)
    target = FieldTarget(known, SPACE)
    expected, plug_in = known.expected(x), known.plug_in(x)
    assert np.sqrt(np.mean((plug_in - expected) ** 2)) > 10 * np.sqrt(np.mean((target.values(x) - expected) ** 2))
    np.testing.assert_array_equal(target.compiled(x), target.values(x))

    settings = Settings(particles=600, smc=SMCSettings(rejuvenation_steps=6, zeta=0.5))
    sampling = _sample(target, SPACE, settings, Observer())
    posterior = target.posterior(sampling)
    (mean, sd), (_, plain) = on_grid(known), on_grid(known, plug_in=True)
    assert np.abs((posterior.mean - mean) / sd).max() < 0.15
    assert np.abs(np.log(posterior.sd / sd)).max() < 0.12
    assert np.abs(np.log(plain / sd)).max() > 0.2
    log_weights, ratios = sampling.log_weights, posterior.log_likelihood - sampling.log_likelihood
    assert np.exp(2 * logsumexp(log_weights + ratios) - logsumexp(log_weights + 2 * ratios)) > 0.95
    effect = target.checks(sampling, posterior, None, seed=1).field
    assert effect is not None
    assert effect.effect.effective < 0.9
    np.testing.assert_allclose(np.log(effect.effect.sd_ratio), np.log(sd / plain), atol=0.15)

    state = posterior_state(known, SPACE, (3,))
    assert np.abs((state.mean - mean) / sd).max() < 0.2
    assert np.abs(np.log(state.sd / sd)).max() < 0.15
    weighted = Weighted(state.positions, np.exp(state.log_weights_plug_in))
    assert np.abs(np.log(weighted.sd / sd)).max() > 0.2
