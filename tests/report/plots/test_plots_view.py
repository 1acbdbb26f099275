"""The part of the box that figures show."""

import numpy as np
import pytest

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import Uniform
from strandline.report.plots.view import shown_interval

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"),))


def posterior_at(draws: np.ndarray, weights: np.ndarray | None = None) -> Posterior:
    weights = np.full(len(draws), 1 / len(draws)) if weights is None else weights
    zeros = np.zeros(len(draws))
    return Posterior(SPACE, draws[:, None], np.log(weights), zeros, zeros, 0.0)


def test_narrow_posterior_fills_the_axes():
    draws = np.linspace(390.0, 410.0, 500)
    low, high = shown_interval(posterior_at(draws), "E")
    assert 375 < low < 390 < 410 < high < 425


def test_wide_posterior_shows_the_whole_box():
    assert shown_interval(posterior_at(np.linspace(150.0, 780.0, 500)), "E") == (100.0, 800.0)


def test_view_ends_at_the_box():
    low, high = shown_interval(posterior_at(np.linspace(780.0, 800.0, 500)), "E")
    assert high == 800.0
    assert 760 < low < 780


def test_light_stragglers_do_not_widen_the_view():
    draws = np.concatenate([np.linspace(390.0, 410.0, 500), np.linspace(100.0, 800.0, 50)])
    weights = np.concatenate([np.full(500, 1.0), np.full(50, 1e-4)])
    low, high = shown_interval(posterior_at(draws, weights / weights.sum()), "E")
    assert high - low < 60


def test_input_without_spread_shows_the_whole_box():
    assert shown_interval(posterior_at(np.full(20, 300.0)), "E") == pytest.approx((100.0, 800.0))
