"""Records of every kind, ledgers of earlier versions, and what is compared of them."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
from tests.unit.runs.fakes import DATA

from strandline.interface import Interface
from strandline.runs import RunRecord, RunRequest

LINE = Interface.polyline(np.random.default_rng(1).normal(size=(66, 2)))
TETRAHEDRON = Interface(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
SLOPES = {"slow": {"E": np.random.default_rng(2).normal(size=(66, 2)), "nu": np.full((66, 2), -1e-300)}}
TWO = RunRecord("two", {"E": 7.0}, "ok", {"slow": LINE, "a b": TETRAHEDRON}, sensitivities=SLOPES)
ONE = RunRecord("line", {"E": 0.1, "nu": -1e-300}, "ok", {"": LINE}, {"iterations": 7.0, "J": float("nan")}, 0.25)
SURFACE = RunRecord("surface", {"E": 1 / 3}, "ok", {"": TETRAHEDRON})
BAD = RunRecord("bad", {"E": 2.0}, "failed", {}, {"load": 0.5}, 1.0, "limit_point", "no équilibre", "a\nlog")
RECORDS = [
    TWO,
    RunRecord("steep", {"E": 8.0}, "ok", {"": LINE}, sensitivities={"": SLOPES["slow"]}),
    ONE,
    SURFACE,
    BAD,
    RunRecord("slow", {"E": 3.0}, "timeout", failure_kind="timeout", message="still running"),
    RunRecord("gone", {"E": 4.0}, "killed", failure_kind="worker_died", message="SIGKILL"),
    RunRecord("odd", {"E": 5.0}, "invalid", failure_kind="non_finite", message="NaN"),
]


def put(ledger, *records):
    for record in records:
        ledger.started(RunRequest(record.key, record.inputs))
        ledger.finished(record)


def failed(key):
    return RunRecord(key, {}, "failed")


def exact(record):
    """Return all that a record says, comparable to the last bit."""
    arrays = [(c, i.points.tobytes(), i.points.shape, i.cells.tolist()) for c, i in record.interfaces.items()]
    arrays += [
        (c, n, a.tobytes(), a.shape) for c, by_input in record.sensitivities.items() for n, a in by_input.items()
    ]
    figures = {name: float(value).hex() for name, value in record.diagnostics.items()}
    rest = (record.seconds, record.failure_kind, record.message, record.log, record.origin)
    return record.key, dict(record.inputs), record.state, arrays, figures, *rest


def tamper(path, *statements):
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


def stored(name, folder):
    """Return a copy of a ledger that an earlier version has written."""
    path = Path(shutil.copy(DATA / name, folder / "ledger.sqlite"))
    path.chmod(0o644)
    return path


def table(path, sql):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(sql).fetchall()
