"""A design grown for a measurement is the active design of a study without its checks."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from verification.validation.active.cases import Case
from verification.validation.active.grow import Grown, grow

from strandline import Currents, Observation, Parameter, ParameterSpace, RunRecord, Uniform
from strandline.models.protocol import fingerprint
from strandline.runs import RunRequest, run_key
from strandline.runs.record import attempt
from strandline.testing.models import Cantilever

BEAM = Cantilever()


@pytest.fixture
def beam(tmp_path: Path) -> Case:
    def run(x: np.ndarray, sensitivities: bool) -> RunRecord:
        inputs = {"E": float(x[0]), "load": float(x[1])}
        return attempt(BEAM, RunRequest(run_key(fingerprint(BEAM), inputs), inputs), tmp_path)

    space = ParameterSpace((Parameter("E", Uniform(2e7, 8e7)), Parameter("load", Uniform(0.5, 1.5))))
    seen = Observation(BEAM.outline(4e7, 1.0), 1e-4)
    return Case("beam", space, (seen,), Currents(0.05), run)


def designs(beam: Case, **options: object) -> list[Grown]:
    return list(grow(beam, seed=3, batch=2, most=14, sensitivities=False, **options))  # type: ignore[arg-type]


@pytest.mark.parametrize("criterion", ["expected_variance", "repulsion"])
def test_batches_follow_each_other_without_a_check(beam: Case, criterion: str) -> None:
    found = designs(beam, criterion=criterion)
    assert [one.runs for one in found] == [8, 10, 12, 14]
    points = [one.state.knowledge.x for one in found]
    for before, after in pairwise(points):
        np.testing.assert_array_equal(after[: len(before)], before)
    assert len(np.unique(points[-1], axis=0)) == 14


def test_too_few_runs_are_more_of_the_first_ones(beam: Case) -> None:
    seen: list[RunRecord] = []

    def spoil(record: RunRecord) -> RunRecord:
        seen.append(record)
        return record if len(seen) > 6 else replace(record, state="failed", interfaces={})

    found = designs(beam, spoil=spoil)
    assert [one.runs for one in found] == [12, 14]
    assert [one.failed for one in found] == [6, 6]
