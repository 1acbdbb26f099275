"""What is told of a posterior by a surrogate of the field: nothing where all is well, a sentence for each doubt."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.study.conftest import Finished

from strandline.calibration import Calibration
from strandline.design.active import BatchCheck, Certificate, FieldOutcome, Step, VarianceEffect
from strandline.report.field_warnings import field_warnings
from strandline.report.run_figures import offsets_of_runs
from strandline.report.warnings import reason_to_doubt


@pytest.fixture
def calibration(field: Finished) -> Calibration:
    found: Calibration = field.outcome.calibration
    return found


@pytest.fixture
def found(calibration: Calibration) -> FieldOutcome:
    assert calibration.field is not None
    return calibration.field


def test_each_doubt_is_told_alone(calibration: Calibration, found: FieldOutcome) -> None:
    def told(**changes: Any) -> list[str]:
        return list(field_warnings(calibration, replace(found, **changes)))

    check = BatchCheck(25, 3, None, True, ())
    step = Step(30, 27, "check", np.zeros(2), np.ones(2), 1e-4, None, None, check)
    reasons = ("all 30 runs that were allowed are made",)
    for changes, words in (
        ({"certificate": Certificate(False, reasons, (), (), None)}, f"NOT CONVERGED: {reasons[0]}."),
        ({"certificate": Certificate(False, reasons, (), (), None)}, "design.active.runs"),
        (
            {"certificate": Certificate(True, (), (), (), None, 0.3, overlooks=True)},
            "as design.active.unseen asks",
        ),
        (
            {"certificate": Certificate(True, (), (), (), None, 0.3, overlooks=True)},
            "if it holds 30% or more of the prior's mass",
        ),
        (
            {"effect": VarianceEffect(np.array([0.0, -0.3]), np.ones(2), 0.5)},
            "by up to 0.30 standard deviations",
        ),
        (
            {"effect": VarianceEffect(np.zeros(2), np.array([1.0, 1.5]), 0.5)},
            "changes standard deviations by up to 50%",
        ),
        ({"feasible": 0.9}, "10% of the posterior lies where runs are likely to fail"),
        (
            {"certificate": Certificate(True, (), (step,), (), step)},
            "3 of 25 runs at draws of the posterior failed",
        ),
    ):
        (line,) = told(**changes)
        assert words in line
    for fine in ({}, {"certificate": Certificate(True, reasons, (), (), None)}, {"feasible": 0.96}):
        assert told(**fine) == []


def test_the_first_reason_to_doubt_counts(calibration: Calibration, found: FieldOutcome) -> None:
    certificate = Certificate(False, ("all 30 runs that were allowed are made",), (), (), None)
    unsure = replace(calibration, field=replace(found, certificate=certificate))
    assert reason_to_doubt(unsure) == "not converged, all 30 runs that were allowed are made"
    assert unsure.misfit is not None
    both = replace(unsure, misfit=replace(unsure.misfit, flagged=True))
    assert reason_to_doubt(both) == "the model does not explain what was observed"
    sure = replace(found, certificate=replace(certificate, converged=True))
    assert reason_to_doubt(replace(calibration, field=sure)) is None
    assert not list(offsets_of_runs(calibration)), "a surrogate of the field has a figure of its own draws"


def test_a_surrogate_that_moves_points_or_knows_nothing_is_told(calibration: Calibration, found: FieldOutcome) -> None:
    """Variances 10¹⁰ times as large: every value of the nuisance input is a guess then."""
    likelihood, surrogate = found.knowledge.likelihood, found.knowledge.surrogate

    def with_surrogate(**changes: Any) -> FieldOutcome:
        changed = replace(likelihood, surrogate=replace(surrogate, **changes))
        return replace(found, knowledge=replace(found.knowledge, likelihood=changed))

    layouts = {name: replace(layout, way="arclength") for name, layout in surrogate.layouts.items()}
    (line,) = field_warnings(calibration, with_surrogate(layouts=layouts, registration_error=0.002))
    assert "by arclength, which moves them by up to 2 µm" in line
    wide = tuple(replace(process, widening=1e10 * process.widening) for process in surrogate.processes)
    unsure = with_surrogate(processes=wide)
    (line,) = field_warnings(calibration, unsure)
    assert line.startswith("The cut reading is a guess for 2 of its 2 values")
    assert "the local noise hides" in line
    assert not list(field_warnings(replace(calibration, under_uncertainty=None), unsure))
