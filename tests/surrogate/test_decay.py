"""exp(x) for x ≤ 0 in the sampler's hot loop, against NumPy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.surrogate.kernels.decay import decay


@pytest.mark.parametrize("compiled", [False, True], ids=["as it is", "compiled"])
def test_agrees_with_numpy_to_rounding(compiled: bool) -> None:
    x = -np.concatenate([[0.0, 5e-324, 1e-300, 1e-17], np.geomspace(1e-16, 620.0, 20_001), 0.5 * np.arange(1240)])
    found = np.asarray((jax.jit(decay) if compiled else decay)(jnp.asarray(x)))
    error = np.abs(found / np.exp(x) - 1.0)
    assert (error <= 2e-14 + 3e-16 * np.abs(x)).all()
    assert found[0] == pytest.approx(1.0, abs=2e-14)


def test_what_is_as_good_as_nothing_stays_so() -> None:
    found = np.asarray(decay(jnp.array([-630.0, -1e3, -1e30, -np.inf])))
    assert ((found > 0) & (found < 1e-270)).all()


def test_the_derivative_is_the_value() -> None:
    x = jnp.linspace(-30.0, 0.0, 31)
    np.testing.assert_allclose(np.asarray(jax.vmap(jax.grad(decay))(x)), np.exp(np.asarray(x)), rtol=1e-13)


def test_single_precision_is_left_to_jax() -> None:
    x = jnp.linspace(-80.0, 0.0, 50, dtype=jnp.float32)
    found = decay(x)
    assert found.dtype == jnp.float32
    np.testing.assert_array_equal(np.asarray(found), np.asarray(jnp.exp(x)))
