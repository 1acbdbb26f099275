"""Sobol' indices against functions whose indices are known."""

import numpy as np
import pytest
from jaxtyping import Float

from strandline.errors import NumericsError
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import SobolIndices, sobol_indices
from strandline.priors import LogNormal, Uniform

PI = float(np.pi)
CUBE = ParameterSpace(tuple(Parameter(name, Uniform(-PI, PI)) for name in "abc"))
A, B = 7.0, 0.1


def ishigami(x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def known() -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Ishigami and Homma's closed form of the first-order and the total indices."""
    one, two = 0.5 * (1 + B * PI**4 / 5) ** 2, A**2 / 8
    together = 8 * B**2 * PI**8 / 225
    variance = one + two + together
    return np.array([one, two, 0.0]) / variance, np.array([one + together, two, together]) / variance


def misses(found: SobolIndices) -> list[bool]:
    """Tell for each index whether it lies further from the known one than twice its bootstrap interval reaches."""
    first, total = known()
    half = (0.5 * (found.first_high - found.first_low), 0.5 * (found.total_high - found.total_low))
    apart = np.concatenate([np.abs(found.first - first) / half[0], np.abs(found.total - total) / half[1]])
    return list(apart > 2.0)


def test_the_function_of_ishigami_and_homma() -> None:
    """Planted: first-order and total indices interchanged. The same seed gives the same bits."""
    found = sobol_indices(ishigami, CUBE, resamples=50)
    assert misses(found) == [False] * 6
    assert np.all(found.first_high - found.first_low < 0.15)
    assert np.all(found.total_high - found.total_low < 0.15)
    np.testing.assert_allclose(known()[0], [0.3139, 0.4424, 0.0], atol=1e-4)
    assert found.evaluations == 5 * 2048
    low, high, total = found.first_low, found.first_high, found.total
    missed = misses(SobolIndices(total, found.total_low, found.total_high, found.first, low, high, 0))
    assert [missed[0], missed[2], missed[5]] == [True] * 3
    again, other = sobol_indices(ishigami, CUBE, resamples=50), sobol_indices(ishigami, CUBE, seed=2, resamples=2)
    np.testing.assert_array_equal(again.first, found.first)
    np.testing.assert_array_equal(again.total_high, found.total_high)
    assert not np.array_equal(other.first, found.first)


def test_inputs_vary_by_their_priors() -> None:
    """Of log a + b the shares are the variances: a is log-normal, b uniform."""
    space = ParameterSpace((Parameter("a", LogNormal(1.0, 0.3), box=(0.01, 100.0)), Parameter("b", Uniform(0.0, 0.6))))
    found = sobol_indices(lambda x: np.log(x[:, 0]) + x[:, 1], space, resamples=2)
    share = 0.09 / (0.09 + 0.36 / 12)
    np.testing.assert_allclose(found.first, [share, 1 - share], atol=0.01)
    np.testing.assert_allclose(found.total, [share, 1 - share], atol=0.01)


def test_a_function_without_variance_has_no_indices() -> None:
    for value in (1.0, np.nan):
        with pytest.raises(NumericsError, match="constant or not finite under the prior"):
            sobol_indices(lambda x, value=value: np.full(len(x), value), CUBE)
