"""Failures by the size of the displacement, and predicted interfaces that cross themselves."""

from functools import cache

import numpy as np
import pytest

from strandline.design import sobol
from strandline.interface import Interface
from strandline.planning.failing import FailureBySize, crossing_share, learn_failure_by_size
from strandline.surrogate.field import FieldTraining, fit_field

LOW, HIGH = np.array([100.0]), np.array([800.0])
S = np.linspace(0.0, 1.0, 21)
LIMIT = 0.4
FLAT = np.column_stack([S, 0 * S])


def bent(young: np.ndarray, load: float) -> np.ndarray:
    """Return arcs of height load/E, mm."""
    heights = load / young[:, None] * np.sin(np.pi * S)
    return np.stack([np.broadcast_to(S, heights.shape), heights], axis=-1)


@cache
def learnt(at_random: bool = False, larger: tuple[float, ...] = ()) -> FailureBySize:
    """Return what 60 runs at load 100 show: they fail where the arc is higher than LIMIT, or every tenth does."""
    x = LOW + (HIGH - LOW) * sobol(60, 1, scramble=1)
    ok = np.arange(60) % 10 != 0 if at_random else 100.0 / x[:, 0] < LIMIT
    runs = [{"": Interface.polyline(points)} for points in bent(x[ok, 0], 100.0)]
    surrogate = fit_field(FieldTraining(x[ok], runs, None, LOW, HIGH))
    others = bent(np.array(larger), 100.0).reshape(len(larger), FLAT.size)
    return learn_failure_by_size(surrogate, x, ok, FLAT.ravel(), others)


YOUNG = np.random.default_rng(1).normal(400, 60, 500)


def share(load: float, *, at_random: bool = False) -> float:
    return float(learnt(at_random).failing(bent(YOUNG, load).reshape(500, -1)).mean())


def test_arcs_fail_where_they_are_too_high() -> None:
    """The share at the limit is the true one; failures at random say nothing about the size."""
    shares = [share(load) for load in (10.0, 20.0, 50.0, 100.0, 150.0, 200.0, 250.0)]
    assert shares == sorted(shares)
    assert shares[1] <= 0.01
    assert shares[3] <= 0.05
    assert shares[-1] >= 0.9
    assert share(160.0) == pytest.approx(float((160.0 / YOUNG > LIMIT).mean()), abs=0.1)
    for load in (20.0, 60.0):
        assert share(load, at_random=True) == pytest.approx(0.1, abs=0.08)


def test_a_run_of_another_experiment_that_succeeded_counts() -> None:
    """Runs at the height of an arc between what succeeded and what failed before."""
    field = bent(np.array([100.0 / LIMIT]), 100.0).reshape(1, -1)
    assert learnt(larger=(100.0 / (1.05 * LIMIT),)).failing(field)[0] < learnt().failing(field)[0]


def test_the_share_of_interfaces_that_cross_themselves() -> None:
    loop = np.array([[0.0, 0], [1, 0], [1, 1], [0.5, -1], [2, -1]])
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    assert crossing_share({"": np.array([loop, line, line, line])}, {"": Interface.polyline(line)}) == 0.25
