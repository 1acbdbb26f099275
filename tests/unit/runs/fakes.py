"""Campaigns of the cantilever, records and ledgers of every kind, and models and executors in this process."""

import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np

from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models.identity import fingerprint
from strandline.runs import NOT_NOW, InProcess, Ledger, RunRecord, RunRequest, run_batches, run_campaign, run_key
from strandline.testing.models import Cantilever

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


def exact(record):
    """Return all that a record says, comparable to the last bit."""
    arrays = [(c, i.points.tobytes(), i.points.shape, i.cells.tolist()) for c, i in record.interfaces.items()]
    slopes = [(c, n, a.tobytes(), a.shape) for c, some in record.sensitivities.items() for n, a in some.items()]
    figures = {name: float(value).hex() for name, value in record.diagnostics.items()}
    rest = (record.seconds, record.failure_kind, record.message, record.log, record.origin)
    return record.key, dict(record.inputs), record.state, arrays, slopes, figures, *rest


def failed(key):
    return RunRecord(key, {}, "failed")


def put(ledger, *records):
    for record in records:
        ledger.started(RunRequest(record.key, record.inputs))
        ledger.finished(record)


def query(path, *statements):
    """Execute statements as another program would; return the rows of the last one."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        return [connection.execute(statement).fetchall() for statement in statements][-1]


def stored(name, folder):
    """Return a copy of a ledger that an earlier version has written."""
    path = Path(shutil.copy(Path(__file__).parents[2] / "data" / name, folder / "ledger.sqlite"))
    path.chmod(0o644)
    return path


def design(*stiffness):
    return [{"E": float(value), "load": 1e-5} for value in stiffness]


def stiffnesses(records):
    return [record.inputs["E"] for record in records]


def states(records):
    return [record.state for record in records]


def key_of(model, inputs):
    return run_key(fingerprint(model), inputs)


def campaign(path, model, inputs, executor=None, **options):
    with Ledger.open(path, model=model) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=executor or InProcess(), **options)


def batches(path, model, first, choose, executor=None, **options):
    with Ledger.open(path, model=model) as ledger:
        return run_batches(model, first, choose, ledger=ledger, executor=executor or InProcess(), **options)


def begun_before(path, model, inputs, times=1):
    """Start a run `times` times without an end, as drivers do that are killed; return its request."""
    request = RunRequest(key_of(model, inputs), inputs)
    with Ledger.open(path, model=model) as ledger:
        for _ in range(times):
            ledger.started(request)
    return request


def counts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts()


def attempts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return sorted(ledger.attempts(record.key) for record in ledger)


def repeated(path):
    """Return how many outcomes a ledger holds beyond one for each run."""
    return query(path, "SELECT count(*) - count(DISTINCT key) FROM outcomes JOIN starts USING (attempt)")[0][0]


def calls(folder, file="calls"):
    """Return how often each run of a `Counted` model was begun, or ended."""
    path = folder / file
    lines = path.read_text().splitlines() if path.exists() else []
    return Counter(line.partition(" ")[2] for line in lines)


class Seen(list):
    """Keeps the records, each with the progress, that a campaign tells of."""

    def __call__(self, record, progress):
        self.append((record, progress))

    @property
    def states(self):
        return [record.state for record, _ in self]

    @property
    def stiffnesses(self):
        return [record.inputs["E"] for record, _ in self]


class Moody:
    """Fails a given number of times at a stiffness before it succeeds there; counts its calls."""

    fingerprint = "moody"

    def __init__(self, moods, error=None):
        self.moods, self.calls = dict(moods), Counter()
        self.error = error or ForwardModelError("licence", "no licence to be had\nserver busy")

    def __call__(self, inputs, workdir):
        stiffness = inputs["E"]
        self.calls[stiffness] += 1
        if self.calls[stiffness] <= self.moods.get(stiffness, 0):
            raise self.error
        return Cantilever()(inputs, workdir)


class Served:
    """A server that goes down after some runs and comes back when it has been probed several times."""

    fingerprint, at_once = "served", 1

    def __init__(self, runs, probes):
        self.runs, self.probes, self.lost = runs, probes, 0

    def require_server(self):
        self.probes -= 1
        if self.probes >= 0:
            raise ForwardModelError("connection", "no server", state="killed")
        self.runs = 100

    def __call__(self, inputs, workdir):
        self.runs -= 1
        if self.runs < 0:
            self.lost += 1
            raise ForwardModelError("connection", "no server", state="killed")
        return Cantilever()(inputs, workdir)


class Noted:
    """Runs one after the other; notes the runs of each of its calls. One that waits takes `NOT_NOW`."""

    def __init__(self, waits=False):
        self.asks_again, self.calls = waits, []

    def __call__(self, model, requests):
        self.calls.append([])
        for request in requests:
            if request is not NOT_NOW:
                self.calls[-1].append(request.inputs["E"])
                yield from InProcess()(model, [request])


class Elsewhere:
    """Makes runs that go on without a driver, in memory; `lost` says how often the run at a stiffness is killed."""

    def __init__(self, lost=()):
        self.submitted, self.waiting, self.lost = [], {}, Counter(lost)

    def outstanding(self, model, keys):
        return self.waiting.keys() & keys

    def __call__(self, model, requests):
        asked = list(requests)
        for request in asked:
            if request.key not in self.waiting:
                self.submitted.append(request.inputs["E"])
                self.waiting[request.key] = request
        for request in asked:
            self.lost[request.inputs["E"]] -= 1
            if self.lost[request.inputs["E"]] >= 0:
                yield RunRecord(request.key, request.inputs, "killed", failure_kind="node_failed", message="gone")
            else:
                yield from InProcess()(model, [request])
            self.waiting.pop(request.key, None)
