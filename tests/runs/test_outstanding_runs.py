"""Runs that go on without a driver: the campaign neither starts them again nor calls them interrupted."""

import pytest

from strandline.models.protocol import fingerprint
from strandline.runs import Counts, InProcess, Ledger, RunRecord, run_campaign
from strandline.testing.models import Cantilever


class Elsewhere:
    """An executor whose runs are made elsewhere, whether or not a driver waits: here, in memory.

    Args:
        lost: how often each run ends ``killed`` before it ends well.
    """

    def __init__(self, *, lost=0):
        self.submitted, self.waiting, self.lost = [], {}, lost

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
            del self.waiting[request.key]

    def record(self, model, request):
        if self.submitted.count(request.inputs["E"]) <= self.lost:
            return RunRecord(request.key, request.inputs, "killed", failure_kind="node_failed", message="gone")
        (record,) = InProcess()(model, [request])
        return record


class NoHook:
    """The same without saying what is out: the planted bug."""

    def __init__(self, executor):
        self.executor = executor

    def __call__(self, model, requests):
        self.executor.waiting.clear()
        return self.executor(model, requests)


def design(*stiffness):
    return [{"E": float(value), "load": 1e-5} for value in stiffness]


def campaign(path, executor, inputs, *, stop_after=None, **options):
    seen = []

    def note(record, progress):
        seen.append(record.state)
        if len(seen) == stop_after:
            raise KeyboardInterrupt

    with Ledger.open(path, model=fingerprint(Cantilever())) as ledger:
        return run_campaign(Cantilever(), inputs, ledger=ledger, executor=executor, on_record=note, **options)


def counts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts()


def attempts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return sorted(ledger.attempts(record.key) for record in ledger)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def test_an_interrupted_driver_leaves_them_open_and_the_next_one_collects(path):
    executor, inputs = Elsewhere(), design(300, 400, 500, 600)
    for made in (1, 2, 3):
        with pytest.raises(KeyboardInterrupt):
            campaign(path, executor, inputs, stop_after=1, maximum_attempts=1)
        assert counts(path) == Counts(ok=made, open=4 - made)
    done = campaign(path, executor, inputs, maximum_attempts=1)
    assert all(record.ok for record in done)
    assert executor.submitted == [300.0, 400.0, 500.0, 600.0]
    assert attempts(path) == [1, 1, 1, 1]


def test_one_that_was_killed_elsewhere_is_submitted_again_and_each_time_counts(path):
    executor = Elsewhere(lost=2)
    (record,) = campaign(path, executor, design(300))
    assert record.ok
    assert executor.submitted == [300.0] * 3
    assert attempts(path) == [3]
    (given_up,) = campaign(path, Elsewhere(lost=3), design(400))
    assert (given_up.state, given_up.failure_kind) == ("killed", "node_failed")


def test_without_the_hook_runs_would_be_repeated(path):
    executor, inputs = Elsewhere(), design(300, 400)
    with pytest.raises(KeyboardInterrupt):
        campaign(path, NoHook(executor), inputs, stop_after=1)
    assert counts(path) == Counts(ok=1, killed=1)
    campaign(path, NoHook(executor), inputs)
    assert executor.submitted == [300.0, 400.0, 400.0]


def test_what_the_executor_does_not_know_any_more_is_started_again(path):
    executor, inputs = Elsewhere(), design(300, 400)
    with pytest.raises(KeyboardInterrupt):
        campaign(path, executor, inputs, stop_after=1)
    executor.waiting.clear()
    assert all(record.ok for record in campaign(path, executor, inputs))
    assert attempts(path) == [1, 2]


def test_open_runs_are_those_whose_last_start_has_no_outcome(path):
    executor, inputs = Elsewhere(), design(300, 400)
    with pytest.raises(KeyboardInterrupt):
        campaign(path, executor, inputs, stop_after=1)
    with Ledger.open(path, model=None, read_only=True) as ledger:
        (done,) = list(ledger)
        (waiting,) = executor.waiting.keys() - {done.key}
        assert ledger.open_runs([done.key, waiting, "unknown"]) == {waiting}
        assert ledger.open_runs([done.key]) == frozenset()
