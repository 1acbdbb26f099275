"""The predicted error of a mode after few runs is as large as the errors are."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.stats import qmc

from strandline.surrogate.field import mode_process
from strandline.surrogate.field.length_scales import mixed_variance, student
from strandline.surrogate.field.mode_process import fit_mode
from strandline.surrogate.field.restricted_evidence import Observed

HALF = np.sqrt(3.0)
"""Half the width of the box in standardised inputs."""
SEEDS = 4

Function = Callable[[np.ndarray], np.ndarray]
FUNCTIONS: list[Function] = [
    lambda z: np.sin(1.2 * z[:, 0] + 0.6 * z[:, 1]),
    lambda z: 0.5 * z[:, 0] + np.sin(z[:, 0] + 0.5 * z[:, 1]) * (1 + 0.3 * z[:, 1]),
    lambda z: 1 / (3 + z[:, 0] + 0.5 * z[:, 1]),
    lambda z: np.exp(0.6 * z[:, 0] - 0.3 * z[:, 1]),
    lambda z: (2.5 + z[:, 0]) * np.log(3 + z[:, 1]),
    lambda z: 1 / (2.2 + z[:, 0]) * (1 + 0.4 * np.tanh(z[:, 1])),
    lambda z: np.sin(2 * z[:, 0]) + 0.5 * np.cos(1.5 * z[:, 1]),
    lambda z: np.sqrt(8 + 2 * z[:, 0] + 0.3 * z[:, 1] * z[:, 0]),
    lambda z: z[:, 0] ** 2 - 0.5 * z[:, 0] * z[:, 1] + 0.1 * z[:, 1] ** 3,
]


def box(number: int, seed: int) -> np.ndarray:
    return np.asarray(HALF * (2 * qmc.Sobol(2, seed=np.random.default_rng(seed)).random(64)[:number] - 1))


@cache
def ratios(runs: int, *, unsure: bool = True) -> np.ndarray:
    """Return the root mean square of error over predicted sd, for each function and seed."""
    found, test = [], box(64, 99)
    with pytest.MonkeyPatch.context() as patch:
        if not unsure:
            patch.setattr(mode_process, "_unsure", lambda *given: 1.0)
        for function in FUNCTIONS:
            for seed in range(SEEDS):
                z = box(runs, seed + 17)
                process = fit_mode(Observed(z, function(z), None, linear=True))
                squares = (process.mean(test) - function(test)) ** 2 / process.variance(test)
                found.append(np.sqrt(squares.mean()))
    return np.array(found)


@pytest.mark.parametrize("runs", [8, 14, 20])
def test_errors_are_as_large_as_predicted(runs: int) -> None:
    found = ratios(runs)
    assert 0.5 < np.median(found) < 1.3
    assert np.sqrt(np.mean(found**2)) < 2.0


@pytest.mark.parametrize("runs", [8, 14])
def test_length_scales_taken_as_known_predict_errors_that_are_too_small(runs: int) -> None:
    """The planted bug."""
    assert np.sqrt(np.mean(ratios(runs, unsure=False) ** 2)) > 1.4 * np.sqrt(np.mean(ratios(runs) ** 2))


def test_many_runs_leave_length_scales_known() -> None:
    z = box(60, 3)
    process = fit_mode(Observed(z, FUNCTIONS[6](z), None, linear=True))
    assert 1.0 <= process.widening < 1.3


def test_the_variance_of_students_t() -> None:
    assert student(14, 3) == pytest.approx(11 / 9)
    assert student(5, 3) == 3.0  # none: as with three degrees of freedom


def test_the_mixture_over_a_normal_posterior_is_its_mean() -> None:
    """Variance e^(2t) of a mean that goes with t, t normal of sd 0.2: E e^(2t) + E t² = e^0.08 + 0.04."""

    def objective(at: np.ndarray) -> tuple[float, np.ndarray]:
        return 0.5 * float(at[0] ** 2) / 0.04, np.array([at[0] / 0.04, 0.0])

    def predicted(at: np.ndarray, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        return objective(at)[0], np.full(len(z), at[0]), np.full(len(z), np.exp(2 * at[0]))

    ends = np.array([-5.0, -5.0]), np.array([5.0, 5.0])
    found = mixed_variance(objective, predicted, np.zeros(2), *ends, least=0.1)
    assert found == pytest.approx(np.exp(0.08) + 0.04, rel=0.02)


def test_hyperparameters_without_a_covariance_do_not_count() -> None:
    def objective(at: np.ndarray) -> tuple[float, np.ndarray]:
        return 0.5 * float(at[0] ** 2), np.array([at[0], 0.0])

    ends = np.array([-5.0, -5.0]), np.array([5.0, 5.0])
    found = mixed_variance(
        objective,
        lambda at, z: None if at[0] else (0.0, np.zeros(len(z)), np.ones(len(z))),
        np.zeros(2),
        *ends,
        least=0.1,
    )
    assert found == 1.0
