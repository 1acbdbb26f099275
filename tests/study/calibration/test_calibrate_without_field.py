"""Interfaces that make no field: the log-likelihood is learnt instead, and it is said."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from tests.study.calibration.beams import ACTIVE, answer, learnt, summed

from strandline.calibration import Problem
from strandline.design.active import Active
from strandline.design.run_filter import RunFilter
from strandline.discrepancy import Currents
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.report.warnings import find_warnings

SPACE = ParameterSpace((Parameter("lift", Uniform(0.1, 0.9)), Parameter("tilt", Uniform(-0.2, 0.2))))
CURRENTS = Currents(0.2)
FIXED = replace(ACTIVE, runs=32, active=None)


@dataclass(frozen=True)
class Flap:
    """A flap that closes into a loop where it is lifted above `height`; if `jumpy`, with other nodes in every run."""

    height: float = 0.8
    nodes: int = 17
    jumpy: bool = False

    @property
    def fingerprint(self):
        return f"test:flap/{self.height}/{self.nodes}/{self.jumpy}"

    def __call__(self, inputs, workdir):
        extra = int(1e6 * inputs["lift"]) // 7 % 5 if self.jumpy else 0
        s = np.linspace(0.0, 1.0, self.nodes + extra)
        points = np.stack([s, inputs["lift"] * np.sin(np.pi * s) + inputs["tilt"] * s], axis=1)
        return Simulation.of(Interface.polyline(points, closed=inputs["lift"] > self.height))


def problem(model, variance=0.001):
    seen = model({"lift": 0.5, "tilt": 0.02}, Path()).interfaces[""]
    return Problem(model, SPACE, {}, (Observation(seen, variance),), {"measure": CURRENTS})


def test_a_fixed_design_without_common_points_or_with_ones_too_far_off_makes_no_field(tmp_path):
    found = learnt(tmp_path / "open", problem(Flap(height=0.78)), FIXED)
    assert found.knowledge is None
    assert "open polylines in some runs, closed ones in others" in found.no_field
    flap = Flap(height=2.0, nodes=6, jumpy=True)
    rough, fine = (learnt(tmp_path, problem(flap, variance), FIXED) for variance in (0.01, 1e-6))
    assert rough.knowledge.surrogate.registration_error > 0
    assert fine.knowledge is None
    assert "mm away from them" in fine.no_field


def exact(asked):
    """Return the posterior by a sum over a grid of runs."""
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 61), np.linspace(-0.2, 0.2, 61), indexing="ij"), -1)
    likelihood, points = InterfaceLikelihood(asked.observations, CURRENTS), grid.reshape(-1, 2)
    runs = (asked.model({"lift": a, "tilt": b}, Path()).interfaces for a, b in points.tolist())
    return summed(points, np.array([likelihood(run) for run in runs]))


@pytest.mark.long
@pytest.mark.parametrize(("height", "late"), [(0.78, False), (0.82, True)])
def test_another_topology_gives_the_posterior_by_the_other_surrogate(tmp_path, monkeypatch, height, late):
    """Whether the first design meets it or a later batch does; here not even one such run may be set aside."""

    def none(self, records, error):
        raise error

    monkeypatch.setattr(RunFilter, "without_exceptions", none)
    asked, settings = problem(Flap(height=height)), replace(ACTIVE, active=Active(100, batch=4, explore=0.5))
    found = answer(tmp_path, asked, settings)
    assert len({record.key for record in found.records}) == len(found.records) == 100
    assert any(record.interface.closed for record in found.records[: ACTIVE.runs]) is not late
    assert any(record.interface.closed for record in found.records)
    assert "open polylines in some runs, closed ones in others" in found.no_field
    assert max(exact(asked).off(found)[:2]) < 0.15
    assert any(line.startswith("NO FIELD") for line in find_warnings(found))
