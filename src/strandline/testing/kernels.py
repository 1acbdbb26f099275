"""Conformance suite for kernels: what any `strandline.surrogate.kernels.Kernel` must do."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Float

from strandline.foundations import use_double
from strandline.surrogate import Kernel
from strandline.testing import checks_of, require_parts

DIM, STEP = 3, 1e-5
LENGTHS = np.array([0.8, 2.5, 1.3])


def offsets(number: int) -> Float[np.ndarray, "pair dim"]:
    """Return offsets in length scales, from zero to several."""
    directions = np.random.default_rng(1).normal(size=(number, DIM))
    return directions * np.linspace(0.0, 3.0, number)[:, None]


def check_it_is_a_correlation(kernel: Kernel) -> None:
    """It is one at zero offset, smaller elsewhere, symmetric, and positive definite."""
    require_parts(kernel, Kernel)
    found = kernel.value(offsets(50))
    assert found[0] == 1.0, f"c is {found[0]:g} at no offset, not 1"
    assert (np.abs(found[1:]) < 1.0).all(), "c is not below 1 elsewhere"
    assert np.array_equal(found, kernel.value(-offsets(50))), "c differs between an offset and its opposite"
    x = offsets(60)
    least = np.linalg.eigvalsh(kernel.value(x[:, None] - x)).min()
    assert least > -1e-12 * len(x), f"a correlation matrix has the eigenvalue {least:.2g}"


def check_hessian(kernel: Kernel) -> None:
    """The Hessian agrees with central differences of the value."""
    at, weight = offsets(24)[4:].reshape(4, 5, DIM), np.linspace(-1.0, 2.0, 5)
    hessian, step = kernel.weighted_hessian(at, weight), 10 * STEP * np.eye(DIM)
    for i, j in np.ndindex(DIM, DIM):
        ahead, behind = kernel.value(at + step[i] + step[j]), kernel.value(at - step[i] - step[j])
        bend = (ahead + behind - kernel.value(at + step[i] - step[j]) - kernel.value(at - step[i] + step[j])) @ weight
        assert np.allclose(hessian[:, i, j], bend / (2 * step[i, i]) ** 2, atol=1e-5), "the Hessian is not the value's"


def check_jax_agrees(kernel: Kernel) -> None:
    """The compiled form for JAX gives the same values."""
    use_double()
    compiled = jax.jit(kernel.of_columns)(list(offsets(50).T))
    assert np.allclose(compiled, kernel.value(offsets(50)), rtol=1e-9, atol=1e-12), "JAX gives other values"


def check_pairs_fill_the_covariance(kernel: Kernel) -> None:
    """Prepared pairs write variance · c and the diagonal into the lower triangle."""
    x, lengths = offsets(30), LENGTHS if kernel.per_input else LENGTHS[:1]
    out = np.asfortranarray(np.zeros((30, 30)))
    pairs = kernel.pairs(x, unit=np.ones_like(lengths))
    pairs.fill(out, inverse_lengths=1 / lengths, variance=2.0, diagonal=0.1)
    expected = 2.0 * kernel.value((x[:, None] - x) / lengths) + 0.1 * np.eye(30)
    assert np.allclose(np.tril(out), np.tril(expected), rtol=1e-9), "the covariance of pairs is not variance · c"


def check_pairs_know_their_slopes(kernel: Kernel) -> None:
    """The derivatives with respect to the logarithms of the lengths agree with central differences."""
    x, lengths = offsets(20), LENGTHS if kernel.per_input else LENGTHS[:1]
    random = np.random.default_rng(2)
    alpha, precision = random.normal(size=20), random.normal(size=(20, 20))
    precision = np.asfortranarray(precision @ precision.T)
    weights = np.tril(np.outer(alpha, alpha) - precision, -1)

    def total(log_lengths: Float[np.ndarray, " length"]) -> float:
        """Return Σ_i>j (α_i α_j - P_ij) c_ij."""
        return float((weights * kernel.value((x[:, None] - x) / np.exp(log_lengths))).sum())

    found = kernel.pairs(x, unit=np.ones_like(lengths)).by_log_lengths(alpha, precision, inverse_lengths=1 / lengths)
    steps, centre = STEP * np.eye(len(lengths)), np.log(lengths)
    slopes = [(total(centre + step) - total(centre - step)) / (2 * STEP) for step in steps]
    assert np.allclose(found, slopes, rtol=1e-6, atol=1e-5), "the slopes of pairs are not derivatives"


CHECKS: dict[str, Callable[[Kernel], None]] = checks_of(globals())
