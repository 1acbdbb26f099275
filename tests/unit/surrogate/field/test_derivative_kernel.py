"""Covariances of values and derivatives against automatic differentiation of the kernel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.surrogate.field.derivative_kernel import covariance, trend

U, V = np.random.default_rng(1).normal(size=(4, 3)), np.random.default_rng(2).normal(size=(3, 3))


def kernel(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.exp(-0.5 * jnp.sum((a - b) ** 2))


def with_derivatives(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return value and derivatives by both arguments, values first."""
    by_a, by_b = jax.grad(kernel, 0), jax.grad(kernel, 1)
    return jnp.block([[kernel(a, b), by_b(a, b)[None]], [by_a(a, b)[:, None], jax.jacfwd(by_a, 1)(a, b)]])


def test_every_block_is_the_derivative_of_the_kernel() -> None:
    """Values first, then derivatives by the first coordinate, and so on."""
    blocks = np.asarray(jax.vmap(jax.vmap(with_derivatives, (None, 0)), (0, None))(U, V)).transpose(2, 0, 3, 1)
    for rows in (False, True):
        for columns in (False, True):
            expected = blocks[: 4 if rows else 1, :, : 4 if columns else 1]
            expected = expected.reshape(len(expected) * len(U), -1)
            found = covariance(U, V, rows=rows, columns=columns)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    K = covariance(U, U, rows=True, columns=True)
    np.testing.assert_allclose(K, K.T, atol=1e-15)
    assert np.linalg.eigvalsh(K).min() > 0


@pytest.mark.parametrize("linear", [False, True])
def test_the_mean_has_the_derivatives_of_a_plane(linear: bool) -> None:
    z, lengths = np.random.default_rng(3).normal(size=(6, 2)), np.array([0.5, 3.0])
    b = np.array([0.7, -1.5, 2.0])[: 3 if linear else 1]
    slopes = b[1:] if linear else np.zeros(2)
    values = b[0] + z @ slopes
    expected = np.concatenate([values, *(np.full(6, slopes[j] * lengths[j]) for j in range(2))])
    np.testing.assert_allclose(trend(z, lengths, linear=linear, derivatives=True) @ b, expected, atol=1e-14)
    np.testing.assert_allclose(trend(z, lengths, linear=linear, derivatives=False) @ b, values, atol=1e-14)
