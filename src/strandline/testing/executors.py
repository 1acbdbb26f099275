"""Conformance suite for executors: what any `strandline.runs.Executor` must do.

Each check takes an executor and the number of runs that it makes at a time. With pytest:

```python
@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS.keys())
def test_my_executor(check):
    check(MyExecutor(), workers=2)
```

`CRASH_CHECKS` are for executors that run simulators in separate processes, `TIMEOUT_CHECKS` for those that stop a run
after at most two seconds, `WAITING_CHECKS` for those with the attribute ``asks_again``.
"""

import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from strandline.models import fingerprint
from strandline.runs import NOT_NOW, Executor, RunRecord, RunRequest, run_key
from strandline.testing import checks_of
from strandline.testing.models import Cantilever, Faulty, Patient, Slow, TwoLoads

STIFFNESS = (300.0, 400.0, 450.0, 600.0, 350.0, 420.0)
"""Young's moduli of the usual requests, Pa; the models with a fault misbehave at the fourth."""
SICK = 600.0


ExecutorCheck = Callable[..., None]
"""One check of the suite, called with an executor and ``workers=``."""


def requests_for(model: Any, stiffness: Sequence[float] = STIFFNESS) -> list[RunRequest]:
    """Return requests for a `Cantilever`, or a wrapper around it, at these Young's moduli, Pa."""
    inputs = [{"E": float(value), "load": 1e-5} for value in stiffness]
    return [RunRequest(run_key(fingerprint(model), entry), entry) for entry in inputs]


def same_outcome(one: RunRecord, other: RunRecord) -> bool:
    """Return whether two records agree, the interface bit for bit; times and logs may differ."""
    return _facts(one) == _facts(other)


def check_answers_each_request_once(executor: Executor, *, workers: int) -> None:
    """Every request gets one record, with its own key and inputs."""
    requests = requests_for(Cantilever())
    records = list(executor(Cantilever(), iter(requests)))
    _require_one_each(requests, records)
    inputs = {request.key: dict(request.inputs) for request in requests}
    assert all(dict(r.inputs) == inputs[r.key] for r in records), "a record carries another run's inputs"


def check_accepts_no_requests(executor: Executor, *, workers: int) -> None:
    """Without requests there are no records."""
    assert list(executor(Cantilever(), iter([]))) == [], "records without requests"


def check_returns_the_models_result(executor: Executor, *, workers: int) -> None:
    """Interfaces and diagnostics come through bit for bit."""
    _require_the_models_result(executor, Cantilever())


def check_returns_all_conditions_and_sensitivities(executor: Executor, *, workers: int) -> None:
    """Several interfaces of a run, and their derivatives, come through bit for bit."""
    _require_the_models_result(executor, TwoLoads(sensitivities=True))


def _require_the_models_result(executor: Executor, model: Any) -> None:
    for record in executor(model, requests_for(model)):
        direct = model(record.inputs, Path())
        expected = RunRecord(record.key, record.inputs, "ok", direct.interfaces, direct.diagnostics)
        expected = replace(expected, sensitivities=direct.sensitivities)
        told = f"{record.state} {record.message or ''}, {dict(record.diagnostics)}"
        assert same_outcome(record, expected), f"{dict(record.inputs)}: not what the model returned: {told}"
        assert 0 <= record.seconds < math.inf, f"seconds = {record.seconds}"


def check_yields_in_order_of_completion(executor: Executor, *, workers: int) -> None:
    """A first run that ends last holds up the others only if there is one worker."""
    stiffness = [600.0, 400.0, 300.0, 350.0]
    with tempfile.TemporaryDirectory() as folder:
        model = Patient(folder, others=0 if workers == 1 else 3)
        order = []
        for record in executor(model, requests_for(model, stiffness)):
            order.append(record.inputs["E"])
            (Path(folder) / str(len(order))).touch()
    expected = stiffness if workers == 1 else [*stiffness[1:], stiffness[0]]
    alike = order == expected or (workers > 2 and order[-1] == stiffness[0])
    assert alike, f"records came in the order {order}, the runs ended in the order {expected}"


def check_pulls_when_a_worker_is_free(executor: Executor, *, workers: int) -> None:
    """A request is pulled when its run starts: there are never more open requests than workers."""
    requests = requests_for(Cantilever(), np.linspace(300.0, 500.0, 4 * workers + 4).tolist())
    pulled: list[RunRequest] = []
    records = executor(Slow(seconds=0.01), _noted(requests, pulled))
    assert not pulled, "requests were pulled before the first record was asked for"
    for answered, _ in enumerate(records, start=1):
        out = len(pulled) - answered
        assert out <= workers, f"{out} requests are out, with {workers} worker(s)"


def check_stops_when_closed(executor: Executor, *, workers: int) -> None:
    """Closing the iterator stops the pulling and does not wait for the rest."""
    requests = requests_for(Cantilever(), np.linspace(300.0, 500.0, 200).tolist())
    pulled: list[RunRequest] = []
    records = executor(Slow(seconds=0.1), _noted(requests, pulled))
    next(records)
    begin = time.monotonic()
    if hasattr(records, "close"):
        records.close()
    count = len(pulled)
    time.sleep(0.3)
    assert time.monotonic() - begin < 8.0, "closing took as long as the runs"
    assert len(pulled) == count <= workers + 1, f"{len(pulled)} requests were pulled though one record was requested"


def check_gives_each_run_an_empty_folder(executor: Executor, *, workers: int) -> None:
    """Files that one run leaves behind are not there in the next."""
    model = Faulty("dirty", above=0.0)
    states = [record.state for record in executor(model, requests_for(model))]
    assert states == ["ok"] * len(STIFFNESS), f"a run met a used folder: {states}"


def waiting_waits_for_what_follows(executor: Executor, *, workers: int) -> None:
    """A request that depends on the record before it is run; `NOT_NOW` is not a request."""
    requests = requests_for(Cantilever())
    records: list[RunRecord] = []

    def following() -> Iterator[RunRequest]:
        for number, request in enumerate(requests):
            yield from _not_now_until(lambda number=number: len(records) >= number)  # type: ignore[misc]
            yield request

    for record in executor(Cantilever(), following()):
        records.append(record)  # noqa: PERF402 (the requests look at them)
    _require_one_each(requests, records)


def waiting_hands_over_before_it_asks_again(executor: Executor, *, workers: int) -> None:
    """The only worker, which got `NOT_NOW` before, holds no record back when it pulls again."""
    if workers > 1:
        return
    requests = requests_for(Cantilever())
    records: list[RunRecord] = []
    early: list[bool] = []

    def following() -> Iterator[RunRequest]:
        for number, request in enumerate(requests, start=1):
            yield request
            yield NOT_NOW
            early.append(len(records) < number)
            yield from _not_now_until(lambda number=number: len(records) >= number)  # type: ignore[misc]

    for record in executor(Cantilever(), following()):
        records.append(record)  # noqa: PERF402 (the requests look at them)
    assert early == [False] * len(requests), "a request was pulled while the record that it depends on was held back"


def waiting_asks_beside_a_run(executor: Executor, *, workers: int, pause: float = 1.0, longest: float = 10.0) -> None:
    """A free worker asks again even if no run ends, and makes further runs while a long one goes on.

    After the first record there is nothing to start for `pause` seconds; the long run ends after `longest` in any case.
    """
    if workers == 1:
        return
    requests = requests_for(Cantilever(), [600.0, 400.0, 300.0])
    order: list[float] = []

    def following() -> Iterator[RunRequest]:
        yield from requests[:2]
        yield from _not_now_until(lambda: bool(order))
        later = time.monotonic() + pause
        yield from _not_now_until(lambda: time.monotonic() > later)
        yield requests[2]

    with tempfile.TemporaryDirectory() as folder:
        for record in executor(Patient(folder, others=1, longest=longest), following()):
            order.append(record.inputs["E"])
            if record.inputs["E"] == 300.0:
                (Path(folder) / "done").touch()
    assert order == [400.0, 300.0, 600.0], f"records came in the order {order}; the first run waits for the third"


def _not_now_until(condition: Callable[[], bool], *, seconds: float = 30.0) -> Iterator[RunRequest]:
    """Yield `NOT_NOW` once, then until `condition` holds or `seconds` have passed."""
    deadline = time.monotonic() + seconds
    yield NOT_NOW
    while not condition() and time.monotonic() < deadline:
        yield NOT_NOW


def _failure_check(fault: str, state: str, kind: str, *, told: str = "") -> ExecutorCheck:
    """Return a check that `fault` ends the run that it hits, and no other, in `state` and `kind`."""

    def check(executor: Executor, *, workers: int) -> None:
        model = Faulty(fault)
        requests = requests_for(model)
        records = list(executor(model, requests))
        _require_one_each(requests, records)
        for record in records:
            if record.inputs["E"] != SICK:
                assert record.ok, f"a healthy run ended {record.state}: {record.message}"
                continue
            ending = (record.state, record.failure_kind)
            assert ending == (state, kind), f"'{fault}' ended {ending}, expected {(state, kind)}"
            assert told in (record.message or ""), f"the message lacks '{told}': {record.message}"
            assert not record.interfaces, "a run that failed has an interface"

    check.__doc__ = f"The fault '{fault}' ends '{state}' ({kind}) and harms no other run."
    return check


CHECKS: dict[str, ExecutorCheck] = checks_of(globals()) | {
    "exception": _failure_check("exception", "failed", "exception", told="the matrix is singular"),
    "declared_failure": _failure_check("declared", "failed", "newton_stalled", told="half of the load"),
    "unpicklable_exception": _failure_check("unpicklable", "failed", "exception", told="payload that cannot travel"),
    "system_exit": _failure_check("leave", "failed", "exception", told="SystemExit"),
    "nan": _failure_check("nan", "invalid", "non_finite", told="not finite"),
    "nothing_returned": _failure_check("nothing", "invalid", "not_an_interface", told="NoneType"),
}
"""What every executor must do, by name."""

CRASH_CHECKS: dict[str, ExecutorCheck] = {
    "exit": _failure_check("exit", "killed", "worker_died", told="code 3"),
    "sigkill": _failure_check("kill", "killed", "worker_died", told="SIGKILL"),
    "segfault": _failure_check("segfault", "killed", "worker_died", told="SIGSEGV"),
    "huge_output": _failure_check("chatter", "failed", "exception", told="the last words"),
}
"""What an executor with processes of its own must survive and report."""

TIMEOUT_CHECKS: dict[str, ExecutorCheck] = {
    "hang": _failure_check("hang", "timeout", "timeout", told="waiting for nothing"),
    "hang_in_c": _failure_check("hang_in_c", "timeout", "timeout"),
    "hanging_child": _failure_check("child", "timeout", "timeout"),
}
"""What an executor with a timeout must stop."""

WAITING_CHECKS: dict[str, ExecutorCheck] = checks_of(globals(), "waiting_")
"""What an executor with ``asks_again`` must do with `NOT_NOW`."""


def _noted(requests: Sequence[RunRequest], pulled: list[RunRequest]) -> Iterator[RunRequest]:
    """Yield `requests`, noting each in `pulled` as it is taken."""
    for request in requests:
        pulled.append(request)
        yield request


def _facts(record: RunRecord) -> tuple[object, ...]:
    shapes = [(name, _bits(one.points), _bits(one.cells)) for name, one in record.interfaces.items()]
    slopes = [(name, [(of, _bits(one)) for of, one in by.items()]) for name, by in record.sensitivities.items()]
    figures = dict(record.diagnostics)
    return record.key, dict(record.inputs), record.state, shapes, slopes, figures, record.failure_kind


def _bits(values: Any) -> tuple[object, ...]:
    return np.asarray(values).dtype.kind, np.shape(values), np.asarray(values).tobytes()


def _require_one_each(requests: Sequence[RunRequest], records: Sequence[RunRecord]) -> None:
    asked, answered = Counter(r.key for r in requests), Counter(r.key for r in records)
    missing, surplus = asked - answered, answered - asked
    assert not missing, f"{missing.total()} request(s) without a record"
    assert not surplus, f"{surplus.total()} record(s) too many"
