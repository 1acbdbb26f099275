"""The whole method with a cheaper model, on a beam whose posterior is known by quadrature."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.study.calibration.beams import ACTIVE, answer, exact, problem

from strandline.calibration import Calibration, Problem
from strandline.design.active import Active
from strandline.design.active.fidelities import FidelityReport
from strandline.interface import Interface
from strandline.models.fidelities import WithCheaper, is_cheaper
from strandline.models.protocol import Simulation
from strandline.testing.studies import beam


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


def asked(cheaper: Any) -> Problem:
    return problem(model=WithCheaper(Beam(), cheaper, 0.2))


def used(found: Calibration) -> FidelityReport:
    assert found.field is not None
    assert found.field.certificate is not None
    report = found.field.certificate.fidelities
    assert report is not None
    return report


def test_a_good_cheaper_model_makes_most_runs_and_the_posterior_is_the_models(tmp_path: Path) -> None:
    """The same ledger gives the same result without a run."""
    good, again = (
        answer(tmp_path / "ledger.sqlite", asked(Beam(soft=0.1)), replace(ACTIVE, active=Active(60, batch=4)))
        for _ in range(2)
    )
    report = used(good)
    assert max(exact().off(good)[:2]) < 0.12
    assert report.dropped is None
    assert report.error is not None
    assert report.error < 0.1 * report.hidden
    assert report.model <= 8
    assert report.cheaper >= 15
    assert len(good.all_runs) == report.cheaper + report.model
    assert sum(is_cheaper(record.inputs) for record in good.all_runs) == report.cheaper
    assert not any(is_cheaper(record.inputs) for record in good.records)
    np.testing.assert_array_equal(good.posterior.draws, again.posterior.draws)
    assert report == used(again)


@pytest.mark.parametrize("shaken", [pytest.param(0.0005, marks=pytest.mark.long), 0.03])
def test_a_cheaper_model_that_misleads_is_dropped(shaken: float, tmp_path: Path) -> None:
    """The noise hides a shift of 0.0015; the cheaper model errs by a third and by 20 times that, at random."""
    settings = replace(ACTIVE, active=Active(140, batch=4))
    found = answer(tmp_path / "ledger.sqlite", asked(Beam(shaken=shaken)), settings)
    assert used(found).dropped is not None
    assert not any("-" in record.key for record in found.records)  # runs of the model alone
    assert found.field is not None
    assert found.field.certificate is not None
    assert found.field.certificate.converged
    assert max(exact().off(found)[:2]) < 0.12
