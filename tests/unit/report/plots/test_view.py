"""The part of the box that figures show."""

import numpy as np
import pytest
from tests.unit.report.plots.drawn import E

from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.report.plots.view import shown_interval

NARROW = np.linspace(390.0, 410.0, 500)


def interval(draws: np.ndarray, weights: np.ndarray | None = None) -> tuple[float, float]:
    weights = np.ones(len(draws)) if weights is None else weights
    zeros = np.zeros(len(draws))
    log_weights = np.log(weights / weights.sum())
    return shown_interval(Posterior(ParameterSpace((E,)), draws[:, None], log_weights, zeros, zeros, 0.0), "E")


def test_a_narrow_posterior_fills_the_axes_and_light_stragglers_do_not_widen_the_view():
    low, high = interval(NARROW)
    assert 375 < low < 390 < 410 < high < 425
    draws = np.concatenate([NARROW, np.linspace(100.0, 800.0, 50)])
    low, high = interval(draws, np.concatenate([np.full(500, 1.0), np.full(50, 1e-4)]))
    assert high - low < 60


def test_the_view_ends_at_the_box():
    assert interval(np.linspace(150.0, 780.0, 500)) == (100.0, 800.0)
    low, high = interval(np.linspace(780.0, 800.0, 500))
    assert high == 800.0
    assert 760 < low < 780
    assert interval(np.full(20, 300.0)) == pytest.approx((100.0, 800.0)), "no spread"
