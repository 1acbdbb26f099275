"""Arches of two inputs that tests of repeated experiments share, and a surrogate of them from a few exact runs."""

from collections.abc import Mapping

import numpy as np

from strandline.design import sobol
from strandline.design.active import Knowledge, learn
from strandline.discrepancy import Discrepancy
from strandline.interface import Interface, Observation, PointErrors
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import RunRecord

SPACE = ParameterSpace((Parameter("height", Uniform(0.2, 0.4), "mm"), Parameter("lean", Uniform(-0.1, 0.2))))
TRUTH = np.array([0.3, 0.05])
SD = 0.01
RUNS = 24
T = np.linspace(0.0, 1.0, 41)


def arch(x: np.ndarray, factor: float = 1.0) -> Interface:
    """Return an arch of some height that leans to one side; `factor` scales what the inputs do."""
    height, lean = 0.3 + factor * (x[0] - 0.3), factor * x[1]
    y = 4 * height * T * (1 - T) + 0.5 * height**2 * np.sin(2 * np.pi * T)
    return Interface.polyline(np.stack([T + lean * (1 + height) * np.sin(np.pi * T), y], axis=1))


def seen(errors: PointErrors, factor: float = 1.0) -> Interface:
    """Return an arch as it might be observed."""
    return errors.draw(arch(TRUTH, factor), np.random.default_rng(5))


def knowledge(measure: Discrepancy, observations: Mapping[str, Observation]) -> Knowledge:
    """Return what is learnt of the arches of some conditions, each with its number as the factor: "1", "1.5"."""
    x = SPACE.to_physical(sobol(RUNS, 2, scramble=3))
    records = [
        RunRecord(str(k), SPACE.as_mapping(row), "ok", {name: arch(row, float(name or 1.0)) for name in observations})
        for k, row in enumerate(x)
    ]
    return learn(x, records, SPACE, tuple(observations.values()), measure)
