"""A design grown for a measurement is the active design of a study without its checks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verification.validation.active.cases import Case
from verification.validation.active.grow import grow

from strandline import Currents, Observation, Parameter, ParameterSpace, RunRecord, Uniform
from strandline.models.protocol import fingerprint
from strandline.runs import RunRequest, run_key
from strandline.runs.record import attempt
from strandline.testing.models import Cantilever

BEAM = Cantilever()
SETTINGS = {"seed": 3, "batch": 2, "sensitivities": False}


@pytest.fixture
def beam(tmp_path: Path) -> Case:
    def run(x: np.ndarray, sensitivities: bool) -> RunRecord:
        inputs = {"E": float(x[0]), "load": float(x[1])}
        return attempt(BEAM, RunRequest(run_key(fingerprint(BEAM), inputs), inputs), tmp_path)

    space = ParameterSpace((Parameter("E", Uniform(2e7, 8e7)), Parameter("load", Uniform(0.5, 1.5))))
    seen = Observation(BEAM.outline(4e7, 1.0), 1e-4)
    return Case("beam", space, (seen,), Currents(0.05), run)


def test_batches_follow_each_other_without_a_check(beam: Case) -> None:
    found = list(grow(beam, most=10, **SETTINGS))  # type: ignore[arg-type]
    assert [one.runs for one in found] == [8, 10]
    before, after = (one.state.knowledge.x for one in found)
    np.testing.assert_array_equal(after[:8], before)
    assert len(np.unique(after, axis=0)) == 10


def test_too_few_runs_are_more_of_the_first_ones(beam: Case) -> None:
    seen: list[RunRecord] = []

    def spoil(record: RunRecord) -> RunRecord:
        seen.append(record)
        return record if len(seen) > 6 else replace(record, state="failed", interfaces={})

    found = list(grow(beam, most=12, criterion="repulsion", spoil=spoil, **SETTINGS))  # type: ignore[arg-type]
    assert [(one.runs, one.failed) for one in found] == [(12, 6)]
