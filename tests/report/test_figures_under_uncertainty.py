"""The figures of a reading of the posterior under uncertainty: which ones, of which inputs."""

import numpy as np
import pytest

from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior, Reading
from strandline.priors import Uniform
from strandline.report.figures import _reading


def reading(calibrated: int) -> Reading:
    names = "abc"[:calibrated]
    flow = Parameter("V", Uniform(0.0, 1.0), nuisance=True)
    space = ParameterSpace((flow, *(Parameter(name, Uniform(0.0, 1.0)) for name in names)))
    draws = np.random.default_rng(0).random((300, space.dim))
    level = np.full(300, -np.log(300))
    return Reading(Posterior(space, draws, level, np.zeros(300), np.zeros(300), 0.0))


def labels(figure) -> set[str]:
    return {text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel())}


def test_one_calibrated_input_is_among_the_marginals():
    assert list(_reading("cut", reading(1), None)) == []


@pytest.mark.parametrize(("calibrated", "names"), [(2, {"a", "b"}), (3, {"a", "b", "c"})])
def test_the_nuisance_input_is_left_out(calibrated, names):
    (shown,) = _reading("cut", reading(calibrated), {"a": 0.5, "b": 0.5, "c": 0.5, "V": 0.5})
    assert (shown.name, shown.section) == ("posterior_cut", "uncertainty")
    assert "cut reading" in shown.caption
    assert names <= labels(shown.figure)
    assert "V" not in labels(shown.figure)


def test_no_laplace_approximation_is_drawn():
    (shown,) = _reading("joint", reading(2), None)
    texts = [text.get_text() for legend in shown.figure.legends for text in legend.get_texts()]
    assert "MAP (fullest bin)" in texts
    assert not any("Laplace" in text for text in texts)
