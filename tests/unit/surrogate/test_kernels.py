"""Every kernel against scikit-learn and what a correlation must be; the tiles of their matrices."""

import pickle
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.unit.surrogate.peers import EVERY, lengths_of, peers_correlation

from strandline.foundations import InvalidInput
from strandline.surrogate import covariance
from strandline.surrogate.kernels import KERNELS, as_lengths, decay, kernel_named

OFFSETS = np.random.default_rng(0).normal(size=(40, 3))


@EVERY
def test_the_correlation_is_another_implementations_and_positive_definite(names):
    """With equal lengths, the radial forms are the isotropic ones."""
    for name, dim in product(names, (1, 3)):
        x, lengths = np.random.default_rng(3).normal(size=(60, dim)), lengths_of(name, dim)
        x[:30] = x[30:] + np.logspace(-12, 1, 30)[:, None]
        c = KERNELS[name].value((x[:, None] - x) / lengths)
        np.testing.assert_allclose(c, peers_correlation(name, lengths)(x), rtol=1e-7, atol=1e-13)
        np.testing.assert_array_equal(c, c.T)
        np.testing.assert_array_equal(np.diagonal(c), 1.0)
        assert np.linalg.eigvalsh(c).min() > -1e-13 * len(x)
        same = np.allclose(KERNELS[name].value(OFFSETS), KERNELS[names[0]].value(OFFSETS), rtol=1e-13)
        assert same == (not name.endswith("_product"))


@EVERY
def test_the_jax_form_equals_the_plain_one_and_a_copy_is_the_kernel_itself(names):
    at = np.concatenate([OFFSETS, np.zeros((1, 3))])
    for kernel in (KERNELS[name] for name in names):
        np.testing.assert_allclose(kernel.of_columns(list(jnp.asarray(at.T))), kernel.value(at), rtol=1e-13)
        assert pickle.loads(pickle.dumps(kernel)) is kernel


def test_lengths_are_one_number_or_one_for_each_input():
    with pytest.raises(InvalidInput, match="matern32"):
        kernel_named("matern23")
    one, several = kernel_named("matern32"), kernel_named("matern32_product")
    assert as_lengths(one, 0.7, 3).tolist() == [0.7]
    assert as_lengths(several, 0.7, 3).tolist() == [0.7, 0.7, 0.7]
    for kernel, length, words in (
        (one, [1.0, 2.0], "positive number. Give"),
        (several, [1.0, 2.0], "one positive number, or 3"),
        (several, [1.0, 0.0, 2.0], "positive"),
    ):
        with pytest.raises(InvalidInput, match=words):
            as_lengths(kernel, np.array(length), 3)


def test_the_decay_is_the_exponential_function_and_its_own_derivative():
    x = -np.concatenate([[0.0, 5e-324, 1e-300, 1e-17], np.geomspace(1e-16, 620.0, 20_001), 0.5 * np.arange(1240)])
    for function in (decay, jax.jit(decay)):
        found = np.asarray(function(jnp.asarray(x)))
        assert (np.abs(found / np.exp(x) - 1.0) <= 2e-14 + 3e-16 * np.abs(x)).all()
    tiny = np.asarray(decay(jnp.array([-630.0, -1e3, -1e30, -np.inf])))
    assert ((tiny > 0) & (tiny < 1e-270)).all()
    x = jnp.linspace(-30.0, 0.0, 31)
    np.testing.assert_allclose(jax.vmap(jax.grad(decay))(x), np.exp(x), rtol=1e-13)


def test_threads_change_no_bit_and_lose_no_failure(monkeypatch):
    rng, rows = np.random.default_rng(0), 520  # of a triangle that several threads share
    x, alpha, precision = rng.normal(size=(rows, 3)), rng.normal(size=rows), rng.normal(size=(rows, rows))
    for name in ("matern32", "matern52_ard", "matern32_product"):
        count = 3 if KERNELS[name].per_input else 1
        pairs, inverse, found = KERNELS[name].pairs(x, unit=np.ones(count)), np.linspace(0.5, 1.0, count), []
        for threads in ("1", "3"):
            monkeypatch.setenv("OMP_NUM_THREADS", threads)
            out = np.zeros((rows, rows), order="F")
            pairs.fill(out, inverse_lengths=inverse, variance=2.0, diagonal=0.1)
            found.append((out, pairs.by_log_lengths(alpha, np.asfortranarray(precision), inverse_lengths=inverse)))
        for one, three in zip(*found, strict=True):
            np.testing.assert_array_equal(three, one)
    with pytest.raises(ZeroDivisionError):
        covariance.over_tiles(rows, lambda tile: 1 / 0)
