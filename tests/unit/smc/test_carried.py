"""Particles of one likelihood carried over to another one, against normal posteriors."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from strandline.smc import SMCResult, SMCSettings, carried, carried_over

SETTINGS = SMCSettings(rejuvenation_steps=10)
EXTENTS = np.full(2, 8.0)
SCOUTS = np.random.default_rng(7).standard_normal((2000, 2))


def log_prior(x):
    return -0.5 * (x**2).sum(axis=-1) - np.log(2 * np.pi)


def around(mean, sd=0.5):
    return lambda x: -0.5 * (((x - np.asarray(mean)) / sd) ** 2).sum(axis=1)


def exact(mean, sd=0.5):
    """Return mean, standard deviation and log evidence of the posterior."""
    variance = 1 / (1 + 1 / sd**2)
    evidence = -0.5 * (np.asarray(mean) ** 2).sum() / (1 + sd**2) + np.log(sd**2 / (1 + sd**2))
    return np.asarray(mean) * variance / sd**2, np.sqrt(variance), evidence


def particles(mean=(0.4, 0.0), number=2000, seed=1):
    centre, sd, evidence = exact(mean)
    x = centre + sd * np.random.default_rng(seed).standard_normal((number, 2))
    equal, values = np.full(number, -np.log(number)), around(mean)(x)
    return SMCResult(x, equal, values, np.asarray(log_prior(x)), float(evidence), float(number), (), 0)


def carried_to(mean, found=None, key=0, likelihood=None):
    start = particles() if found is None else found
    options = {"scouts": SCOUTS, "extents": EXTENTS, "settings": SETTINGS}
    return carried_over(jax.random.key(key), start, likelihood or around(mean), log_prior, **options)


def test_it_is_the_other_posterior_and_moves_only_if_the_weights_are_uneven():
    before = particles()
    for mean, moves in [((0.42, 0.01), 0), ((0.7, -0.2), 10)]:
        found = carried_to(mean, before)
        centre, sd, evidence = exact(mean)
        w = np.exp(found.log_weights)
        assert w.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(w @ found.positions, centre, atol=0.12 * sd)
        np.testing.assert_allclose(np.sqrt(w @ (found.positions - centre) ** 2), sd, rtol=0.1)
        assert found.log_evidence == pytest.approx(evidence, abs=0.1)
        np.testing.assert_allclose(found.log_likelihood, around(mean)(found.positions))
        np.testing.assert_allclose(found.log_prior, log_prior(found.positions), rtol=1e-6)
        assert found.likelihood_evaluations == 2000 * (1 + moves)
        assert (found.positions != before.positions).any() == (moves > 0)
        assert found.ess > 0.9 * 2000


def test_what_is_far_is_not_reached():
    assert carried_to((2.5, 2.0)) is None
    near = around((0.42, 0.01))
    corner = SCOUTS[SCOUTS[:1000].sum(axis=1).argmin()]
    two = lambda x: np.logaddexp(near(x), 3 + around(corner, 0.1)(x))  # noqa: E731
    np.testing.assert_allclose(two(particles().positions), near(particles().positions))
    assert carried_to((0.42, 0.01), likelihood=near) is not None
    assert carried_to((0.42, 0.01), likelihood=two) is None  # a heavy mode that no particle sees
    unknown = replace(particles(), log_evidence=float("nan"))
    assert carried_to((0.42, 0.01), unknown) is None


def test_weights_that_are_forgotten_show(monkeypatch):
    """Planted: resampling that takes all particles as equal."""
    plain = carried.rejuvenate
    equal = lambda key, state, *given, **options: plain(  # noqa: E731
        key, state._replace(log_weights=0 * state.log_weights - np.log(2000)), *given, **{**options, "moves": 1}
    )
    monkeypatch.setattr(carried, "rejuvenate", equal)
    mean = (0.9, -0.3)
    found = carried_to(mean)
    centre, sd, _ = exact(mean)
    off = np.abs(np.exp(found.log_weights) @ found.positions - centre) / sd
    assert off.max() > 0.15
