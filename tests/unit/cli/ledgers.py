"""A small ledger with a run of each kind."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from strandline.interface import Interface
from strandline.runs import Ledger, RunRecord, RunRequest

__all__ = ["RECORDS", "keep", "some_runs"]

LINE = Interface.polyline(np.arange(8.0).reshape(4, 2))
LOG = "a\nlog"
RECORDS = [
    RunRecord("aa1", {"E": 400.0, "nu": 1 / 3}, "ok", {"": LINE}, {"tip": 0.125}, 1.25),
    RunRecord("aa2", {"E": 300.0, "nu": 0.25}, "failed", {}, {"load": 0.5}, 2.5, "stalled", 'no "end",\nlong', LOG),
    RunRecord("ab3", {"E": 301.0, "nu": 0.25}, "failed", {}, {}, 3.5, "limit_point", "bends"),
    RunRecord("ac4", {"E": 302.0, "nu": 0.25}, "timeout", seconds=60.0, failure_kind="timeout"),
    RunRecord("ad5", {"E": 303.0, "nu": 0.25}, "killed", failure_kind="worker_died"),
    RunRecord("ae6", {"E": 304.0, "nu": 0.25}, "invalid", failure_kind="non_finite"),
]  # fmt: skip


def keep(folder: Path, records: Sequence[RunRecord], *open_runs: RunRequest, model: str = "test:beam-1") -> Path:
    """Write a ledger with these runs and return its folder."""
    folder.mkdir(exist_ok=True)
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        for record in records:
            ledger.started(RunRequest(record.key, record.inputs))
            ledger.finished(record)
        for request in open_runs:
            ledger.started(request)
    return folder


def some_runs(folder: Path) -> Path:
    """Write a ledger with all of `RECORDS`, the second open again, and one more under way."""
    return keep(folder, RECORDS, RunRequest("af7", {"E": 305.0, "nu": 0.25}), RunRequest("aa2", RECORDS[1].inputs))
