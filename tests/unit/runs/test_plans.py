"""Plans in the ledger: what is noted comes back, and nothing is noted twice."""

from dataclasses import replace

from tests.unit.runs.ledgers import table

from strandline.runs import Ledger
from strandline.runs.overview import Overview
from strandline.runs.plans import Plan

DESIGN = ("a" * 64, "b" * 64, "c" * 64)
PLAN = Plan("digest", "béam", "m", ("tilt", "E"), False, 7, (DESIGN,))
FIRST = replace(PLAN, parts=(DESIGN, ("d", "e")))
BOTH = replace(PLAN, planned=6, parts=(DESIGN, ("d", "e"), ("f",)))
OTHER_ROUND = replace(PLAN, parts=(DESIGN, ("d", "x")))
OTHER_DESIGN = replace(PLAN, parts=(("z",),))
ENDED = replace(BOTH, planned=BOTH.planned - 1)


COURSES = [
    ([PLAN], PLAN, 1),
    ([FIRST], FIRST, 2),
    ([replace(BOTH, sensitivities=True)], replace(BOTH, sensitivities=True), 3),
    ([PLAN, PLAN], PLAN, 1),
    ([BOTH, BOTH], BOTH, 3),
    ([PLAN, FIRST], FIRST, 2),
    ([PLAN, FIRST, BOTH], BOTH, 3),
    ([BOTH, PLAN, FIRST], BOTH, 3),
    ([BOTH, OTHER_ROUND], OTHER_ROUND, 4),
    ([BOTH, OTHER_ROUND, BOTH], BOTH, 6),
    ([BOTH, OTHER_DESIGN], OTHER_DESIGN, 4),
    ([BOTH, ENDED], ENDED, 4),
]


def test_the_last_plan_counts_and_only_what_is_new_is_noted(path):
    """Rounds are added; those that are known stay while they are gone through again; another takes their place."""
    with Ledger.open(path, model="m") as ledger:
        for number, (plans, last, rows) in enumerate(COURSES):
            for plan in plans:
                ledger.plan(replace(plan, study_sha256=f"study {number}"))
            with Overview(path) as overview:
                assert overview.plan(f"study {number}") == replace(last, study_sha256=f"study {number}")
            assert table(path, f"SELECT count(*) FROM plans WHERE study_sha256 = 'study {number}'") == [(rows,)]


def test_studies_are_told_apart_and_a_run_in_two_parts_is_one_run(path):
    other = replace(PLAN, study_sha256="other", planned=1, parts=(("z",),))
    with Ledger.open(path, model="m") as ledger:
        ledger.plan(PLAN)
        ledger.plan(other)
    with Overview(path) as overview:
        assert [overview.plan(name) for name in ("digest", "other", "neither")] == [PLAN, other, None]
    assert replace(PLAN, parts=(("a", "b"), ("b", "c"))).keys == ["a", "b", "c"]
