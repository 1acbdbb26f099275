"""Every kernel against scikit-learn, finite differences and what a correlation must be; the tiles of their matrices."""

import os
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.unit.surrogate.peers import EVERY, lengths_of, peers_correlation

from strandline.errors import InvalidInput
from strandline.surrogate.kernels import KERNELS, as_length_scale, as_lengths, kernel_named, tiles
from strandline.surrogate.kernels.decay import decay


def offsets(number=40):
    return np.random.default_rng(0).normal(size=(number, 3))


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
        same = np.allclose(KERNELS[name].value(offsets()), KERNELS[names[0]].value(offsets()), rtol=1e-13)
        assert same == (not name.endswith("_product"))


@EVERY
def test_gradient_and_hessian_are_the_finite_differences_and_the_jax_form_equals_the_plain_one(names):
    offset, weight, step = offsets(), np.random.default_rng(1).normal(size=40), 1e-5
    for kernel in (KERNELS[name] for name in names):
        hessian = kernel.weighted_hessian(offset[None], weight)[0]
        for d, e in enumerate(step * np.eye(3)):
            slope = weight @ (kernel.value(offset + e) - kernel.value(offset - e)) / (2 * step)
            assert kernel.weighted_gradient(offset[None], weight)[0, d] == pytest.approx(slope, abs=1e-8)
            up, down = (kernel.weighted_gradient(moved[None], weight)[0] for moved in (offset + e, offset - e))
            np.testing.assert_allclose(hessian[d], (up - down) / (2 * step), atol=1e-7)
        at = np.concatenate([offset, np.zeros((1, 3))])
        np.testing.assert_allclose(kernel.of_columns(list(jnp.asarray(at.T))), kernel.value(at), rtol=1e-13)


def test_kernels_have_names_and_lengths_are_one_number_or_one_for_each_input():
    assert len(KERNELS) == 8
    assert all(kernel_named(name) is kernel and kernel.name == name for name, kernel in KERNELS.items())
    with pytest.raises(InvalidInput, match="matern32"):
        kernel_named("matern23")
    one, several = KERNELS["matern32"], KERNELS["matern32_product"]
    assert as_lengths(one, 0.7, 3).tolist() == [0.7]
    assert as_lengths(several, 0.7, 3).tolist() == [0.7, 0.7, 0.7]
    assert as_lengths(several, np.array([1.0, 2.0]), 2).tolist() == [1.0, 2.0]
    assert as_length_scale(one, np.array([0.7])) == 0.7
    assert as_length_scale(several, np.array([0.7, 1.0])).tolist() == [0.7, 1.0]
    for kernel, length, words in (
        (one, np.array([1.0, 2.0]), "positive number. Give"),
        (several, np.array([1.0, 2.0]), "one positive number, or 3"),
        (several, np.array([1.0, 0.0, 2.0]), "positive"),
    ):
        with pytest.raises(InvalidInput, match=words):
            as_lengths(kernel, length, 3)


def test_the_decay_is_the_exponential_function_and_its_own_derivative():
    """Single precision is left to JAX."""
    x = -np.concatenate([[0.0, 5e-324, 1e-300, 1e-17], np.geomspace(1e-16, 620.0, 20_001), 0.5 * np.arange(1240)])
    for function in (decay, jax.jit(decay)):
        found = np.asarray(function(jnp.asarray(x)))
        assert (np.abs(found / np.exp(x) - 1.0) <= 2e-14 + 3e-16 * np.abs(x)).all()
    tiny = np.asarray(decay(jnp.array([-630.0, -1e3, -1e30, -np.inf])))
    assert ((tiny > 0) & (tiny < 1e-270)).all()
    x = jnp.linspace(-30.0, 0.0, 31)
    np.testing.assert_allclose(jax.vmap(jax.grad(decay))(x), np.exp(x), rtol=1e-13)
    single = jnp.linspace(-80.0, 0.0, 50, dtype=jnp.float32)
    assert decay(single).dtype == jnp.float32
    np.testing.assert_array_equal(decay(single), jnp.exp(single))


ENOUGH = 520
"""Rows of a triangle that several threads share."""


def test_threads_change_no_bit_and_lose_no_failure(monkeypatch):
    rng = np.random.default_rng(0)
    x, alpha, precision = rng.normal(size=(ENOUGH, 3)), rng.normal(size=ENOUGH), rng.normal(size=(ENOUGH, ENOUGH))
    for name in ("matern32", "matern52_ard", "matern32_product"):
        count = 3 if KERNELS[name].per_input else 1
        pairs, inverse, found = KERNELS[name].pairs(x, unit=np.ones(count)), np.linspace(0.5, 1.0, count), []
        for threads in ("1", "3"):
            monkeypatch.setenv("OMP_NUM_THREADS", threads)
            out = np.zeros((ENOUGH, ENOUGH), order="F")
            pairs.fill(out, inverse_lengths=inverse, variance=2.0, diagonal=0.1)
            found.append((out, pairs.by_log_lengths(alpha, np.asfortranarray(precision), inverse_lengths=inverse)))
        for one, three in zip(*found, strict=True):
            np.testing.assert_array_equal(three, one)
    with pytest.raises(ZeroDivisionError):
        tiles.over_tiles(ENOUGH, lambda tile: 1 / 0)


def test_as_many_threads_as_blas_may_use(monkeypatch):
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    for limit, threads in (("3", 3), ("4,2", 4), ("0", cores), ("many", cores), ("", cores)):
        monkeypatch.setenv("OMP_NUM_THREADS", limit)
        assert tiles.threads() == threads
