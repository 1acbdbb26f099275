"""Every kernel against scikit-learn, automatic differentiation, finite differences and what a correlation must be."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.unit.surrogate.peers import EVERY, lengths_of, peers_correlation

from strandline.errors import InvalidInput
from strandline.surrogate.kernels import KERNELS, as_length_scale, as_lengths, kernel_named
from strandline.surrogate.kernels.decay import decay
from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.product import Product

S = np.array([0.03, 0.4, 1.0, 2.5, 9.0])


def offsets(number=40):
    return np.random.default_rng(0).normal(size=(number, 3))


@EVERY
def test_the_correlation_is_another_implementations_and_positive_definite(names):
    for name in names:
        for dim in (1, 3):
            x, lengths = np.random.default_rng(3).normal(size=(60, dim)), lengths_of(name, dim)
            x[:30] = x[30:] + np.logspace(-12, 1, 30)[:, None]
            c = KERNELS[name].value((x[:, None] - x) / lengths)
            np.testing.assert_allclose(c, peers_correlation(name, lengths)(x), rtol=1e-7, atol=1e-13)
            np.testing.assert_array_equal(c, c.T)
            np.testing.assert_array_equal(np.diagonal(c), 1.0)
            assert np.linalg.eigvalsh(c).min() > -1e-13 * len(x)


@EVERY
def test_slopes_are_the_derivatives_of_the_functions(names):
    for kernel in (KERNELS[name] for name in names):
        if isinstance(kernel, Isotropic):
            np.testing.assert_allclose(kernel.slope(S), jax.vmap(jax.grad(kernel.correlation))(S) / S, rtol=1e-12)
            np.testing.assert_allclose(kernel.slope_rate(S), jax.vmap(jax.grad(kernel.slope))(S), rtol=1e-12)
            longer, shorter = (kernel.correlation(S * np.exp(step)) for step in (-1e-6, 1e-6))
            np.testing.assert_allclose(kernel.by_log_length(S), (longer - shorter) / 2e-6, atol=1e-9)
        if isinstance(kernel, Product):
            first = jax.grad(kernel.polynomial)
            p, p1, p2 = kernel.polynomial(S), jax.vmap(first)(S), jax.vmap(jax.grad(first))(S)
            np.testing.assert_allclose(kernel.decline(S), (p - p1) / (S * p), rtol=1e-12)
            np.testing.assert_allclose(kernel.curvature(S), (p - 2 * p1 + p2) / p, rtol=1e-12, atol=1e-12)
            assert kernel.polynomial(0.0) == 1.0


@EVERY
def test_gradient_and_hessian_are_the_finite_differences(names):
    offset, weight, step = offsets(), np.random.default_rng(1).normal(size=40), 1e-5
    for kernel in (KERNELS[name] for name in names):
        hessian = kernel.weighted_hessian(offset[None], weight)[0]
        for d, e in enumerate(step * np.eye(3)):
            slope = weight @ (kernel.value(offset + e) - kernel.value(offset - e)) / (2 * step)
            assert kernel.weighted_gradient(offset[None], weight)[0, d] == pytest.approx(slope, abs=1e-8)
            up, down = (kernel.weighted_gradient(moved[None], weight)[0] for moved in (offset + e, offset - e))
            np.testing.assert_allclose(hessian[d], (up - down) / (2 * step), atol=1e-7)


@EVERY
def test_the_jax_form_equals_the_plain_one(names):
    offset = np.concatenate([offsets(), np.zeros((1, 3))])
    for kernel in (KERNELS[name] for name in names):
        np.testing.assert_allclose(kernel.of_columns(list(jnp.asarray(offset.T))), kernel.value(offset), rtol=1e-13)


@EVERY
def test_pairs_fill_the_lower_triangle(names):
    for number, kernel in product((2, 33, 300), (KERNELS[name] for name in names)):
        x, lower = offsets(number), np.tril_indices(number)
        lengths = as_lengths(kernel, 0.7, 3) * np.linspace(1.0, 2.0, 3 if kernel.per_input else 1)
        expected = 2.5 * kernel.value((x[:, None] - x) / lengths) + 0.1 * np.eye(number)
        for unit in (np.ones(len(lengths)), lengths):
            out = np.full((number, number), np.nan, order="F")
            kernel.pairs(x, unit=unit).fill(out, inverse_lengths=unit / lengths, variance=2.5, diagonal=0.1)
            np.testing.assert_allclose(out[lower], expected[lower], rtol=1e-12, atol=1e-15)


@EVERY
def test_pairs_differentiate_by_each_log_length(names):
    for number, kernel in product((2, 33, 300), (KERNELS[name] for name in names)):
        x, rng, step = offsets(number), np.random.default_rng(2), 1e-6
        alpha, precision = rng.normal(size=number), np.asfortranarray(rng.normal(size=(number, number)))
        weight = np.tril(np.outer(alpha, alpha) - precision, -1)
        count = 3 if kernel.per_input else 1
        lengths, pairs = 0.7 * np.linspace(1.0, 2.0, count), kernel.pairs(x, unit=np.ones(count))
        found = pairs.by_log_lengths(alpha, precision, inverse_lengths=1 / lengths)
        for d, moved in enumerate(np.exp(step * np.eye(count))):
            longer, shorter = (kernel.value((x[:, None] - x) / by) for by in (lengths * moved, lengths / moved))
            slope = (weight * (longer - shorter)).sum() / (2 * step)
            assert found[d] == pytest.approx(slope, rel=1e-6, abs=1e-6)


@EVERY
def test_with_equal_lengths_the_radial_forms_are_the_isotropic_ones(names):
    for name in names:
        same = np.allclose(KERNELS[name].value(offsets()), KERNELS[names[0]].value(offsets()), rtol=1e-13)
        assert same == (not name.endswith("_product"))


def test_kernels_have_names():
    assert len(KERNELS) == 8
    assert all(kernel_named(name) is kernel and kernel.name == name for name, kernel in KERNELS.items())
    with pytest.raises(InvalidInput, match="matern32"):
        kernel_named("matern23")


def test_lengths_are_one_number_or_one_for_each_input():
    one, several = KERNELS["matern32"], KERNELS["matern32_product"]
    assert as_lengths(one, 0.7, 3).tolist() == [0.7]
    assert as_lengths(several, 0.7, 3).tolist() == [0.7, 0.7, 0.7]
    assert as_lengths(several, np.array([1.0, 2.0]), 2).tolist() == [1.0, 2.0]
    assert as_length_scale(one, np.array([0.7])) == 0.7
    assert as_length_scale(several, np.array([0.7, 1.0])).tolist() == [0.7, 1.0]
    for name, length, words in [
        ("matern32", np.array([1.0, 2.0]), "positive number. Give"),
        ("matern32_product", np.array([1.0, 2.0]), "one positive number, or 3"),
        ("matern32_product", np.array([1.0, 0.0, 2.0]), "positive"),
        ("matern32", -1.0, "positive"),
    ]:
        with pytest.raises(InvalidInput, match=words):
            as_lengths(KERNELS[name], length, 3)


def test_the_decay_is_the_exponential_function():
    x = -np.concatenate([[0.0, 5e-324, 1e-300, 1e-17], np.geomspace(1e-16, 620.0, 20_001), 0.5 * np.arange(1240)])
    for function in (decay, jax.jit(decay)):
        found = np.asarray(function(jnp.asarray(x)))
        assert (np.abs(found / np.exp(x) - 1.0) <= 2e-14 + 3e-16 * np.abs(x)).all()
    tiny = np.asarray(decay(jnp.array([-630.0, -1e3, -1e30, -np.inf])))
    assert ((tiny > 0) & (tiny < 1e-270)).all()


def test_the_derivative_of_the_decay_is_its_value_and_single_precision_is_left_to_jax():
    x = jnp.linspace(-30.0, 0.0, 31)
    np.testing.assert_allclose(jax.vmap(jax.grad(decay))(x), np.exp(x), rtol=1e-13)
    single = jnp.linspace(-80.0, 0.0, 50, dtype=jnp.float32)
    assert decay(single).dtype == jnp.float32
    np.testing.assert_array_equal(decay(single), jnp.exp(single))
