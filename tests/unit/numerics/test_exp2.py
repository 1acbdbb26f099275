"""Powers of two against NumPy's."""

import jax
import numpy as np
import pytest

from strandline.numerics.exp2 import WHOLE, exp2_of_minus


def test_power_of_two_is_exact_to_2e_14_and_vanishes_where_it_should() -> None:
    x = np.concatenate([np.linspace(-900.0, 60.0, 100_001), [899.0, 1e4, 1e300]])
    power = jax.jit(exp2_of_minus, static_argnames="bounded")
    found = np.asarray(power(x, WHOLE, bounded=False))
    assert np.array_equal(power(x[:-3], WHOLE, bounded=True), found[:-3])
    assert found[:-3] == pytest.approx(np.exp2(-x[:-3]), rel=2e-14)
    assert (found[-3:] < 1e-270).all()
