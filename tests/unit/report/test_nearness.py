"""Whether any run comes near the observation: planted misfits, and sound studies that must not be suspected."""

import json
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Problem
from strandline.discrepancy import DISCREPANCIES
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.report.nearness import Nearest, as_json, nearest_runs, nothing_near
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 33)
HEIGHTS = np.linspace(0.1, 0.3, 21)
SPACE = ParameterSpace((Parameter("h", Uniform(0.1, 0.3)),))


def arch(height: float, *, scale: float = 1.0, shift: float = 0.0) -> Interface:
    return Interface.polyline(scale * np.stack([X, height * np.sin(np.pi * X)], axis=1) + np.array([shift, 0.0]))


def found(
    observed: Interface, measure: Any, variance: float, *, heights: np.ndarray = HEIGHTS, scale: float = 1.0
) -> Nearest:
    """Return what is said of arches of these heights, `scale` times too large, beside the observed one."""
    records = [
        RunRecord(str(k), {"h": float(h), "fixed": 1.0}, "ok", {"": arch(h, scale=scale)})
        for k, h in enumerate(heights)
    ]
    observations = (Observation(observed, variance),)
    likelihood = InterfaceLikelihood(observations, measure)
    values = np.array([likelihood(record.interfaces) for record in records])
    problem = Problem(lambda *_: Simulation.of(arch(0.1)), SPACE, {}, observations, {"m": measure})
    (nearest,) = nearest_runs(problem, records, values)
    return nearest


@pytest.mark.parametrize(
    ("name", "options", "variance"),
    [
        ("tracked_points", {}, 1e-6),
        ("measurement_lines", {"lines": 10}, 1e-6),
        ("closest_point", {"direction": "to_simulated", "weighting": "length"}, 1e-6),
        ("currents", {"width": 0.02}, 1e-5),
    ],
)
def test_planted_misfits_are_noticed_and_sound_studies_are_not_suspected(
    name: str, options: dict[str, Any], variance: float
) -> None:
    """The best of six runs with little noise is many noise units off, yet the observation lies between two of them."""
    measure = DISCREPANCIES[name](**options)
    sound = found(arch(0.2234), measure, variance)
    assert sound.near
    assert nothing_near([sound]) is None
    assert sound.extent_ratio == pytest.approx(1.0)
    few = found(arch(0.2234), measure, 1e-4 * variance, heights=HEIGHTS[::4])
    assert few.residual > 5.0
    assert few.near
    units = found(arch(0.2), measure, variance, scale=1e3)
    assert not units.near
    assert "has 0.001 times the extent of the run's: perhaps" in units.message
    assert "µm and mm differ by a factor of 1000" in units.message
    away = found(arch(0.2, shift=500.0), measure, variance)
    assert not away.near
    assert "NOTHING IN THE BOX COMES NEAR the observation: the best run (h = " in away.message
    assert "Their centres lie 500 mm apart" in away.message
    outside = found(arch(0.6), measure, variance)
    assert not outside.near
    assert outside.inputs["h"] == 0.3
    assert "wrong" in outside.message


def test_a_norm_that_no_longer_grows_does_not_hide_the_distance() -> None:
    """With so much noise d² never exceeds 25 σ_N², however far the observation."""
    nearest = found(arch(0.2, shift=500.0), DISCREPANCIES["currents"](width=0.02), 0.02)
    assert nearest.residual < 5.0
    assert not nearest.near


def test_the_summary_names_the_run() -> None:
    content = json.loads(json.dumps(as_json([found(arch(0.2), DISCREPANCIES["tracked_points"](), 1e-6)])))
    assert (content["near"], content["message"]) == (True, None)
    assert content["observations"][0]["run"] == "10"
    assert content["observations"][0]["residual"] == pytest.approx(0.0, abs=1e-9)
