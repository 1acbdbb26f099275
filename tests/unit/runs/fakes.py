"""Campaigns of the cantilever; models and executors in this process that behave as a test needs it."""

import sqlite3
from collections import Counter
from contextlib import closing
from pathlib import Path

from strandline.errors import ForwardModelError
from strandline.models.protocol import fingerprint
from strandline.runs import NOT_NOW, InProcess, Ledger, RunRecord, RunRequest, run_batches, run_campaign, run_key
from strandline.testing.models import Cantilever

DATA = Path(__file__).parents[2] / "data"


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
    with Ledger.open(path, model=fingerprint(model)) as ledger:
        for _ in range(times):
            ledger.started(request)
    return request


def counts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts()


def attempts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return sorted(ledger.attempts(record.key) for record in ledger)


def calls(folder, file="calls"):
    """Return how often each run of a `Counted` model was begun, or ended."""
    path = folder / file
    lines = path.read_text().splitlines() if path.exists() else []
    return Counter(line.partition(" ")[2] for line in lines)


def repeated(path):
    """Return how many outcomes a ledger holds beyond one for each run."""
    sql = "SELECT count(*) - count(DISTINCT key) FROM outcomes JOIN starts USING (attempt)"
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(sql).fetchone()[0]


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

    def __init__(self, moods, kind="licence"):
        self.moods, self.kind, self.calls = dict(moods), kind, Counter()

    def __call__(self, inputs, workdir):
        stiffness = inputs["E"]
        self.calls[stiffness] += 1
        if self.calls[stiffness] <= self.moods.get(stiffness, 0):
            raise ForwardModelError(self.kind, "no licence to be had\nserver busy")
        return Cantilever()(inputs, workdir)


class Noted:
    """Runs one after the other; notes what it runs, and each of its calls."""

    def __init__(self, executor=None):
        self.executor, self.made, self.calls = executor or InProcess(), [], []

    def __call__(self, model, requests):
        asked = list(requests)
        self.calls.append(stiffnesses(asked))
        for record in self.executor(model, asked):
            self.made.append(record.inputs["E"])
            yield record


class Waits:
    """Takes `NOT_NOW`; counts its calls."""

    asks_again = True

    def __init__(self):
        self.calls = 0

    def __call__(self, model, requests):
        self.calls += 1
        for request in requests:
            if request is not NOT_NOW:
                yield from InProcess()(model, [request])


class Elsewhere:
    """Makes runs that go on without a driver: here, in memory.

    Args:
        lost: how often the run at a stiffness ends ``killed`` before it ends well.
    """

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
            yield self.record(model, request)
            self.waiting.pop(request.key, None)

    def record(self, model, request):
        self.lost[request.inputs["E"]] -= 1
        if self.lost[request.inputs["E"]] >= 0:
            return RunRecord(request.key, request.inputs, "killed", failure_kind="node_failed", message="gone")
        (record,) = InProcess()(model, [request])
        return record


class ElsewhereWaits(Elsewhere):
    """The same for one request after the other, and with `NOT_NOW`."""

    asks_again = True

    def __call__(self, model, requests):
        for request in requests:
            if request is not NOT_NOW:
                yield from super().__call__(model, [request])
