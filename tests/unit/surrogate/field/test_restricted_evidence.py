"""The restricted evidence against the density of contrasts, in coordinates that the code does not use."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from strandline.errors import NumericsError
from strandline.surrogate.field.restricted_evidence import Observed, condition_mode, restricted_evidence

CASES = list(itertools.product([False, True], [False, True]))
HYPERPARAMETERS = [([0.0, 0.4], -6.0), ([0.9, -0.3], -9.0), ([1.2, 1.5], -4.0)]


def observed(gradients: bool, linear: bool, runs: int = 9) -> Observed:
    z = np.random.default_rng(4).uniform(-1.7, 1.7, (runs, 2))
    values = np.sin(1.3 * z[:, 0]) + 0.5 * z[:, 1] ** 2 + 0.2 * z[:, 0] * z[:, 1]
    slopes = np.stack([1.3 * np.cos(1.3 * z[:, 0]) + 0.2 * z[:, 1], z[:, 1] + 0.2 * z[:, 0]], axis=1)
    return Observed(z, values, slopes if gradients else None, linear)


@jax.jit
def all_pairs(z: jax.Array, lengths: jax.Array) -> jax.Array:
    """Return covariances of value and derivatives of all pairs (run, run, 3, 3), by automatic differentiation."""

    def kernel(a, b):
        return jnp.exp(-0.5 * jnp.sum(((a - b) / lengths) ** 2))

    def both(a, b):
        k, by_a, by_b = kernel(a, b), jax.grad(kernel, 0)(a, b), jax.grad(kernel, 1)(a, b)
        mixed = jax.jacfwd(jax.grad(kernel, 0), 1)(a, b)
        return jnp.block([[k[None, None], by_b[None]], [by_a[:, None], mixed]])

    return jax.vmap(jax.vmap(both, (None, 0)), (0, None))(z, z)


def plain(one: Observed, log_lengths: np.ndarray, log_nugget: float) -> float:
    """Return the log density of contrasts that no mean reaches, s² at its largest likelihood, noise as in the code.

    All by the inputs themselves: y = (values, ∂_1, ∂_2).
    """
    lengths, tau = np.exp(log_lengths), math.exp(log_nugget)
    n, dim = one.z.shape
    blocks = np.asarray(all_pairs(one.z, lengths))
    C = blocks.transpose(2, 0, 3, 1).reshape(3 * n, 3 * n)
    noise = tau * np.repeat([1.0, *(1 / lengths**2)], n)
    F = np.zeros((3 * n, 3 if one.linear else 1))
    F[:n, 0] = 1.0
    if one.linear:
        F[:n, 1:] = one.z
        for j in range(dim):
            F[(j + 1) * n : (j + 2) * n, j + 1] = 1.0
    rows = slice(None) if one.gradients is not None else slice(n)
    y = one.values if one.gradients is None else np.concatenate([one.values, one.gradients.T.ravel()])
    C, F = (C + np.diag(noise))[rows, rows], F[rows]
    A = null_space(F.T)
    S, contrasts = A.T @ C @ A, A.T @ y
    variance = float(contrasts @ np.linalg.solve(S, contrasts)) / len(contrasts)
    density = multivariate_normal(cov=variance * S, allow_singular=False).logpdf(contrasts)
    constant = -0.5 * len(contrasts) * (math.log(2 * math.pi) + 1) + 0.5 * np.linalg.slogdet(F.T @ F)[1]
    return float(density - constant)


@pytest.mark.parametrize(("gradients", "linear"), CASES)
def test_the_value_is_the_density_of_contrasts_and_the_gradient_is_its(gradients: bool, linear: bool) -> None:
    one, step = observed(gradients, linear), 1e-4
    for log_lengths, log_nugget in HYPERPARAMETERS:
        at = np.array([*log_lengths, log_nugget])
        value, slope = restricted_evidence(one, at[:2], log_nugget)
        assert value == pytest.approx(plain(one, at[:2], log_nugget), rel=1e-7, abs=1e-6)
        ends = [[restricted_evidence(one, x[:2], float(x[2]))[0] for x in (at + e, at - e)] for e in step * np.eye(3)]
        differences = [(up - down) / (2 * step) for up, down in ends]
        np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(("gradients", "linear"), CASES)
def test_the_precision_takes_no_notice_of_the_mean(gradients: bool, linear: bool) -> None:
    """P F = 0, and P y are the weights of the runs."""
    one, lengths = observed(gradients, linear), np.array([1.0, 1.5])
    found = condition_mode(one, lengths, 1e-4)
    np.testing.assert_allclose(found.precision @ found.trend, 0.0, atol=1e-7)
    np.testing.assert_allclose(found.precision @ one.scaled(lengths), found.alpha, atol=1e-6)
    np.testing.assert_allclose(found.residual, one.scaled(lengths) - found.trend @ found.coefficients)


def test_what_has_no_evidence_is_refused() -> None:
    one = observed(False, False)
    with pytest.raises(NumericsError, match="without variation"):
        restricted_evidence(Observed(one.z, np.zeros(9), None, False), np.zeros(2), -6.0)
    repeated = Observed(np.zeros((4, 2)), np.arange(4.0), None, False)
    with pytest.raises(NumericsError, match="not positive definite"):
        restricted_evidence(repeated, np.zeros(2), -50.0)
