"""The sampler of one posterior: its steps, its account, and what it refuses."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.errors import InvalidInput, NumericsError
from strandline.smc import SMCResult, SMCSettings, devices, sample
from strandline.testing.densities import gaussian

TARGET = gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
QUICK = SMCSettings(rejuvenation_steps=3, zeta=0.8)
INITIAL = TARGET.draw_prior(np.random.default_rng(0), 400)


def run(key=0, log_likelihood=TARGET.log_likelihood, initial=INITIAL, settings=QUICK, **options):
    random = key if isinstance(key, jax.Array) else jax.random.key(key)
    return sample(random, log_likelihood, TARGET.log_prior, initial, settings=settings, **options)


@pytest.fixture(scope="module")
def found() -> SMCResult:
    return run()


def test_a_key_settles_all_bits(found):
    again, other, old_style = run(), run(key=1), run(key=jax.random.PRNGKey(0))
    np.testing.assert_array_equal(found.positions, again.positions)
    np.testing.assert_array_equal(found.log_weights, again.log_weights)
    assert (found.log_evidence, found.steps) == (again.log_evidence, again.steps)
    assert not np.array_equal(found.positions, other.positions)
    assert np.isfinite(old_style.log_evidence)


def test_the_result_is_coherent(found):
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


def test_the_step_is_compiled_once_also_for_what_cannot_be_hashed(found):
    class Likelihood:
        __hash__ = None
        traces = 0

        def __call__(self, x):
            self.traces += 1
            return TARGET.log_likelihood(x)

    likelihood = Likelihood()
    np.testing.assert_array_equal(run(log_likelihood=likelihood).positions, found.positions)

    def counted(x):
        likelihood.traces += 1
        return TARGET.log_likelihood(x)

    likelihood.traces = 0
    for key in range(3):
        assert len(run(key, counted).steps) > 3
    assert likelihood.traces <= 4


def test_regions_of_zero_likelihood_count_in_the_evidence():
    """A flat likelihood takes one step."""
    quarter = np.quantile(INITIAL[:, 0], 0.25)
    found = run(log_likelihood=lambda x: jnp.where(x[:, 0] < quarter, 0.0, -jnp.inf))
    assert len(found.steps) == 1
    assert found.log_evidence == pytest.approx(np.log(0.25), abs=1e-9)
    assert (found.positions[np.isfinite(found.log_weights), 0] < quarter).all()
    assert np.exp(found.log_weights).sum() == pytest.approx(1.0)


def test_settings_have_ranges():
    for options in ({"rejuvenation_steps": 1}, {"resample_below": 0.0}, {"resample_below": 1.0}, {"maximum_steps": 1}):
        assert {name: getattr(SMCSettings(**options), name) for name in options} == options
    for name, wrong in [
        ("zeta", 1.0),
        ("zeta", 0.0),
        ("rejuvenation_steps", 0),
        ("resample_below", 1.5),
        ("maximum_steps", 0),
    ]:
        with pytest.raises(InvalidInput, match=name.split("_steps")[0]):
            SMCSettings(**{name: wrong})


def hole(x):
    return jnp.where(jnp.abs(x).max(axis=1) > 1.01, jnp.nan, -((10 * x) ** 2).sum(axis=1))


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"initial": INITIAL[:1]}, InvalidInput, "at least 2"),
        ({"initial": np.array([[0.0, 0.0], [1e6, 0.0], [2e6, 0.0]])}, InvalidInput, "outside the prior: got 2"),
        ({"log_likelihood": lambda x: jnp.full(len(x), -jnp.inf)}, NumericsError, "all 400 initial particles"),
        (
            {
                "log_likelihood": lambda x: jnp.where(x[:, 0] > 0.5, jnp.nan, 0.0),
                "initial": np.array([[0.0, 0.0], [1.0, -2.0]]),
            },
            NumericsError,
            re.escape("nan at [1.0, -2.0]"),
        ),
        (
            {"log_likelihood": hole, "initial": np.random.default_rng(0).uniform(-1, 1, (400, 2))},
            NumericsError,
            r"at \d+ proposal",
        ),
        (
            {"settings": SMCSettings(rejuvenation_steps=3, zeta=0.8, maximum_steps=3)},
            NumericsError,
            "3 tempering steps reached only temperature",
        ),
    ],
)
def test_what_cannot_be_sampled_is_refused(given, error, words):
    with pytest.raises(error, match=words):
        run(**given)


def test_single_precision_is_refused_with_the_remedy():
    with jax.enable_x64(False), pytest.raises(InvalidInput, match='jax_enable_x64", True'):
        run()


@pytest.mark.parametrize("number", [3, 4])
def test_particles_on_a_single_device_stay_as_they_are(number, monkeypatch):
    monkeypatch.setattr(devices.jax, "devices", lambda: jax.local_devices()[:1])
    positions = jnp.zeros((number, 2))
    assert devices.spread(positions) is positions
