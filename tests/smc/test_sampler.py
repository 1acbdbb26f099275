import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.errors import InvalidInput, NumericsError
from strandline.smc import SMCSettings, sample
from strandline.testing.densities import gaussian, uniform

TARGET = gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
QUICK = SMCSettings(rejuvenation_steps=3, zeta=0.8)


def run(seed=0, number=400, settings=QUICK, target=TARGET, **options):
    initial = target.draw_prior(np.random.default_rng(seed), number)
    return sample(jax.random.key(seed), target.log_likelihood, target.log_prior, initial, settings=settings, **options)


def test_the_same_key_gives_the_same_bits():
    one, two = run(), run()
    np.testing.assert_array_equal(one.positions, two.positions)
    np.testing.assert_array_equal(one.log_weights, two.log_weights)
    assert one.log_evidence == two.log_evidence
    assert one.steps == two.steps


def test_another_key_gives_other_particles():
    initial = TARGET.draw_prior(np.random.default_rng(0), 400)
    ends = [
        sample(jax.random.key(k), TARGET.log_likelihood, TARGET.log_prior, initial, settings=QUICK).positions
        for k in (1, 2)
    ]
    assert not np.array_equal(*ends)


def test_old_style_keys_serve_too():
    initial = TARGET.draw_prior(np.random.default_rng(0), 60)
    found = sample(jax.random.PRNGKey(0), TARGET.log_likelihood, TARGET.log_prior, initial, settings=QUICK)
    assert np.isfinite(found.log_evidence)


def test_the_result_is_coherent():
    found = run()
    assert np.exp(found.log_weights).sum() == pytest.approx(1.0)
    assert found.ess == pytest.approx(1 / (np.exp(found.log_weights) ** 2).sum())
    np.testing.assert_allclose(found.log_likelihood, TARGET.log_likelihood(found.positions), rtol=1e-12)
    np.testing.assert_allclose(found.log_prior, TARGET.log_prior(found.positions))
    assert found.log_evidence == pytest.approx(sum(s.log_evidence_increment for s in found.steps))
    assert found.likelihood_evaluations == 400 * (1 + 3 * len(found.steps))


def test_steps_follow_the_algorithm():
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


def test_with_zeta_near_one_weights_persist_and_stay_unequal():
    found = run(settings=SMCSettings(rejuvenation_steps=3, zeta=0.995))
    assert not any(s.resampled for s in found.steps)
    assert found.ess == pytest.approx(found.steps[-1].ess)
    assert np.ptp(found.log_weights) > 0.1


def test_a_flat_likelihood_takes_one_step_and_keeps_the_prior():
    target = uniform(np.array([0.0, 5.0]), np.array([1.0, 9.0]))
    found = run(target=target)
    assert len(found.steps) == 1
    assert found.log_evidence == pytest.approx(0.0, abs=1e-12)


def test_the_step_is_compiled_once():
    traces = []

    def counted(x):
        traces.append(x.shape)
        return TARGET.log_likelihood(x)

    initial = TARGET.draw_prior(np.random.default_rng(0), 60)
    for seed in range(3):
        found = sample(jax.random.key(seed), counted, TARGET.log_prior, initial, settings=QUICK)
    assert len(found.steps) > 3
    assert len(traces) <= 4


def test_a_callable_that_cannot_be_hashed_is_sampled():
    class Likelihood:
        __hash__ = None

        def __call__(self, x):
            return TARGET.log_likelihood(x)

    initial = TARGET.draw_prior(np.random.default_rng(0), 60)
    found = sample(jax.random.key(0), Likelihood(), TARGET.log_prior, initial, settings=QUICK)
    reference = sample(jax.random.key(0), TARGET.log_likelihood, TARGET.log_prior, initial, settings=QUICK)
    np.testing.assert_array_equal(found.positions, reference.positions)


def test_regions_of_zero_likelihood_count_in_the_evidence():
    target = uniform(np.array([0.0]), np.array([1.0]))

    def quarter(x):
        return jnp.where(x[:, 0] < 0.25, 0.0, -jnp.inf)

    initial = np.linspace(0.0005, 0.9995, 1000)[:, None]
    found = sample(jax.random.key(0), quarter, target.log_prior, initial, settings=QUICK)
    assert found.log_evidence == pytest.approx(np.log(0.25), abs=1e-9)
    assert (found.positions[np.isfinite(found.log_weights)] < 0.25).all()
    assert np.exp(found.log_weights).sum() == pytest.approx(1.0)


def test_two_particles_are_enough_to_run():
    assert np.isfinite(run(number=2).log_evidence)


@pytest.mark.parametrize(
    ("options", "words"),
    [({"zeta": 1.0}, "zeta"), ({"zeta": 0.0}, "zeta"), ({"rejuvenation_steps": 0}, "rejuvenation"),
     ({"resample_below": 1.5}, "resample_below"), ({"maximum_steps": 0}, "maximum_steps")],
)  # fmt: skip
def test_settings_out_of_range_are_refused(options, words):
    with pytest.raises(InvalidInput, match=words):
        SMCSettings(**options)


@pytest.mark.parametrize(
    "options", [{"rejuvenation_steps": 1}, {"resample_below": 0.0}, {"resample_below": 1.0}, {"maximum_steps": 1}]
)
def test_settings_at_the_ends_of_their_ranges_are_taken(options):
    assert {name: getattr(SMCSettings(**options), name) for name in options} == options


def test_one_particle_is_refused():
    with pytest.raises(InvalidInput, match="at least 2"):
        run(number=1)


def test_initial_particles_outside_the_prior_are_refused():
    initial = np.array([[0.0, 0.0], [1e6, 0.0], [2e6, 0.0]])
    with pytest.raises(InvalidInput, match="outside the prior: got 2"):
        sample(jax.random.key(0), TARGET.log_likelihood, TARGET.log_prior, initial)


def test_no_likelihood_anywhere_is_an_error():
    initial = TARGET.draw_prior(np.random.default_rng(0), 20)
    with pytest.raises(NumericsError, match="all 20 initial particles"):
        sample(jax.random.key(0), lambda x: jnp.full(len(x), -jnp.inf), TARGET.log_prior, initial)


def test_an_undefined_initial_likelihood_is_an_error_with_its_place():
    initial = np.array([[0.0, 0.0], [1.0, -2.0]])
    with pytest.raises(NumericsError, match=re.escape("nan at [1.0, -2.0]")):
        sample(jax.random.key(0), lambda x: jnp.where(x[:, 0] > 0.5, jnp.nan, 0.0), TARGET.log_prior, initial)


def test_an_undefined_likelihood_of_a_proposal_is_an_error():
    initial = np.random.default_rng(0).uniform(-1, 1, size=(100, 2))

    def hole(x):
        return jnp.where(jnp.abs(x).max(axis=1) > 1.01, jnp.nan, -((10 * x) ** 2).sum(axis=1))

    with pytest.raises(NumericsError, match=r"at \d+ proposal"):
        sample(jax.random.key(0), hole, TARGET.log_prior, initial)


def test_too_many_steps_is_an_error_that_says_where_it_stands():
    with pytest.raises(NumericsError, match="3 tempering steps reached only temperature"):
        run(settings=SMCSettings(rejuvenation_steps=3, maximum_steps=3))


def test_single_precision_is_refused_with_the_remedy():
    with jax.enable_x64(False), pytest.raises(InvalidInput, match='jax_enable_x64", True'):
        run()
