"""The whole method with a cheaper model, on a beam whose posterior is known by quadrature."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.calibration.test_calibrate_by_field import SETTINGS, answer, off, problem

from strandline.calibration import Calibration, Problem
from strandline.design.active import Active
from strandline.design.active.fidelities import Fidelities, FidelityReport
from strandline.interface import Interface
from strandline.models.fidelities import WithCheaper, is_cheaper
from strandline.models.protocol import Simulation
from strandline.testing.studies import beam

ACTIVE = replace(SETTINGS, active=Active(60, batch=4))


@dataclass(frozen=True)
class Beam:
    """The beam, made softer by a share, and shaken by an amount that depends on the inputs without any order."""

    soft: float = 0.0
    shaken: float = 0.0

    @property
    def fingerprint(self) -> str:
        return f"beam:{self.soft}:{self.shaken}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        inputs = {name: value for name, value in inputs.items() if name in ("E", "tilt", "load")}
        points = beam({**inputs, "E": inputs["E"] / (1 + self.soft)}, workdir).interface.points.copy()
        x = points[:, 0]
        seed = np.frombuffer(np.array([inputs["E"], inputs["tilt"]]).tobytes(), np.uint32)
        a, b = np.random.default_rng(seed).standard_normal(2)
        points[:, 1] += self.shaken * (a * np.sin(np.pi * x) + b * np.sin(2 * np.pi * x))
        return Simulation.of(Interface.polyline(points))


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Draw fewer particles after each batch; leave out what is only told beside the posterior."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.design.active.sampling.PARTICLES", {2: 600})
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        patch.setattr("strandline.calibration.learning._to_compare", lambda *arguments: {})
        yield


def asked(cheaper: Any) -> Problem:
    return problem(model=WithCheaper(Beam(), cheaper, 0.2))


def used(found: Calibration) -> FidelityReport:
    assert found.field is not None
    assert found.field.certificate is not None
    report = found.field.certificate.fidelities
    assert report is not None
    return report


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    return answer(tmp_path_factory.mktemp("good") / "ledger.sqlite", asked(Beam(soft=0.1)), ACTIVE)


def test_a_good_cheaper_model_makes_most_runs_and_the_posterior_is_the_models(good: Calibration) -> None:
    report = used(good)
    shift, width = off(good, problem())
    assert shift < 0.1
    assert width < 0.1
    assert report.dropped is None
    assert report.error is not None
    assert report.error < 0.1 * report.hidden
    assert report.model <= 8
    assert report.cheaper >= 15
    assert len(good.all_runs) == report.cheaper + report.model
    assert sum(is_cheaper(record.inputs) for record in good.all_runs) == report.cheaper
    assert not any(is_cheaper(record.inputs) for record in good.records)


def test_the_same_ledger_gives_the_same_result_without_a_run(good: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    first = answer(path, asked(Beam(soft=0.1)), ACTIVE)
    again = answer(path, asked(Beam(soft=0.1)), ACTIVE)
    np.testing.assert_array_equal(first.posterior.draws, again.posterior.draws)
    np.testing.assert_array_equal(first.posterior.draws, good.posterior.draws)
    assert used(first) == used(again)


@pytest.mark.parametrize("shaken", [0.0005, 0.03])
def test_a_cheaper_model_that_misleads_is_dropped(shaken: float, tmp_path: Path) -> None:
    """The noise hides a shift of 0.0015; the cheaper model errs by a third and by 20 times that, at random."""
    found = answer(tmp_path / "ledger.sqlite", asked(Beam(shaken=shaken)), replace(ACTIVE, active=Active(100, batch=4)))
    assert used(found).dropped is not None
    assert not any("-" in record.key for record in found.records)  # runs of the model alone
    assert found.field is not None
    assert found.field.certificate is not None
    assert found.field.certificate.converged
    shift, width = off(found, problem())
    assert shift < 0.1
    assert width < 0.1


def test_a_trusting_design_would_be_misled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without trials at draws of the posterior, a cheaper model that is softer at random would be believed."""
    monkeypatch.setattr(Fidelities, "_refute", lambda self, error: None)
    monkeypatch.setattr(Fidelities, "doubts", lambda self: ())
    found = answer(tmp_path / "ledger.sqlite", asked(Beam(shaken=0.0005)), ACTIVE)
    assert used(found).dropped is None
