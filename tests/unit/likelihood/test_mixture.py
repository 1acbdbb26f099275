"""The mixture of noise levels against dense matrices, and the log-likelihood of a surrogate to a power."""

import numpy as np
import pytest

from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.learnt import evaluated, predicted
from strandline.likelihood.mixture import Mixture
from strandline.surrogate import fit_log_likelihood

OWN = 3
"""Shifts and the rotation of the observation; further shared errors do not move it."""
RANDOM = np.random.default_rng(2)
LOCAL, SHARED = RANDOM.uniform(0.5, 2.0, 40), RANDOM.normal(size=(40, 5))
LEVELS, SCALES = np.array([0.5, 2.0]), RANDOM.uniform(0.2, 3.0, (2, 5))
LOG_WEIGHTS = np.log([0.3, 0.7])
RESIDUALS = RANDOM.normal(size=(6, 40))
ERRORS = PointErrors(0.01, shift=0.1, rotation=1.0)
LINE = Interface.polyline(np.stack([np.linspace(0.0, 1.0, 40), np.zeros(40)], axis=1))
JOINT = JointErrors((Observation(LINE, ERRORS),), (ERRORS,))
MIXTURE = Mixture(JOINT, LOCAL, SHARED, LEVELS, SCALES, LOG_WEIGHTS)


def test_it_is_the_sum_over_the_dense_gaussians() -> None:
    dense = [level * np.diag(LOCAL) + SHARED * scale**2 @ SHARED.T for level, scale in zip(LEVELS, SCALES, strict=True)]
    squares = np.array([[r @ np.linalg.solve(C, r) for C in dense] for r in RESIDUALS])
    expected = np.log((np.exp(LOG_WEIGHTS) * np.exp(-0.5 * squares)).sum(axis=1))
    found = MIXTURE.of_sums((RESIDUALS**2 / LOCAL).sum(axis=1), (RESIDUALS / LOCAL) @ SHARED)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_what_moves_the_observation_is_the_likeliest_by_least_squares() -> None:
    """Residuals over their sds and shared errors over theirs are as small as possible, at the heavier level."""
    found = MIXTURE._global_errors((RESIDUALS / LOCAL) @ SHARED)
    sds = np.sqrt(LEVELS[1] * LOCAL)
    design = np.vstack([SHARED * SCALES[1] / sds[:, None], np.eye(5)])
    for r, one in zip(RESIDUALS, found, strict=True):
        best = np.linalg.lstsq(design, np.concatenate([r / sds, np.zeros(5)]), rcond=None)[0] * SCALES[1]
        assert one[:OWN] == pytest.approx(best[:OWN])
        assert (one[OWN:] == 0).all()


class Bowl:
    """A surrogate of the user's own."""

    def mean(self, x: np.ndarray) -> np.ndarray:
        return -((x - 0.3) ** 2).sum(axis=1)

    def variance(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(len(x))


def test_the_prediction_of_a_surrogate_to_a_power() -> None:
    runs, x = (np.random.default_rng(seed).uniform(0.0, 1.0, (20, 2)) for seed in (0, 1))
    for process in (Bowl(), fit_log_likelihood(runs, Bowl().mean(runs)).process):
        for power in (1.0, 0.25):
            found = evaluated(predicted(process, power=power))(x)
            np.testing.assert_allclose(found, power * process.mean(x), rtol=1e-10)
