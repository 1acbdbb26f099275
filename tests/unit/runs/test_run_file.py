"""Records in files of their own: what is read is what was written, or nothing."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.runs import RunRecord
from strandline.runs.run_file import read_run, write_run
from strandline.testing.executors import requests_for, same_outcome
from strandline.testing.models import TwoLoads

INPUTS = {"E": 0.1 + 0.2, "load": 1e-5}
LINE = Interface.polyline(np.random.default_rng(1).random((5, 2)))


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
    "one interface": RunRecord("a", INPUTS, "ok", {"": LINE}),
    "failed": RunRecord("b", INPUTS, "failed", {}, {"load": 0.5}, 2.0, "stalled", "it’s ∂-stuck\nlines", "log\n"),
    "bare": RunRecord("c", {}, "killed"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.mark.parametrize("record", RECORDS.values(), ids=RECORDS.keys())
def test_there_and_back(tmp_path: Path, record: RunRecord) -> None:
    write_run(tmp_path / "7.run", record)
    found = read_run(tmp_path / "7.run")
    assert same_outcome(found, record)
    assert (found.seconds, found.message, found.log) == (record.seconds, record.message, record.log)
    assert [path.name for path in tmp_path.iterdir()] == ["7.run"]


@settings(max_examples=20)
@given(name=st.sampled_from(["one interface", "failed"]), place=st.floats(0, 1, exclude_max=True), cut=st.booleans())
def test_a_changed_byte_or_a_missing_end_is_seen(folder: Path, name: str, place: float, cut: bool) -> None:
    path = folder / "7.run"
    write_run(path, RECORDS[name])
    content = bytearray(path.read_bytes())
    number = int(place * len(content))
    content[number] ^= 1
    path.write_bytes(content[:number] if cut else content)
    with pytest.raises(InvalidInput, match=r"7\.run"):
        read_run(path)
