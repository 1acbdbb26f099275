"""The sampler of one posterior: parts of a step, all steps, what is refused; particles carried over to another one."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from tests.densities import gaussian

from strandline.foundations import InvalidInput, NumericsError
from strandline.smc import SMCResult, SMCSettings, StepInfo, carried_over, combined, metropolis, sample, sampler
from strandline.smc.combined import joined
from strandline.smc.moves import proposal_factor, proposal_scale
from strandline.smc.steps import systematic
from strandline.smc.tempering import effective_sample_size, next_temperature

STEP = StepInfo(1.0, 900.0, 0.3, True, -3.0, 1.0)
WEIGHTS = np.random.default_rng(4).dirichlet(0.5 * np.ones(25))
next_one = jax.jit(next_temperature)


def size(weights):
    return weights.sum() ** 2 / (weights**2).sum()


@pytest.mark.parametrize(("zeta", "scale", "temperature"), [(0.3, 1e23, 0.0), (0.995, 300.0, 0.2)])
def test_the_step_keeps_the_wanted_share(zeta, scale, temperature):
    rng = np.random.default_rng(1)
    log_weights, log_likelihood = rng.normal(size=400), -scale * rng.random(400) ** 2

    def excess(logarithm):
        after = np.exp(log_weights + np.exp(logarithm) * (log_likelihood - log_likelihood.max()))
        return size(after) - zeta * size(np.exp(log_weights))

    expected = np.exp(brentq(excess, -100.0, np.log(1 - temperature)))
    found = float(next_one(log_weights, log_likelihood, temperature, zeta))
    assert found - temperature == pytest.approx(expected, rel=1e-6)


def test_the_last_step_ends_at_one_and_particles_of_zero_likelihood_neither_stop_it_nor_count():
    weights = np.random.default_rng(0).random(50)
    assert float(effective_sample_size(jnp.log(weights) - 1e4)) == pytest.approx(size(weights))
    slight = 1e-3 * np.random.default_rng(1).normal(size=400)
    assert float(next_one(np.zeros(400), slight, 0.3, 0.9)) == 1.0
    alive = -10 * np.random.default_rng(2).random(240)
    with_dead = np.concatenate([alive, np.full(160, -np.inf)])
    plain, found = (float(next_one(np.zeros(len(v)), v, 0.0, 0.9)) for v in (alive, with_dead))
    assert 0 < plain < 1
    assert found == pytest.approx(plain)


KEYS = jax.random.split(jax.random.key(3), 2000)
ancestors = jax.jit(jax.vmap(systematic, (0, None)))


def worst_z(counts):
    """Return the largest |z| of the mean offspring; the ⌊⌋/⌈⌉ law has variance f(1 - f), f the fraction."""
    expected = 25 * WEIGHTS
    fraction = expected - np.floor(expected)
    error = np.sqrt(fraction * (1 - fraction) / len(counts))
    return np.abs((counts.mean(axis=0) - expected) / error).max()


def test_offspring_are_unbiased_and_one_off_at_most():
    """The planted bug: a constant offset."""
    counts = np.stack([np.bincount(row, minlength=25) for row in np.asarray(ancestors(KEYS, jnp.log(WEIGHTS)))])
    assert (counts >= np.floor(25 * WEIGHTS)).all()
    assert (counts <= np.ceil(25 * WEIGHTS)).all()
    assert worst_z(counts) < 4.5
    planted = np.searchsorted(np.cumsum(WEIGHTS), (np.arange(25) + 0.5) / 25)
    assert worst_z(np.tile(np.bincount(planted, minlength=25), (2000, 1))) > 10
    for dead in (0, 3, 24):
        assert dead not in np.asarray(ancestors(KEYS, np.where(np.arange(25) == dead, -np.inf, 0.0)))
    np.testing.assert_array_equal(ancestors(KEYS, np.full(25, -7.0)), np.tile(np.arange(25), (2000, 1)))


@pytest.mark.parametrize("log_evidence", [-4.0, 300.0])
def test_joined_runs_count_by_their_evidence(log_evidence):
    """The second run has three times the particles and a third of the evidence of the first."""

    def run(number, at, log_evidence):
        x, equal, zero = np.full((number, 1), at), np.full(number, -np.log(number)), np.zeros(number)
        return SMCResult(x, equal, zero, zero, log_evidence, float(number), (STEP,), 10 * number)

    both = joined(run(100, 0.0, log_evidence + np.log(3)), run(300, 1.0, log_evidence))
    weights = np.exp(both.log_weights)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ both.positions[:, 0] == pytest.approx(0.5)
    assert both.log_evidence == pytest.approx(log_evidence + np.log(1.5))
    assert both.ess == pytest.approx(1 / (0.25 / 100 + 0.25 / 300))
    assert both.likelihood_evaluations == 4000


def test_scale_of_the_paper_factor_of_the_weighted_covariance_and_a_collapsed_population_can_still_move():
    np.testing.assert_allclose([float(proposal_scale(jnp.asarray(p))) for p in (0.0, 0.25, 1.0)], [1 / 81, 1 / 9, 1])
    rng = np.random.default_rng(0)
    x, w = rng.normal(size=(300, 3)) * [1, 100, 1e-4], rng.dirichlet(np.ones(300))
    factor = proposal_factor(jnp.asarray(x), jnp.asarray(w), jnp.zeros(3))
    np.testing.assert_allclose(factor @ factor.T, np.cov(x.T, aweights=w, ddof=0), rtol=1e-8)
    assert np.all(np.triu(factor, 1) == 0)
    for x in (np.full((2, 4), 3.7), np.array([np.zeros(4), np.arange(4)]), np.array([[0.0, 1, 2, 3], [1, 1, 5, 2]])):
        factor = proposal_factor(jnp.asarray(x), jnp.full(2, 0.5), jnp.full(4, 1e-8))
        assert np.isfinite(factor).all()
        assert (np.diagonal(factor) > 0).all()


def unit(x):
    return jnp.where((x[:, 0] >= 0) & (x[:, 0] <= 1), 0.0, -jnp.inf)


def ends(log_likelihood, log_prior=unit, start=0.5):
    """Return where 100 particles are after sixty moves, and all that is known of them."""
    x, target = jnp.asarray(np.full((100, 1), start)), (log_likelihood, log_prior)
    options = {"temperature": jnp.asarray(1.0), "factor": jnp.array([[0.5]]), "steps": 60}
    found = metropolis(jax.random.key(1), x, log_likelihood(x), log_prior(x), target=target, **options)
    return np.asarray(found.positions)[:, 0], found


def test_no_particle_leaves_the_support_and_an_undefined_likelihood_counts_inside_alone():
    """Even where the likelihood lures. No particle enters a region of zero likelihood, and one inside may leave."""
    at, found = ends(lambda x: 100 * jnp.abs(x[:, 0] - 0.5))
    assert 0 <= at.min() < at.max() <= 1
    assert 0 < float(found.acceptance) < 1
    np.testing.assert_allclose(found.log_likelihood, 100 * np.abs(at - 0.5))
    flat = ends(lambda x: 0.0 * x[:, 0], log_prior=lambda x: 0.0 * x[:, 0])
    assert float(flat[1].acceptance) == pytest.approx(1.0)
    _, found = ends(lambda x: jnp.log(x[:, 0]))
    assert int(found.undefined) == 0
    assert np.isfinite(found.log_likelihood).all()
    at, found = ends(lambda x: jnp.log(x[:, 0] - 0.3))
    assert int(found.undefined) > 0
    assert (at > 0.3).all()
    for start in (0.2, 0.8):
        assert (ends(lambda x: jnp.where(x[:, 0] > 0.5, 0.0, -jnp.inf), start=start)[0] > 0.5).all()


TARGET = gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
QUICK = SMCSettings(rejuvenation_steps=3, zeta=0.8)
INITIAL = TARGET.draw_prior(np.random.default_rng(0), 400)


def run(key=0, log_likelihood=TARGET.log_likelihood, initial=INITIAL, settings=QUICK, **options):
    return sample(jax.random.key(key), log_likelihood, TARGET.log_prior, initial, settings=settings, **options)


@pytest.fixture(scope="module")
def found():
    return run()


def test_a_key_settles_all_bits_and_the_result_is_coherent(found):
    again, other = run(), run(key=1)
    np.testing.assert_array_equal(found.positions, again.positions)
    assert (found.log_evidence, found.steps) == (again.log_evidence, again.steps)
    assert not np.array_equal(found.positions, other.positions)
    assert np.exp(found.log_weights).sum() == pytest.approx(1.0)
    assert found.ess == pytest.approx(1 / (np.exp(found.log_weights) ** 2).sum())
    np.testing.assert_allclose(found.log_likelihood, TARGET.log_likelihood(found.positions), rtol=1e-12)
    assert found.log_evidence == pytest.approx(sum(s.log_evidence_increment for s in found.steps))
    assert found.likelihood_evaluations == 400 * (1 + 3 * len(found.steps))


def test_steps_follow_the_algorithm_and_with_zeta_near_one_weights_persist():
    seen = []
    found = run(on_step=seen.append)
    assert tuple(seen) == found.steps
    temperatures = [s.temperature for s in found.steps]
    assert temperatures == sorted(set(temperatures))
    assert temperatures[-1] == 1.0
    size = 400.0
    for step in found.steps[:-1]:
        assert step.ess == pytest.approx(0.8 * size, rel=1e-6)
        assert step.resampled == (step.ess < 200)
        size = 400.0 if step.resampled else step.ess
    assert any(s.resampled for s in found.steps)
    assert found.steps[0].covariance_scale == 1.0
    for before, after in zip(found.steps, found.steps[1:], strict=False):
        assert after.covariance_scale == pytest.approx((1 / 9 + 8 / 9 * before.acceptance) ** 2)
    found = run(settings=SMCSettings(rejuvenation_steps=3, zeta=0.995))
    assert not any(s.resampled for s in found.steps)
    assert np.ptp(found.log_weights) > 0.1


def test_the_step_is_compiled_once():
    traces = []

    def counted(x):
        traces.append(len(x))
        return TARGET.log_likelihood(x)

    for key in range(3):
        run(key, counted)
    assert len(traces) <= 4


def test_regions_of_zero_likelihood_count_in_the_evidence():
    """A flat likelihood takes one step."""
    quarter = np.quantile(INITIAL[:, 0], 0.25)
    found = run(log_likelihood=lambda x: jnp.where(x[:, 0] < quarter, 0.0, -jnp.inf))
    assert len(found.steps) == 1
    assert found.log_evidence == pytest.approx(np.log(0.25), abs=1e-9)
    assert (found.positions[np.isfinite(found.log_weights), 0] < quarter).all()


def test_settings_have_ranges_and_what_cannot_be_sampled_is_refused():
    for name, value in (("zeta", 1.0), ("rejuvenation_steps", 0), ("resample_below", 1.5), ("maximum_steps", 0)):
        with pytest.raises(InvalidInput, match=name.split("_steps")[0]):
            SMCSettings(**{name: value})
    two, square = np.array([[0.0, 0.0], [1.0, -2.0]]), np.random.default_rng(0).uniform(-1, 1, (400, 2))
    away, few = np.array([[0.0, 0.0], [1e6, 0.0], [2e6, 0.0]]), replace(QUICK, maximum_steps=3)
    half = lambda x: jnp.where(x[:, 0] > 0.5, jnp.nan, 0.0)  # noqa: E731
    hole = lambda x: jnp.where(jnp.abs(x).max(axis=1) > 1.01, jnp.nan, -((10 * x) ** 2).sum(axis=1))  # noqa: E731
    for given, error, words in (
        ({"initial": INITIAL[:1]}, InvalidInput, "at least 2"),
        ({"initial": away}, InvalidInput, "outside the prior: got 2"),
        ({"log_likelihood": lambda x: jnp.full(len(x), -jnp.inf)}, NumericsError, "all 400 initial particles"),
        ({"log_likelihood": half, "initial": two}, NumericsError, re.escape("nan at [1.0, -2.0]")),
        ({"log_likelihood": hole, "initial": square}, NumericsError, r"at \d+ proposal"),
        ({"settings": few}, NumericsError, "3 tempering steps reached only temperature"),
    ):
        with pytest.raises(error, match=words):
            run(**given)
    with jax.enable_x64(False), pytest.raises(InvalidInput, match='jax_enable_x64", True'):
        run()


def test_particles_on_a_single_device_stay_as_they_are(monkeypatch):
    monkeypatch.setattr(sampler.jax, "devices", lambda: jax.local_devices()[:1])
    assert all(sampler.spread(positions) is positions for positions in (jnp.zeros((3, 2)), jnp.zeros((4, 2))))


SCOUTS = np.random.default_rng(7).standard_normal((2000, 2))


def normal_prior(x):
    return -0.5 * (x**2).sum(axis=-1) - np.log(2 * np.pi)


def around(mean, sd=0.5):
    return lambda x: -0.5 * (((x - np.asarray(mean)) / sd) ** 2).sum(axis=1)


def exact(mean, sd=0.5):
    """Return mean, standard deviation and log evidence of the posterior."""
    variance = 1 / (1 + 1 / sd**2)
    evidence = -0.5 * (np.asarray(mean) ** 2).sum() / (1 + sd**2) + np.log(sd**2 / (1 + sd**2))
    return np.asarray(mean) * variance / sd**2, np.sqrt(variance), evidence


def particles():
    centre, sd, evidence = exact((0.4, 0.0))
    x, equal = centre + sd * np.random.default_rng(1).standard_normal((2000, 2)), np.full(2000, -np.log(2000))
    return SMCResult(x, equal, around((0.4, 0.0))(x), np.asarray(normal_prior(x)), float(evidence), 2000.0, (), 0)


def carried_to(mean, start=None, likelihood=None):
    options = {"scouts": SCOUTS, "extents": np.full(2, 8.0), "settings": SMCSettings(rejuvenation_steps=10)}
    return carried_over(jax.random.key(0), start or particles(), likelihood or around(mean), normal_prior, **options)


def test_it_is_the_other_posterior_and_moves_only_if_the_weights_are_uneven():
    before = particles()
    for mean, moves in [((0.42, 0.01), 0), ((0.7, -0.2), 10)]:
        found, (centre, sd, evidence) = carried_to(mean, before), exact(mean)
        w = np.exp(found.log_weights)
        np.testing.assert_allclose(w @ found.positions, centre, atol=0.12 * sd)
        np.testing.assert_allclose(np.sqrt(w @ (found.positions - centre) ** 2), sd, rtol=0.1)
        assert found.log_evidence == pytest.approx(evidence, abs=0.1)
        np.testing.assert_allclose(found.log_likelihood, around(mean)(found.positions))
        assert found.likelihood_evaluations == 2000 * (1 + moves)
        assert (found.positions != before.positions).any() == (moves > 0)


def test_what_is_far_is_not_reached_and_weights_that_are_forgotten_show(monkeypatch):
    """Planted: resampling that takes all particles as equal."""
    assert carried_to((2.5, 2.0)) is None
    near = around((0.42, 0.01))
    corner = SCOUTS[SCOUTS[:1000].sum(axis=1).argmin()]
    two = lambda x: np.logaddexp(near(x), 3 + around(corner, 0.1)(x))  # noqa: E731
    np.testing.assert_allclose(two(particles().positions), near(particles().positions))
    assert carried_to((0.42, 0.01), likelihood=two) is None  # a heavy mode that no particle sees
    assert carried_to((0.42, 0.01), replace(particles(), log_evidence=float("nan"))) is None
    plain, mean = combined.advance_on_host, (0.9, -0.3)

    def equal(key, state, *given, **options):
        forgotten = state._replace(log_weights=0 * state.log_weights - np.log(2000))
        return plain(key, forgotten, *given, **{**options, "moves": 1})

    monkeypatch.setattr(combined, "advance_on_host", equal)
    found, (centre, sd, _) = carried_to(mean), exact(mean)
    assert np.abs(np.exp(found.log_weights) @ found.positions - centre).max() > 0.15 * sd
