import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process.kernels import Matern

from strandline.errors import InvalidInput
from strandline.surrogate.kernels import KERNELS, kernel_named

S = np.array([0.0, 1e-8, 0.03, 0.4, 1.0, 2.5, 9.0])


def test_matern32_equals_another_implementation():
    reference = Matern(length_scale=1.0, nu=1.5)(S[:, None], np.zeros((1, 1)))[:, 0]
    np.testing.assert_allclose(KERNELS["matern32"].correlation(S), reference, rtol=1e-14)


@pytest.mark.parametrize("kernel", KERNELS.values(), ids=list(KERNELS))
def test_slopes_are_the_derivatives_of_the_correlation(kernel):
    s = S[2:]
    first = jax.vmap(jax.grad(kernel.correlation))(jnp.asarray(s))
    np.testing.assert_allclose(kernel.slope(s), first / s, rtol=1e-12)
    rate = jax.vmap(jax.grad(kernel.slope))(jnp.asarray(s))
    np.testing.assert_allclose(kernel.slope_rate(s), rate, rtol=1e-12)


@pytest.mark.parametrize("kernel", KERNELS.values(), ids=list(KERNELS))
def test_derivative_by_log_length_is_the_finite_difference(kernel):
    step = 1e-6
    longer, shorter = kernel.correlation(S * np.exp(-step)), kernel.correlation(S * np.exp(step))
    np.testing.assert_allclose(kernel.by_log_length(S), (longer - shorter) / (2 * step), atol=1e-9)


def test_an_unknown_kernel_is_refused_with_the_names_there_are():
    with pytest.raises(InvalidInput, match="matern32"):
        kernel_named("matern23")
