"""Plans in the ledger: what is noted comes back, and nothing is noted twice."""

from dataclasses import replace

import pytest

from strandline.errors import LedgerError
from strandline.runs import Ledger
from strandline.runs.overview import Overview
from strandline.runs.plans import Plan

DESIGN = ("a" * 64, "b" * 64, "c" * 64)
PLAN = Plan("digest", "béam", "m", ("tilt", "E"), False, 7, (DESIGN,))
FIRST = replace(PLAN, parts=(DESIGN, ("d", "e")))
BOTH = replace(PLAN, planned=6, parts=(DESIGN, ("d", "e"), ("f",)))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def noted(path, *plans):
    """Note the plans, each by a driver of its own; return what is then read of the last, and the number of rows."""
    for plan in plans:
        with Ledger.open(path, model="m") as ledger:
            ledger.plan(plan)
            (rows,) = ledger._rows("SELECT count(*) FROM plans")[0]
    with Overview(path) as ledger:
        return ledger.plan(plans[-1].study_sha256), rows


@pytest.mark.parametrize("plan", [PLAN, FIRST, BOTH, replace(BOTH, sensitivities=True)])
def test_what_is_noted_comes_back(path, plan):
    assert noted(path, plan) == (plan, len(plan.parts))


def test_nothing_is_noted_twice(path):
    assert noted(path, PLAN, PLAN) == (PLAN, 1)
    assert noted(path, BOTH, BOTH) == (BOTH, 3)


def test_rounds_are_added(path):
    assert noted(path, PLAN, FIRST) == (FIRST, 2)
    assert noted(path, BOTH) == (BOTH, 3)


def test_rounds_that_are_known_stay_while_they_are_gone_through_again(path):
    assert noted(path, BOTH, PLAN, FIRST) == (BOTH, 3)


def test_another_round_takes_the_place_of_those_behind_it(path):
    other = replace(PLAN, parts=(DESIGN, ("d", "x")))
    assert noted(path, BOTH, other) == (other, 4)
    assert noted(path, BOTH) == (BOTH, 6)


def test_an_active_design_that_has_ended_plans_what_it_made(path):
    ended = replace(BOTH, planned=BOTH.planned - 1)
    assert noted(path, BOTH, ended)[0] == ended


def test_another_design_under_the_same_text_is_a_new_plan(path):
    other = replace(PLAN, parts=(("z",),))
    assert noted(path, BOTH, other) == (other, 4)


def test_studies_are_told_apart(path):
    other = replace(PLAN, study_sha256="other", planned=1, parts=(("z",),))
    noted(path, PLAN, other)
    with Overview(path) as ledger:
        assert ledger.plan("digest") == PLAN
        assert ledger.plan("other") == other
        assert ledger.plan("neither") is None


def test_a_run_in_two_parts_is_one_run():
    assert replace(PLAN, parts=(("a", "b"), ("b", "c"))).keys == ["a", "b", "c"]


def test_a_reader_notes_nothing(path):
    Ledger.open(path, model="m").close()
    with Ledger.open(path, model="m", read_only=True) as ledger, pytest.raises(LedgerError, match="read_only"):
        ledger.plan(PLAN)
