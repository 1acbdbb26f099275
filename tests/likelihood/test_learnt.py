"""The log-likelihood that a surrogate predicts, to a power."""

from typing import Any

import numpy as np
import pytest

from strandline.likelihood.learnt import evaluated, predicted
from strandline.surrogate import fit_log_likelihood


class Bowl:
    """A surrogate of the user's own."""

    def mean(self, x: np.ndarray) -> np.ndarray:
        return -((x - 0.3) ** 2).sum(axis=1)

    def variance(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(len(x))


def gaussian_process() -> Any:
    x = np.random.default_rng(0).uniform(0.0, 1.0, (20, 2))
    return fit_log_likelihood(x, Bowl().mean(x)).process


@pytest.mark.parametrize("make", [Bowl, gaussian_process], ids=["of the user", "Gaussian process"])
@pytest.mark.parametrize("power", [1.0, 0.25])
def test_the_prediction_to_a_power(make: Any, power: float) -> None:
    process, x = make(), np.random.default_rng(1).uniform(0.0, 1.0, (7, 2))
    found = evaluated(predicted(process, power=power))(x)
    np.testing.assert_allclose(found, power * process.mean(x), rtol=1e-10)
