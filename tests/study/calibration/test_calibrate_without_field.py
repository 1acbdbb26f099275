"""Interfaces that make no field: the log-likelihood is learnt instead, and it is said."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.study.calibration.beams import ACTIVE, Exact, answer, learnt, summed

from strandline.calibration import Observer, Problem
from strandline.design.active import Active
from strandline.discrepancy import Currents
from strandline.errors import NoCommonPoints
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.likelihood.set_aside import Judge
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.report.warnings import find_warnings
from strandline.runs import RunRecord

SPACE = ParameterSpace((Parameter("lift", Uniform(0.1, 0.9)), Parameter("tilt", Uniform(-0.2, 0.2))))
CURRENTS = Currents(0.2)
SETTINGS = replace(ACTIVE, active=Active(100, batch=4))
FIXED = replace(ACTIVE, runs=32, active=None)


@dataclass(frozen=True)
class Flap:
    """A flap that closes into a loop where it is lifted above `height`.

    Args:
        height: of the lift from which on it touches its own foot.
        nodes: of the polyline; where `jumpy`, a number that changes from run to run.
        jumpy: whether it is meshed anew in every run.
    """

    height: float = 0.8
    nodes: int = 17
    jumpy: bool = False

    @property
    def fingerprint(self) -> str:
        return f"test:flap/{self.height}/{self.nodes}/{self.jumpy}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        extra = int(1e6 * inputs["lift"]) // 7 % 5 if self.jumpy else 0
        s = np.linspace(0.0, 1.0, self.nodes + extra)
        points = np.stack([s, inputs["lift"] * np.sin(np.pi * s) + inputs["tilt"] * s], axis=1)
        return Simulation.of(Interface.polyline(points, closed=inputs["lift"] > self.height))


def problem(model: Any, variance: float = 0.001, measure: Any = CURRENTS) -> Problem:
    seen = model({"lift": 0.5, "tilt": 0.02}, Path()).interfaces[""]
    return Problem(model, SPACE, {}, (Observation(seen, variance),), {"measure": measure})


def test_a_fixed_design_is_learnt_from_as_it_is(tmp_path: Path) -> None:
    found = learnt(tmp_path, problem(Flap(height=0.78)), FIXED)
    assert found.knowledge is None
    assert "open polylines in some runs, closed ones in others" in (found.no_field or "")
    assert found.found["no_field"] == found.no_field
    assert (len(found.learnt.records), found.rounds) == (32, ())
    assert list(found.learnt.surrogates) == ["measure"]


def test_common_points_farther_off_than_the_noise_hides_make_no_field(tmp_path: Path) -> None:
    """Six nodes are cut across by 33 equal shares of the arclength: a matter of the noise."""
    flap = Flap(height=2.0, nodes=6, jumpy=True)
    rough, fine = (learnt(tmp_path, problem(flap, variance), FIXED) for variance in (0.01, 1e-6))
    assert rough.no_field is None
    assert rough.knowledge is not None
    assert rough.knowledge.surrogate.registration_error > 0
    assert fine.knowledge is None
    assert "mm away from them" in (fine.no_field or "")


def exact(asked: Problem) -> Exact:
    """Return the posterior by a sum over a grid of runs."""
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 61), np.linspace(-0.2, 0.2, 61), indexing="ij"), -1)
    likelihood, points = InterfaceLikelihood(asked.observations, CURRENTS), grid.reshape(-1, 2)
    runs = (asked.model({"lift": a, "tilt": b}, Path()).interfaces for a, b in points.tolist())
    return summed(points, np.array([likelihood(run) for run in runs]))


@pytest.mark.long
@pytest.mark.parametrize(("height", "late"), [(0.78, False), (0.82, True)])
def test_another_topology_gives_the_posterior_by_the_other_surrogate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, height: float, late: bool
) -> None:
    """Whether the first design meets it or a later batch does; here not even one such run may be set aside."""

    def none(self: Judge, records: Sequence[RunRecord], error: NoCommonPoints) -> None:
        """Set no run aside."""
        raise error

    monkeypatch.setattr(Judge, "without_exceptions", none)
    asked, told, made = problem(Flap(height=height)), [], []
    observer = Observer(draws=lambda inputs: told.extend(inputs), run=lambda record, progress: made.append(record.key))
    settings = replace(ACTIVE, active=Active(100, batch=4, explore=0.5))
    found = answer(tmp_path / "ledger.sqlite", asked, settings, observer=observer)
    assert len(told) == 100 - ACTIVE.runs
    assert len(made) == len(set(made)) == 100
    assert not found.seconds.keys() - {"forward", "surrogate", "refinement", "sampling", "check", "choice"}
    closed = [record.interface.closed for record in found.records]
    assert any(closed[: ACTIVE.runs]) is not late
    assert found.field is None
    assert "open polylines in some runs, closed ones in others" in (found.no_field or "")
    assert len(found.records) == 100
    assert len(found.rounds) == 4
    assert max(exact(asked).off(found)[:2]) < 0.15
    (warning,) = (line for line in find_warnings(found) if line.startswith("NO FIELD"))
    assert "`strandline posterior check`" in warning


@pytest.mark.long
@pytest.mark.parametrize("height", [0.7, 0.82])
def test_another_noise_of_the_same_runs_is_learnt_as_the_first_was(tmp_path: Path, height: float) -> None:
    """Of the higher flap that closes in a tenth of the box, a field is made of the runs that stay open."""
    path, asked, made = tmp_path / "ledger.sqlite", problem(Flap(height=height)), []
    found = answer(path, asked, SETTINGS)
    given = np.array([[record.inputs[name] for name in SPACE.names] for record in found.records])
    observer = Observer(run=lambda record, progress: made.append(record.key))
    other = answer(path, problem(Flap(height=height), 0.002), SETTINGS, given=given, observer=observer)
    if height == 0.7:
        assert made == []
        assert found.no_field is not None
        assert other.no_field is not None
        assert len(other.records) == len(found.records)
        return
    assert exact(asked).off(found)[0] < 0.15
    for one in (found, other):
        assert one.no_field is None
        closed = [record.inputs["lift"] > 0.82 for record in one.records]
        assert 0 < sum(closed) == len(one.set_aside)
        assert [record.ok for record in one.records] == [not is_closed for is_closed in closed]
