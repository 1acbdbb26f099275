"""Which runs both models make, and what the runs of the cheaper one are worth."""

from typing import Any

import numpy as np
import pytest

from strandline.design.active.fidelities import AGAIN, ENOUGH, REFUTED, TRIED, Fidelities, as_by_model
from strandline.interface import Interface
from strandline.models.fidelities import CHEAPER
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 21)
POINTS = np.random.default_rng(2).uniform(0.1, 0.5, (12, 2))


def run(at: np.ndarray, *, cheaper: bool = False, lacks: float = 0.1, ok: bool = True, slopes: bool = False) -> Any:
    """Return a run of a bent strip; the cheaper model lacks a share of the first shape."""
    a, b = (float(value) for value in at)
    share = 1.0 if cheaper else 1 + lacks
    inputs = {"a": a, "b": b} | ({CHEAPER: 1.0} if cheaper else {})
    if not ok:
        return RunRecord(str(inputs), inputs, "failed", failure_kind="diverged")
    y = share * a * X**2 + b * np.sin(np.pi * X)
    by_input = {"a": share * X**2, "b": np.sin(np.pi * X)}
    of = {"": {name: np.stack([0 * X, one], axis=1) for name, one in by_input.items()}} if slopes else {}
    return RunRecord(str(inputs), inputs, "ok", {"": Interface.polyline(np.stack([X, y], axis=1))}, sensitivities=of)


def both(tolerated: float = 1e-3) -> Fidelities:
    used = Fidelities(("a", "b"), ("",), 0.3)
    used.tolerated = tolerated
    return used


def first(**options: Any) -> list[RunRecord]:
    """Return runs of the cheaper model at eight points and of the model at three of them."""
    return [run(at, cheaper=True, **options) for at in POINTS[:8]] + [run(at, **options) for at in POINTS[:3]]


def test_cheaper_runs_count_as_corrected_runs_of_the_model() -> None:
    """The key of a corrected run changes with the correction."""
    used = both()
    used.learn(first(slopes=True))
    assert used.lacking == []
    assert used.by_both == 3
    assert used.dropped is None
    np.testing.assert_array_equal(used.points, POINTS[:8])
    for k, record in enumerate(used.records):
        right = run(POINTS[k]).interfaces[""].points
        assert CHEAPER not in record.inputs
        np.testing.assert_allclose(record.interfaces[""].points, right, atol=2e-3 if k >= 3 else 0)
    assert len({record.key for record in used.records}) == 8
    found, right = used.records[5].sensitivities[""], run(POINTS[5], slopes=True).sensitivities[""]
    np.testing.assert_allclose(found["a"], right["a"], atol=0.02)
    assert np.abs(found["a"][:, 1] - X**2).max() > 0.08
    before = used.records[-1].key
    used.learn([*first(slopes=True), run(POINTS[4], slopes=True)])
    assert used.records[-1].key != before


def test_failed_runs_stay_failed_and_other_pairs_are_asked_for() -> None:
    used = both()
    runs = [run(at, cheaper=True, ok=k != 1) for k, at in enumerate(POINTS[:8])] + [run(at) for at in POINTS[:3]]
    used.learn(runs)
    assert used.correction is None
    assert used.lacking == [{"a": POINTS[3][0], "b": POINTS[3][1]}]
    used.learn([*runs, run(POINTS[3])])
    assert used.lacking == []
    assert used.correction is not None
    assert used.records[1].ok  # the model itself succeeded there
    used.learn([*runs[:7], run(POINTS[7], cheaper=True, ok=False), *runs[8:], run(POINTS[3])])
    assert used.records[7].failure_kind == "diverged"
    assert CHEAPER not in used.records[7].inputs
    alone = both()
    alone.learn([run(at) for at in POINTS[:5]])
    assert [CHEAPER in one for one in alone.lacking] == [True] * 3


def test_a_cheaper_model_that_explains_nothing_is_dropped() -> None:
    used, other = both(), np.random.default_rng(7).uniform(0.1, 0.5, (12, 2))
    misled = [run(at, cheaper=True) for at in POINTS[:8]]
    used.learn([*misled, *(run(at) for at in POINTS[:3])])
    assert used.lacking == []
    for k in range(5):
        wrong = run(other[k])
        misled.append(RunRecord(f"wrong {k}", run(POINTS[k]).inputs, "ok", wrong.interfaces))
    used.learn(misled[:-2])
    assert used.dropped is None
    assert len(used.lacking) == 2  # three pairs cannot tell
    used.learn(misled)
    assert used.dropped is not None
    assert "err by" in used.dropped
    np.testing.assert_array_equal(used.points, POINTS[:5])


def test_a_trial_confirms_the_correction_by_runs_that_it_has_not_learnt_from() -> None:
    used = both(2e-3)
    used.learn(first())
    assert used.doubts() == ("the correction of the cheaper model has not been confirmed",)
    tried = used.try_at(POINTS[8:])
    assert len(tried) == TRIED
    more = [run(at, cheaper=True) for at in tried] + [run(at) for at in tried]
    used.learn([*first(), *more])
    assert used.doubts() == ()
    report = used.report(0.02)
    assert report.error is not None
    assert 0 < report.error < 2e-3
    assert (report.cheaper, report.model, report.pairs) == (11, 6, 6)
    assert report.equivalents == pytest.approx(6 + 0.3 * 11)
    assert "are accurate to" in report.statement


def test_once_confirmed_a_correction_is_tried_at_one_draw_of_a_later_posterior() -> None:
    used, runs = both(9e-3), first()
    used.learn(runs)
    runs += [one for at in used.try_at(POINTS[5:]) for one in (run(at, cheaper=True), run(at))]
    used.learn(runs)
    before = used.report(0.02)
    tried = used.try_at(POINTS[8:])
    assert len(tried) == AGAIN < TRIED
    used.learn([*runs, *(run(at, cheaper=True) for at in tried), *(run(at, lacks=0.2) for at in tried)])
    assert "wrong at a draw" in used.doubts()[0]
    assert len(used.try_at(POINTS[8:])) == TRIED
    assert before.pairs == 6


def test_a_correction_that_is_wrong_at_the_posterior_is_refuted_and_then_dropped() -> None:
    used, runs = both(9e-3), first() + [run(at) for at in POINTS[3:8]]
    for k in range(REFUTED):
        used.learn(runs)
        tried, lacks = used.try_at(POINTS[8 + k : 9 + k]), (0.2, 0.0, 0.3)[k]  # elsewhere it is .1
        runs += [run(at, cheaper=True) for at in tried] + [run(at, lacks=lacks) for at in tried]
        used.learn(runs)
        (reason,) = used.doubts()
        assert ("misleads" in reason) == (k == REFUTED - 1)
        assert "wrong at a draw of the posterior" in reason
        assert (used.dropped is not None) == (k == REFUTED - 1)
    assert used.report(0.01).error is None
    assert "is not used" in used.report(0.01).statement


def test_a_correction_that_is_wrong_everywhere_is_dropped_at_once() -> None:
    used = both(1e-5)
    used.learn(first())
    (at,) = used.try_at(POINTS[8:9])
    used.learn([*first(), run(at, cheaper=True), run(at)])
    assert used.dropped is not None
    assert used.doubts() != ()
    used.no_check()
    assert used.doubts() == ()


def test_a_model_that_fails_where_the_cheaper_one_does_not_refutes_it_and_the_other_way_round_tells_nothing() -> None:
    used, other = both(), both()
    for one in (used, other):
        one.learn(first())
    (at,) = used.try_at(POINTS[8:9])
    used.learn([*first(), run(at, cheaper=True), run(at, ok=False)])
    assert "the model fails where the cheaper one does not" in used.doubts()[0]
    assert not used.records[-1].ok
    tried = other.try_at(POINTS[8:])
    other.learn([*first(), *(run(at, cheaper=True, ok=False) for at in tried), *(run(at) for at in tried)])
    assert other.doubts() == ("the correction of the cheaper model has not been confirmed",)
    assert other.report(0.01).error is None


def test_a_pair_pays_if_the_correction_errs_more_than_the_field_for_its_cost() -> None:
    used = both()
    used.learn(first())
    assert used.correction is not None
    wrong = used.correction.error
    used.tolerated = 3 * wrong
    assert not used.pays(0.1 * wrong)  # good enough
    used.tolerated = wrong
    assert used.pays(0.1 * wrong)
    assert not used.pays(10 * wrong)  # the field errs more


def test_runs_of_one_model_stay_as_they_are() -> None:
    runs = [run(at) for at in POINTS[:4]]
    assert as_by_model(runs, ("a", "b")) == tuple(runs)
    assert len(as_by_model(first(), ("a", "b"))) == 8
    assert len(as_by_model(first(), ("a", "b"), dropped=True)) == 3
    assert len(as_by_model(first()[:-1], ("a", "b"))) == 2  # too few pairs for a correction


def test_many_pairs_confirm_a_correction_without_a_trial() -> None:
    """Each is predicted from the others; they must be right within what is tolerated."""
    runs = [run(at, cheaper=True) for at in POINTS] + [run(at) for at in POINTS[:ENOUGH]]
    used = both(1.0)
    used.learn(runs)
    assert used.doubts() == ()
    strict = both(1e-9)
    strict.learn(runs)
    assert strict.doubts() != ()
