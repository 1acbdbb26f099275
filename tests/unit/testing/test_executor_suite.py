"""The conformance suite of executors: the one in this process conforms, and broken ones are caught."""

import pytest

from strandline.runs import NOT_NOW, InProcess, RunRecord
from strandline.testing.executors import CHECKS, WAITING_CHECKS

RUN = InProcess()


def test_the_executor_in_this_process_conforms():
    for check in CHECKS.values():
        check(RUN, workers=1)


def eager(model, requests):
    yield from RUN(model, list(requests))


def forgetting(model, requests):
    yield from list(RUN(model, requests))[:-1]


def repeating(model, requests):
    for record in RUN(model, requests):
        yield record
        yield record


def reversing(model, requests):
    yield from reversed(list(RUN(model, requests)))


def blaming(model, requests):
    records = list(RUN(model, requests))
    bad = not all(record.ok for record in records)
    yield from (RunRecord(r.key, r.inputs, "killed") if bad else r for r in records)


def rounding(model, requests):
    for record in RUN(model, requests):
        if record.ok:
            record.interface.points[:] = record.interface.points.round(9)
        yield record


def littering(model, requests):
    return RUN(lambda inputs, workdir: model(inputs, workdir.parent), requests)


def leaving(model, requests):
    for request in requests:
        if request is NOT_NOW:
            return
        yield from RUN(model, [request])


def hoarding(model, requests):
    kept = []
    for request in requests:
        if request is not NOT_NOW:
            kept += RUN(model, [request])
        elif kept and next(requests) is NOT_NOW:
            yield kept.pop()


@pytest.mark.parametrize(
    ("broken", "caught_by"),
    [
        (eager, "pulls_when_a_worker_is_free"),
        (forgetting, "answers_each_request_once"),
        (repeating, "answers_each_request_once"),
        (reversing, "yields_in_order_of_completion"),
        (blaming, "nan"),
        (rounding, "returns_the_models_result"),
        (littering, "gives_each_run_an_empty_folder"),
        (eager, "stops_when_closed"),
        (leaving, "waits_for_what_follows"),
        (RUN, "waits_for_what_follows"),
        (hoarding, "hands_over_before_it_asks_again"),
    ],
)
def test_the_suite_catches_a_broken_executor(broken, caught_by):
    with pytest.raises(AssertionError):
        (CHECKS | WAITING_CHECKS)[caught_by](broken, workers=1)
