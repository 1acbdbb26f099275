"""Several posteriors side by side are, one by one, what the sampler of one posterior gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.errors import InvalidInput, NumericsError
from strandline.smc import SMCSettings, sample, sample_each

QUICK = SMCSettings(rejuvenation_steps=4, zeta=0.5)
GIVEN = np.array([[-1.0, 0.3], [0.0, 0.1], [2.0, 1.0]])
"""Centre and width of each likelihood."""
INITIAL = np.random.default_rng(1).normal(size=(3, 1000, 2))


def log_likelihood(x, given):
    return -0.5 * ((x[:, 0] - given[0]) / given[1]) ** 2 - 0.5 * (x[:, 1] + given[0]) ** 2


def log_prior(x):
    return -0.5 * (x**2).sum(axis=-1) - np.log(2 * np.pi)


def run(key=0, **options):
    arguments = {"log_likelihood": log_likelihood, "initial": INITIAL, "given": GIVEN, **options}
    return sample_each(jax.random.key(key), log_prior=log_prior, settings=QUICK, **arguments)


@pytest.fixture(scope="module")
def together():
    return run()


@pytest.mark.long
def test_each_case_is_what_the_sampler_gives_with_its_value_fixed(together):
    for case, found in enumerate(together):
        alone = sample(
            jax.random.fold_in(jax.random.key(0), case),
            lambda x, theta=GIVEN[case]: log_likelihood(x, theta),
            log_prior,
            INITIAL[case],
            settings=QUICK,
        )
        np.testing.assert_allclose(found.positions, alone.positions, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.log_weights, alone.log_weights, rtol=1e-9)
        np.testing.assert_allclose(found.log_likelihood, log_likelihood(found.positions, GIVEN[case]), rtol=1e-9)
        assert found.log_evidence == pytest.approx(alone.log_evidence, rel=1e-12)
        assert found.likelihood_evaluations == alone.likelihood_evaluations
    assert len({len(found.steps) for found in together}) > 1, "all end at once: nobody stands still"


def test_evidence_and_moments_are_exact(together):
    """x0: N(0, 1) times exp(-½((x0 - c)/w)²); x1 likewise with centre -c and width 1."""
    for (centre, width), found in zip(GIVEN, together, strict=True):
        total = 1 + width**2
        log_evidence = np.log(width) - 0.5 * np.log(total) - 0.5 * centre**2 / total - 0.5 * np.log(2) - centre**2 / 4
        assert found.log_evidence == pytest.approx(log_evidence, abs=0.25)
        weights = np.exp(found.log_weights)
        assert weights @ found.positions[:, 0] == pytest.approx(centre / total, abs=0.2 * width)
        assert weights @ found.positions[:, 1] == pytest.approx(-centre / 2, abs=0.16)


def test_the_same_key_gives_the_same_bits_and_another_one_others(together):
    for a, b, c in zip(together, run(), run(key=1), strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        assert a.log_evidence == b.log_evidence
        assert not np.array_equal(a.positions, c.positions)


def test_cases_do_not_share_their_random_numbers():
    same = run(initial=np.stack([INITIAL[0]] * 3), given=np.stack([GIVEN[0]] * 3))
    assert not np.array_equal(same[0].positions, same[1].positions)


def test_one_program_serves_all_values():
    traces = []

    def counted(x, given):
        traces.append(given.shape)
        return log_likelihood(x, given)

    for shift in (0.0, 0.1, 0.2):
        run(log_likelihood=counted, given=GIVEN + shift)
    assert len(traces) <= 4


def test_failures_name_the_value():
    def undefined(x, given):
        return jnp.where(given[0] > 1.0, jnp.nan, jnp.where(given[0] == 0.0, -jnp.inf, log_likelihood(x, given)))

    with pytest.raises(NumericsError, match=r"given \[2\.0, 1\.0\]: the log-likelihood is nan"):
        run(log_likelihood=undefined, given=GIVEN[[0, 2, 2]])
    with pytest.raises(NumericsError, match=r"given \[0\.0, 0\.1\]: all 1000 initial particles"):
        run(log_likelihood=undefined, given=GIVEN[[0, 1, 1]])
    for given in (GIVEN[:2], GIVEN[:0]):
        with pytest.raises(InvalidInput, match="3 sets for"):
            run(given=given)
    few = SMCSettings(rejuvenation_steps=4, zeta=0.5, maximum_steps=1)
    with pytest.raises(NumericsError, match="1 tempering steps reached only"):
        sample_each(jax.random.key(0), log_likelihood, log_prior, INITIAL, GIVEN, settings=few)
