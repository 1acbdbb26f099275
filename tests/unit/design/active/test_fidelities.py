"""Which runs both models make, and what the runs of the cheaper one are worth."""

import numpy as np

from strandline.design.active.fidelities import AGAIN, ENOUGH, REFUTED, TRIED, Fidelities, as_by_model
from strandline.interface import Interface
from strandline.models.fidelities import CHEAPER
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 21)
POINTS = np.random.default_rng(2).uniform(0.1, 0.5, (12, 2))
UNCONFIRMED = ("the correction of the cheaper model has not been confirmed",)


def run(at, *, cheaper=False, lacks=0.1, ok=True, slopes=False):
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


def runs(cheaper, model, **options):
    """Return runs of the cheaper model at some points and of the model at others."""
    return [run(at, cheaper=True, **options) for at in cheaper] + [run(at, **options) for at in model]


def first(**options):
    return runs(POINTS[:8], POINTS[:3], **options)


def learnt(records, tolerated=1e-3):
    used = Fidelities(("a", "b"), ("",), 0.3)
    used.tolerated = tolerated
    used.learn(records)
    return used


def tried(used, some, points, **model):
    """Try a correction at some points, and learn from the runs; return these points."""
    here = used.try_at(points)
    some += runs(here, []) + runs([], here, **model)
    used.learn(some)
    return here


def test_cheaper_runs_count_as_corrected_runs_of_the_model():
    """The key of a corrected run changes with the correction."""
    used = learnt(first(slopes=True))
    assert (used.lacking, used.by_both, used.dropped) == ([], 3, None)
    np.testing.assert_array_equal(used.points, POINTS[:8])
    for k, record in enumerate(used.records):
        right = run(POINTS[k], slopes=True)
        assert CHEAPER not in record.inputs
        np.testing.assert_allclose(record.interfaces[""].points, right.interfaces[""].points, atol=2e-3 * (k >= 3))
        np.testing.assert_allclose(record.sensitivities[""]["a"], right.sensitivities[""]["a"], atol=0.02)
    assert len({record.key for record in used.records}) == 8
    before = used.records[-1].key
    used.learn([*first(slopes=True), run(POINTS[4], slopes=True)])
    assert used.records[-1].key != before


def test_failed_runs_stay_failed_and_other_pairs_are_asked_for():
    some = first()
    some[1] = run(POINTS[1], cheaper=True, ok=False)
    used = learnt(some)
    assert used.correction is None
    assert used.lacking == [{"a": POINTS[3][0], "b": POINTS[3][1]}]
    used.learn([*some, run(POINTS[3])])
    assert used.lacking == []
    assert used.correction is not None
    assert used.records[1].ok  # the model itself succeeded there
    some[7] = run(POINTS[7], cheaper=True, ok=False)
    used.learn([*some, run(POINTS[3])])
    assert used.records[7].failure_kind == "diverged"
    assert CHEAPER not in used.records[7].inputs
    assert [CHEAPER in one for one in learnt(runs([], POINTS[:5])).lacking] == [True] * 3


def test_a_cheaper_model_that_explains_nothing_is_dropped():
    other = np.random.default_rng(7).uniform(0.1, 0.5, (12, 2))
    wrong = [RunRecord(f"wrong {k}", run(POINTS[k]).inputs, "ok", run(other[k]).interfaces) for k in range(5)]
    misled = [*runs(POINTS[:8], []), *wrong]
    used = learnt(misled[:-2])
    assert used.dropped is None
    assert len(used.lacking) == 2  # three pairs cannot tell
    used.learn(misled)
    assert "err by" in used.dropped
    np.testing.assert_array_equal(used.points, POINTS[:5])


def test_a_trial_confirms_the_correction_by_runs_that_it_has_not_learnt_from():
    used = learnt(first(), 2e-3)
    assert used.doubts() == UNCONFIRMED
    assert len(tried(used, first(), POINTS[8:])) == TRIED
    assert used.doubts() == ()
    report = used.report(0.02)
    assert 0 < report.error < 2e-3
    assert (report.cheaper, report.model, report.pairs) == (11, 6, 6)
    assert report.equivalents == 6 + 0.3 * 11
    assert "are accurate to" in report.statement


def test_once_confirmed_a_correction_is_tried_at_one_draw_of_a_later_posterior():
    used, some = learnt(first(), 9e-3), first()
    tried(used, some, POINTS[5:])
    assert used.report(0.02).pairs == 6
    assert len(tried(used, some, POINTS[8:], lacks=0.2)) == AGAIN < TRIED
    assert "wrong at a draw" in used.doubts()[0]
    assert len(used.try_at(POINTS[8:])) == TRIED


def test_a_correction_that_is_wrong_at_the_posterior_is_refuted_and_then_dropped():
    some = runs(POINTS[:8], POINTS[:8])
    used = learnt(some, 9e-3)
    for k, lacks in enumerate((0.2, 0.0, 0.3)[:REFUTED]):  # elsewhere it is .1
        tried(used, some, POINTS[8 + k : 9 + k], lacks=lacks)
        (reason,) = used.doubts()
        assert "wrong at a draw of the posterior" in reason
        assert ("misleads" in reason) == (used.dropped is not None) == (k == REFUTED - 1)
    assert used.report(0.01).error is None
    assert "is not used" in used.report(0.01).statement
    everywhere = learnt(first(), 1e-5)  # at once
    tried(everywhere, first(), POINTS[8:9])
    assert everywhere.dropped is not None
    assert everywhere.doubts() != ()
    everywhere.no_check()
    assert everywhere.doubts() == ()


def test_a_model_that_fails_where_the_cheaper_one_does_not_refutes_it_and_the_other_way_round_tells_nothing():
    used, other = learnt(first()), learnt(first())
    tried(used, first(), POINTS[8:9], ok=False)
    assert "the model fails where the cheaper one does not" in used.doubts()[0]
    assert not used.records[-1].ok
    here = other.try_at(POINTS[8:])
    other.learn([*first(), *runs(here, [], ok=False), *runs([], here)])
    assert (other.doubts(), other.report(0.01).error) == (UNCONFIRMED, None)


def test_a_pair_pays_if_the_correction_errs_more_than_the_field_for_its_cost():
    used = learnt(first())
    wrong = used.correction.error
    for tolerated, of_the_field, pays in ((3, 0.1, False), (1, 0.1, True), (1, 10, False)):
        used.tolerated = tolerated * wrong
        assert used.pays(of_the_field * wrong) == pays


def test_runs_of_one_model_stay_as_they_are():
    alone = runs([], POINTS[:4])
    assert as_by_model(alone, ("a", "b")) == tuple(alone)
    assert len(as_by_model(first(), ("a", "b"))) == 8
    assert len(as_by_model(first(), ("a", "b"), dropped=True)) == 3


def test_many_pairs_confirm_a_correction_without_a_trial():
    """Each is predicted from the others; they must be right within what is tolerated."""
    for tolerated, right in ((1.0, True), (1e-9, False)):
        assert (learnt(runs(POINTS, POINTS[:ENOUGH]), tolerated).doubts() == ()) == right
