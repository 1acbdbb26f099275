"""Covariances of values and derivatives against automatic differentiation of the kernel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.surrogate.field.derivative_kernel import covariance, trend

U, V = np.random.default_rng(1).normal(size=(4, 3)), np.random.default_rng(2).normal(size=(3, 3))


def kernel(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.exp(-0.5 * jnp.sum((a - b) ** 2))


def by_differentiation(rows: bool, columns: bool) -> np.ndarray:
    """Return the same matrix entry by entry: values first, then derivatives by the first coordinate, and so on."""

    def with_values(f, argument):
        return lambda a, b: jnp.concatenate([jnp.atleast_1d(f(a, b)), jax.grad(f, argument)(a, b)])

    out = []
    for a in U:
        for b in V:
            if rows and columns:
                by_a = with_values(kernel, 0)
                block = jnp.concatenate([by_a(a, b)[:, None], jax.jacfwd(by_a, 1)(a, b)], axis=1)
            elif rows:
                block = with_values(kernel, 0)(a, b)[:, None]
            elif columns:
                block = with_values(kernel, 1)(a, b)[None]
            else:
                block = kernel(a, b)[None, None]
            out.append(block)
    blocks = np.array(out).reshape(len(U), len(V), *out[0].shape)
    return blocks.transpose(2, 0, 3, 1).reshape(blocks.shape[2] * len(U), -1)


@pytest.mark.parametrize("rows", [False, True])
@pytest.mark.parametrize("columns", [False, True])
def test_every_block_is_the_derivative_of_the_kernel(rows: bool, columns: bool) -> None:
    found = covariance(U, V, rows=rows, columns=columns)
    np.testing.assert_allclose(found, by_differentiation(rows, columns), rtol=0, atol=1e-13)


def test_it_is_a_covariance() -> None:
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
