"""Interfaces that make no field: the log-likelihood is learnt instead, and it is said."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Calibration, Observer, Problem, Settings, calibrate
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
from strandline.runs import InProcess, Ledger, RunRecord
from strandline.smc import SMCSettings

SPACE = ParameterSpace((Parameter("lift", Uniform(0.1, 0.9)), Parameter("tilt", Uniform(-0.2, 0.2))))
MEASURE = Currents(0.2)


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


SETTINGS = Settings(
    runs=8,
    particles=2000,
    smc=SMCSettings(rejuvenation_steps=8, zeta=0.5),
    surrogate="field",
    active=Active(100, batch=4),
)


def problem(model: Any, variance: float = 0.001) -> Problem:
    seen = model({"lift": 0.5, "tilt": 0.02}, Path()).interfaces[""]
    return Problem(model, SPACE, {}, (Observation(seen, variance),), {"currents": MEASURE})


def answer(path: Path, asked: Problem, settings: Settings = SETTINGS, **options: Any) -> Calibration:
    with Ledger.open(path, model=asked.model) as ledger:
        return calibrate(asked, settings, ledger=ledger, executor=InProcess(), **options)


def exact(asked: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation by a sum over a grid of runs."""
    grid = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 61), np.linspace(-0.2, 0.2, 61), indexing="ij"), -1).reshape(
        -1, 2
    )
    likelihood, model = InterfaceLikelihood(asked.observations, MEASURE), asked.model
    values = np.array([likelihood(model({"lift": a, "tilt": b}, Path()).interfaces) for a, b in grid.tolist()])
    weights = np.exp(values - values.max()) / np.exp(values - values.max()).sum()
    mean = weights @ grid
    return mean, np.sqrt(weights @ (grid - mean) ** 2)


@pytest.fixture(autouse=True)
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.design.active.sampling.PARTICLES", {2: 600})
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        yield


@pytest.mark.long
def test_another_topology_is_learnt_by_the_other_surrogate(tmp_path: Path) -> None:
    active = Active(40, batch=4, explore=0.5)
    found = answer(tmp_path / "ledger.sqlite", problem(Flap(height=0.78)), replace(SETTINGS, active=active))
    assert found.field is None
    assert found.no_field is not None
    assert "open polylines in some runs, closed ones in others" in found.no_field
    assert len(found.records) == 40
    assert len([line for line in find_warnings(found) if line.startswith("NO FIELD")]) == 1


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
    asked = problem(Flap(height=height))
    found = answer(tmp_path / "ledger.sqlite", asked, replace(SETTINGS, active=Active(100, batch=4, explore=0.5)))
    closed = [record.interface.closed for record in found.records]
    assert any(closed[: SETTINGS.runs]) is not late
    assert found.field is None
    assert found.no_field is not None
    assert "open polylines in some runs, closed ones in others" in found.no_field
    assert len(found.records) == 100
    assert len(found.rounds) == 4
    mean, sd = exact(asked)
    assert np.abs((found.posterior.mean - mean) / sd).max() < 0.15
    assert np.abs(found.posterior.sd / sd - 1).max() < 0.15
    told = [line for line in find_warnings(found) if line.startswith("NO FIELD")]
    assert len(told) == 1
    assert "`strandline posterior check`" in told[0]


@pytest.mark.long
def test_all_runs_are_told_and_none_is_made_twice(tmp_path: Path) -> None:
    asked, told, made = problem(Flap(height=0.7)), [], []
    observer = Observer(draws=lambda inputs: told.extend(inputs), run=lambda record, progress: made.append(record.key))
    found = answer(tmp_path / "ledger.sqlite", asked, observer=observer)
    assert len(told) == 100 - SETTINGS.runs
    assert len(made) == len(set(made)) == 100
    assert not found.seconds.keys() - {"forward", "surrogate", "refinement", "sampling", "check", "choice"}
    made.clear()
    again = answer(tmp_path / "ledger.sqlite", asked, observer=observer)
    assert made == []
    np.testing.assert_array_equal(again.posterior.draws, found.posterior.draws)


def given_again(path: Path, height: float) -> tuple[Calibration, Calibration, list[str]]:
    """Return an active design, what another noise makes of its runs, and the keys of the runs that this made."""
    found, made = answer(path, problem(Flap(height=height))), []
    given = np.array([[record.inputs[name] for name in SPACE.names] for record in found.records])
    observer = Observer(run=lambda record, progress: made.append(record.key))
    other = answer(path, problem(Flap(height=height), 0.002), given=given, observer=observer)
    return found, other, made


@pytest.mark.long
def test_given_runs_are_enough_for_the_other_surrogate(tmp_path: Path) -> None:
    found, other, made = given_again(tmp_path / "ledger.sqlite", 0.7)
    assert made == []
    assert found.no_field is not None
    assert other.no_field is not None
    assert len(other.records) == len(found.records)


@pytest.mark.long
def test_few_closed_ones_are_set_aside_by_an_active_design_and_of_its_runs_given(tmp_path: Path) -> None:
    """Of a higher flap that closes in a tenth of the box: a field is made of the others, both times."""
    found, other, _ = given_again(tmp_path / "ledger.sqlite", 0.82)
    mean, sd = exact(problem(Flap(height=0.82)))
    assert np.abs((found.posterior.mean - mean) / sd).max() < 0.15
    for one in (found, other):
        assert one.no_field is None
        closed = [record.inputs["lift"] > 0.82 for record in one.records]
        assert 0 < sum(closed) == len(one.set_aside)
        assert [record.ok for record in one.records] == [not is_closed for is_closed in closed]


def test_a_fixed_design_is_learnt_from_as_it_is(tmp_path: Path) -> None:
    found = answer(tmp_path / "ledger.sqlite", problem(Flap(height=0.78)), replace(SETTINGS, runs=60, active=None))
    assert found.no_field is not None
    assert (len(found.records), found.rounds) == (60, ())


def test_common_points_farther_off_than_the_noise_hides_make_no_field(tmp_path: Path) -> None:
    """Six nodes are cut across by 33 equal shares of the arclength: a matter of the noise."""
    flap, fixed = Flap(height=2.0, nodes=6, jumpy=True), replace(SETTINGS, runs=30, active=None)
    rough = answer(tmp_path / "rough.sqlite", problem(flap, 0.01), fixed)
    fine = answer(tmp_path / "fine.sqlite", problem(flap, 1e-6), fixed)
    assert rough.no_field is None
    assert rough.field is not None
    assert rough.field.knowledge.surrogate.registration_error > 0
    assert fine.field is None
    assert fine.no_field is not None
    assert "mm away from them" in fine.no_field
