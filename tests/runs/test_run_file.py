"""Records in files of their own: what is read is what was written, or nothing."""

import math
from pathlib import Path

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.runs import RunRecord
from strandline.runs.run_file import read_run, write_run
from strandline.testing.executors import requests_for, same_outcome
from strandline.testing.models import TwoLoads

INPUTS = {"E": 0.1 + 0.2, "load": 1e-5}


def two_loads() -> RunRecord:
    model = TwoLoads(sensitivities=True)
    request = requests_for(model)[0]
    result = model(request.inputs, Path())
    figures = {**result.diagnostics, "none": math.inf}
    return RunRecord(
        request.key, request.inputs, "ok", result.interfaces, figures, 1.5, sensitivities=result.sensitivities
    )


RECORDS = {
    "two conditions and sensitivities": two_loads(),
    "one interface": RunRecord("a", INPUTS, "ok", {"": Interface.polyline(np.random.default_rng(1).random((5, 2)))}),
    "failed": RunRecord("b", INPUTS, "failed", {}, {"load": 0.5}, 2.0, "stalled", "it’s ∂-stuck\nlines", "log\n"),
    "bare": RunRecord("c", {}, "killed"),
}


@pytest.mark.parametrize("record", RECORDS.values(), ids=RECORDS.keys())
def test_there_and_back(tmp_path: Path, record: RunRecord) -> None:
    write_run(tmp_path / "7.run", record)
    found = read_run(tmp_path / "7.run")
    assert same_outcome(found, record)
    assert (found.seconds, found.message, found.log) == (record.seconds, record.message, record.log)
    assert [path.name for path in tmp_path.iterdir()] == ["7.run"]


@pytest.mark.parametrize("place", [0, 30, 80, 200, 500, -1])
def test_a_changed_byte_is_seen(tmp_path: Path, place: int) -> None:
    path = tmp_path / "7.run"
    write_run(path, RECORDS["one interface"])
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"7\.run"):
        read_run(path)


@pytest.mark.parametrize("kept", [0, 10, 90, 300])
def test_a_truncated_file_is_seen(tmp_path: Path, kept: int) -> None:
    path = tmp_path / "7.run"
    write_run(path, RECORDS["failed"])
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InvalidInput):
        read_run(path)
