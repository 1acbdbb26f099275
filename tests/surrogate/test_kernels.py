import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.gaussian_process.kernels import Matern

from strandline.errors import InvalidInput
from strandline.surrogate.kernels import KERNELS, as_length_scale, as_lengths, kernel_named
from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.product import Product

ISOTROPIC = {name: kernel for name, kernel in KERNELS.items() if isinstance(kernel, Isotropic)}
PRODUCTS = {name: kernel for name, kernel in KERNELS.items() if isinstance(kernel, Product)}
S = np.array([0.0, 1e-8, 0.03, 0.4, 1.0, 2.5, 9.0])


def test_matern32_equals_another_implementation():
    reference = Matern(length_scale=1.0, nu=1.5)(S[:, None], np.zeros((1, 1)))[:, 0]
    np.testing.assert_allclose(KERNELS["matern32"].correlation(S), reference, rtol=1e-14)


@pytest.mark.parametrize("kernel", ISOTROPIC.values(), ids=list(ISOTROPIC))
def test_slopes_are_the_derivatives_of_the_correlation(kernel):
    s = S[2:]
    first = jax.vmap(jax.grad(kernel.correlation))(jnp.asarray(s))
    np.testing.assert_allclose(kernel.slope(s), first / s, rtol=1e-12)
    rate = jax.vmap(jax.grad(kernel.slope))(jnp.asarray(s))
    np.testing.assert_allclose(kernel.slope_rate(s), rate, rtol=1e-12)


@pytest.mark.parametrize("kernel", ISOTROPIC.values(), ids=list(ISOTROPIC))
def test_derivative_by_log_length_is_the_finite_difference(kernel):
    step = 1e-6
    longer, shorter = kernel.correlation(S * np.exp(-step)), kernel.correlation(S * np.exp(step))
    np.testing.assert_allclose(kernel.by_log_length(S), (longer - shorter) / (2 * step), atol=1e-9)


def test_an_unknown_kernel_is_refused_with_the_names_there_are():
    with pytest.raises(InvalidInput, match="matern32"):
        kernel_named("matern23")


EVERY = pytest.mark.parametrize("kernel", KERNELS.values(), ids=list(KERNELS))


def offsets(number=40, dim=3):
    return np.random.default_rng(0).normal(size=(number, dim))


def test_names_are_the_keys():
    assert {name: kernel.name for name, kernel in KERNELS.items()} == {name: name for name in KERNELS}


@EVERY
def test_gradient_and_hessian_are_the_finite_differences(kernel):
    offset, weight, step = offsets(), np.random.default_rng(1).normal(size=40), 1e-5
    hessian = kernel.weighted_hessian(offset[None], weight)[0]
    for d, e in enumerate(np.eye(3)):
        up, down = offset + step * e, offset - step * e
        slope = weight @ (kernel.value(up) - kernel.value(down)) / (2 * step)
        assert kernel.weighted_gradient(offset[None], weight)[0, d] == pytest.approx(slope, abs=1e-8)
        bend = (kernel.weighted_gradient(up[None], weight) - kernel.weighted_gradient(down[None], weight)) / (2 * step)
        np.testing.assert_allclose(hessian[d], bend[0], atol=1e-7)


@EVERY
def test_the_jax_form_equals_the_plain_one(kernel):
    offset = np.concatenate([offsets(), np.zeros((1, 3))])
    np.testing.assert_allclose(kernel.of_columns(list(jnp.asarray(offset.T))), kernel.value(offset), rtol=1e-13)


@EVERY
@pytest.mark.parametrize("number", [2, 31, 33, 64, 65, 300])
def test_pairs_fill_the_lower_triangle_and_no_more(kernel, number):
    x = offsets(number)
    lengths = as_lengths(kernel, 0.7, 3) * np.linspace(1.0, 2.0, 3 if kernel.per_input else 1)
    out = np.full((number, number), np.nan, order="F")
    kernel.pairs(x, unit=np.ones(len(lengths))).fill(out, inverse_lengths=1 / lengths, variance=2.5, diagonal=0.1)
    expected = 2.5 * kernel.value((x[:, None] - x) / lengths) + 0.1 * np.eye(number)
    lower = np.tril_indices(number)
    np.testing.assert_allclose(out[lower], expected[lower], rtol=1e-12, atol=1e-15)
    same = np.zeros((number, number), order="F")
    kernel.pairs(x, unit=lengths).fill(same, inverse_lengths=np.ones(len(lengths)), variance=2.5, diagonal=0.1)
    np.testing.assert_allclose(same[lower], out[lower], rtol=1e-12, atol=1e-15)


@EVERY
@pytest.mark.parametrize("number", [2, 31, 33, 64, 65, 300])
def test_pairs_differentiate_by_each_log_length(kernel, number):
    x, rng = offsets(number), np.random.default_rng(2)
    alpha, precision = rng.normal(size=number), np.asfortranarray(rng.normal(size=(number, number)))
    count = 3 if kernel.per_input else 1
    lengths, pairs = 0.7 * np.linspace(1.0, 2.0, count), kernel.pairs(x, unit=np.ones(count))
    found = pairs.by_log_lengths(alpha, precision, inverse_lengths=1 / lengths)
    weight, step = np.tril(np.outer(alpha, alpha) - precision, -1), 1e-6
    for d in range(count):
        moved = np.exp(step * np.eye(count)[d])
        longer = kernel.value((x[:, None] - x) / (lengths * moved))
        shorter = kernel.value((x[:, None] - x) / (lengths / moved))
        slope = (weight * (longer - shorter)).sum() / (2 * step)
        assert found[d] == pytest.approx(slope, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("kernel", PRODUCTS.values(), ids=list(PRODUCTS))
def test_the_functions_of_a_product_follow_from_its_polynomial(kernel):
    t = jnp.asarray(S[1:])
    first = jax.grad(kernel.polynomial)
    p, p1, p2 = kernel.polynomial(t), jax.vmap(first)(t), jax.vmap(jax.grad(first))(t)
    np.testing.assert_allclose(kernel.decline(t), (p - p1) / (t * p), rtol=1e-6)
    np.testing.assert_allclose(kernel.curvature(t), (p - 2 * p1 + p2) / p, rtol=1e-12, atol=1e-12)
    assert kernel.polynomial(0.0) == 1.0


def test_lengths_are_one_number_or_one_for_each_input():
    one, several = KERNELS["matern32"], KERNELS["matern32_product"]
    assert as_lengths(one, 0.7, 3).tolist() == [0.7]
    assert as_lengths(several, 0.7, 3).tolist() == [0.7, 0.7, 0.7]
    assert as_lengths(several, np.array([1.0, 2.0]), 2).tolist() == [1.0, 2.0]
    assert as_length_scale(one, np.array([0.7])) == 0.7
    assert as_length_scale(several, np.array([0.7, 1.0])).tolist() == [0.7, 1.0]


@pytest.mark.parametrize(
    ("name", "length", "words"),
    [
        ("matern32", np.array([1.0, 2.0]), "positive number. Give"),
        ("matern32_product", np.array([1.0, 2.0]), "one positive number, or 3"),
        ("matern32_product", np.array([1.0, 0.0, 2.0]), "positive"),
        ("matern32", -1.0, "positive"),
    ],
)
def test_other_lengths_are_refused(name, length, words):
    with pytest.raises(InvalidInput, match=words):
        as_lengths(KERNELS[name], length, 3)
