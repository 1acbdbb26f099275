"""What is told of a posterior by a surrogate of the field: nothing where all is well, a sentence for each doubt."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design.active import BatchCheck, Certificate, FieldOutcome, Step, VarianceEffect
from strandline.discrepancy import TrackedPoints
from strandline.interface import Observation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.report.field_warnings import field_warnings
from strandline.report.run_figures import offsets_of_runs
from strandline.report.warnings import reason_to_doubt
from strandline.runs import InProcess, Ledger
from strandline.smc import SMCSettings
from strandline.testing.studies import beam


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Calibration]:
    space = ParameterSpace(
        (
            Parameter("E", Uniform(300.0, 560.0), "Pa"),
            Parameter("load", Uniform(0.8e-5, 1.2e-5), nuisance=True),
        )
    )
    seen = Observation(beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, Path()).interface, 0.01**2)
    problem = Problem(beam, space, {"tilt": 0.02}, (seen,), {"tracked": TrackedPoints()})
    settings = Settings(
        runs=30,
        particles=600,
        smc=SMCSettings(rejuvenation_steps=5, zeta=0.5),
        surrogate="field",
        nuisance_values=4,
    )
    path = tmp_path_factory.mktemp("field-warnings") / "ledger.sqlite"
    with pytest.MonkeyPatch.context() as patch, Ledger.open(path, model=beam) as ledger:
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        patch.setattr("strandline.calibration.learning._to_compare", lambda *arguments: {})
        yield calibrate(problem, settings, ledger=ledger, executor=InProcess())


@pytest.fixture
def found(calibration: Calibration) -> FieldOutcome:
    assert calibration.field is not None
    return calibration.field


def told(calibration: Calibration, found: FieldOutcome) -> list[str]:
    return list(field_warnings(calibration, found))


def test_nothing_where_all_is_well(calibration: Calibration, found: FieldOutcome) -> None:
    assert told(calibration, found) == []


def test_what_has_not_converged_is_told_first(calibration: Calibration, found: FieldOutcome) -> None:
    certificate = Certificate(False, ("all 30 runs that were allowed are made",), (), (), None)
    (line,) = told(calibration, replace(found, certificate=certificate))
    assert line.startswith("NOT CONVERGED: all 30 runs that were allowed are made.")
    assert "design.active.runs" in line
    assert told(calibration, replace(found, certificate=replace(certificate, converged=True))) == []
    unsure = replace(calibration, field=replace(found, certificate=certificate))
    assert reason_to_doubt(unsure) == "not converged, all 30 runs that were allowed are made"
    assert unsure.misfit is not None
    both = replace(unsure, misfit=replace(unsure.misfit, flagged=True))
    assert reason_to_doubt(both) == "the model does not explain what was observed"
    sure = replace(found, certificate=replace(certificate, converged=True))
    assert reason_to_doubt(replace(calibration, field=sure)) is None
    assert not list(offsets_of_runs(calibration)), "a surrogate of the field has a figure of its own draws"


def test_a_region_that_may_have_been_overlooked_is_told(calibration: Calibration, found: FieldOutcome) -> None:
    certificate = Certificate(True, (), (), (), None, 0.3, overlooks=True)
    (line,) = told(calibration, replace(found, certificate=certificate))
    assert "as design.active.unseen asks" in line
    assert "if it holds 30% or more of the prior's mass" in line


@pytest.mark.parametrize(
    ("shift", "ratio", "words"),
    [(-0.3, 1.0, "by up to 0.30 standard deviations"), (0.0, 1.5, "changes standard deviations by up to 50%")],
)
def test_an_uncertain_surrogate_is_told(
    calibration: Calibration, found: FieldOutcome, shift: float, ratio: float, words: str
) -> None:
    effect = VarianceEffect(np.array([0.0, shift]), np.array([1.0, ratio]), 0.5)
    (line,) = told(calibration, replace(found, effect=effect))
    assert words in line


def test_mass_where_runs_fail_is_told(calibration: Calibration, found: FieldOutcome) -> None:
    (line,) = told(calibration, replace(found, feasible=0.9))
    assert line.startswith("10% of the posterior lies where runs are likely to fail")
    assert told(calibration, replace(found, feasible=0.96)) == []


def test_failed_runs_of_a_check_are_told(calibration: Calibration, found: FieldOutcome) -> None:
    check = BatchCheck(25, 3, None, True, ())
    step = Step(30, 27, "check", np.zeros(2), np.ones(2), 1e-4, None, None, check)
    (line,) = told(calibration, replace(found, certificate=Certificate(True, (), (step,), (), step)))
    assert line.startswith("3 of 25 runs at draws of the posterior failed")


def test_interfaces_that_were_brought_to_common_points_are_told(calibration: Calibration, found: FieldOutcome) -> None:
    surrogate = found.knowledge.surrogate
    layouts = {name: replace(layout, way="arclength") for name, layout in surrogate.layouts.items()}
    moved = replace(surrogate, layouts=layouts, registration_error=0.002)
    likelihood = replace(found.knowledge.likelihood, surrogate=moved)
    (line,) = told(calibration, replace(found, knowledge=replace(found.knowledge, likelihood=likelihood)))
    assert "by arclength, which moves them by up to 2 µm" in line


def test_a_cut_reading_where_the_surrogate_knows_nothing_is_told(calibration: Calibration, found: FieldOutcome) -> None:
    """Variances a million times as large: every value of the nuisance input is a guess then."""
    surrogate = found.knowledge.surrogate
    wide = tuple(replace(process, widening=1e10 * process.widening) for process in surrogate.processes)
    likelihood = replace(found.knowledge.likelihood, surrogate=replace(surrogate, processes=wide))
    unsure = replace(found, knowledge=replace(found.knowledge, likelihood=likelihood))
    (line,) = told(calibration, unsure)
    assert line.startswith("The cut reading is a guess for 4 of its 4 values")
    assert "the local noise hides 2.4 µm" in line
    assert told(replace(calibration, under_uncertainty=None), unsure) == []
