"""A design as a campaign of runs: what it asks for, what it allows, what it tells, and what choosing will cost."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.design.active import fakes
from tests.unit.design.active.fakes import MEAN, SPACE, FakeLearner, even, honest, kinds, record

import strandline as sl
from strandline.design.active import Active, ActiveDesign, ActiveRuns, Batch
from strandline.design.active import campaign as module
from strandline.design.active.active_design import Step
from strandline.design.active.campaign import BatchReport, Certificate, report_batch
from strandline.design.active.fidelities import Fidelities
from strandline.design.active.state import PosteriorMove
from strandline.design.run_filter import RunFilter
from strandline.foundations import InvalidInput, TooFewRuns
from strandline.models.fidelities import by_cheaper
from strandline.runs import FailurePolicy

FIRST = even(12)


def named(x):
    return [dict(SPACE.as_mapping(row)) for row in x]


def records(x):
    return [record(row) for row in x]


def campaign(monkeypatch, learner=None, first=FIRST):
    learner = learner or FakeLearner()
    monkeypatch.setattr(module, "learn", lambda x, records, *others, **options: (x, records))
    monkeypatch.setattr(module, "posterior_state", lambda given, *others, **options: learner(*given))
    seen, measure = (sl.Observation(fakes.interface(MEAN), 0.01),), sl.TrackedPoints()
    judge = RunFilter(seen, {"tracked_points": measure}, FailurePolicy())
    runs = ActiveRuns(Active(60), SPACE, measure, 4, 1, None, judge, aside=nullcontext, inputs=named)
    runs.design.check = fakes.Trusting(runs.active, SPACE, batch=4, log_likelihood=honest, seed=1)
    runs.design.afresh = lambda state: state
    runs.design.start(first)
    return runs


def test_too_few_successes_ask_for_more_of_the_sequence(monkeypatch):
    learner = FakeLearner(fewest=6)
    runs = campaign(monkeypatch, learner, even(5))
    assert runs(records(runs.asked)) == named(even(10)[6:])
    assert len(runs(records(runs.asked))) == 4
    assert kinds(runs.certificate.batches) == ["initial", "initial", "posterior"]
    learner.fewest = 1000
    while len(runs.asked) < 60:
        assert runs(records(runs.asked))
    assert len(runs.asked) == 60
    with pytest.raises(TooFewRuns):
        runs(records(runs.asked))


def test_a_campaign_ends_with_no_points(monkeypatch):
    runs = campaign(monkeypatch)
    while batch := runs(records(runs.asked)):
        assert batch == named(runs.asked)[-len(batch) :]
    assert runs.certificate.converged


def test_a_check_takes_the_noise_that_was_inferred(monkeypatch):
    """Before anything is learnt, and if the noise is known, the stated one."""
    runs, one = campaign(monkeypatch), record(MEAN + 0.3)
    stated = runs.judge.value(runs.judge.first, one)
    assert runs._true(one) == pytest.approx(stated)
    inferred = SimpleNamespace(likelihood=SimpleNamespace(one=lambda interfaces: stated - 1.0))
    for of, expected in [(None, stated), (inferred, stated - 1.0)]:
        runs.design.state = SimpleNamespace(knowledge=SimpleNamespace(likelihood=SimpleNamespace(inferred=of)))
        assert runs._true(one) == pytest.approx(expected)


def test_runs_of_a_dropped_cheaper_model_have_not_looked(monkeypatch):
    """The planted bug counts all runs that were asked for."""
    runs = campaign(monkeypatch, first=even(64))
    runs.fidelities = Fidelities(SPACE.names, [""], 0.1)
    both = records(even(64))
    runs.fidelities.drop("for a test")
    runs.fidelities.learn([*both[:4], *(replace(one, inputs=by_cheaper(one.inputs)) for one in both[4:])])
    assert runs.certificate.found > 0.2
    monkeypatch.setattr(ActiveRuns, "_looked", ActiveRuns.asked)
    assert runs.certificate.found < 0.1


def test_a_cheaper_model_makes_the_runs_until_it_is_dropped_for_want_of_a_correction(monkeypatch):
    runs, batch = campaign(monkeypatch), Batch(FIRST[:4], "initial")
    assert runs._runs(batch) == named(FIRST[:4])
    runs.fidelities = Fidelities(SPACE.names, [""], 0.1)
    assert runs._runs(batch) == [by_cheaper(entry) for entry in named(FIRST[:4])]
    runs._use(runs.fidelities)
    assert runs.fidelities.dropped == "there are too few inputs at which both models succeed"
    assert runs._runs(batch) == named(FIRST[:4])
    runs.fidelities, both = Fidelities(SPACE.names, [""], 0.1), records(even(8))
    runs.fidelities.learn([*(replace(one, inputs=by_cheaper(one.inputs)) for one in both), *both])
    assert runs.fidelities.correction is not None
    runs._use(runs.fidelities)
    assert runs.fidelities.dropped is None


def test_settings_have_ranges():
    """A batch may take all runs after the first, which are at least three."""
    wrong = {"check": 19, "initial": 2, "batch": 0, "explore": 0.6, "criterion": "entropy"}
    wrong |= {"effective": 1.0, "change": 0.0, "patience": 0.5, "runs": 8}
    for name, value in wrong.items():
        with pytest.raises(InvalidInput, match=f"^{name}"):
            Active(**{"runs": 100, name: value})
    assert (Active(30, batch=27).batch, Active(30, initial=5, batch=25).batch) == (27, 25)
    with pytest.raises(InvalidInput, match="at most 27, the runs that are left of 30 after the first 3"):
        Active(30, batch=28)
    with pytest.raises(InvalidInput, match=r"^runs: got 5; expected at least 14"):
        Active(5, initial=8, batch=4)


def test_a_certificate_says_what_may_have_been_missed():
    made = (Certificate(False, ("no runs are left",), (), (), None, found) for found in (1.0, 0.07, None))
    few, many, blind = made
    assert few.statement == "The runs are too few to say whether another region fits."
    assert "compact region that fits, if it holds 7% or more of the prior's mass" in many.statement
    assert blind.statement == "With so many inputs, the runs cannot tell whether another region fits."


@pytest.mark.stand_in
def test_the_line_after_each_batch():
    E = sl.Parameter("E", sl.Uniform(0.0, 800.0), "Pa")
    space = sl.ParameterSpace((E, sl.Parameter("nu", sl.Uniform(-1, 0.5), symbol="ν")))
    little, far = PosteriorMove(0.049, 0.01, 0.99), PosteriorMove(9.0, 0.01, 0.01)
    for kinds_of, steps, moved, converged, line in [
        ("initial posterior posterior check", 3, little, False, "moved 0.05 sd; next: check"),
        ("initial posterior", 1, far, False, "moved too far to say by how much; next: a batch"),
        ("initial check", 2, little, True, "next: done, converged"),
        ("initial check", 2, little, False, "next: stop, not converged"),
    ]:
        made = ActiveDesign(Active(runs=50), space, batch=4, learn=None, log_likelihood=None, seed=1)
        made.batches = [Batch(np.zeros((4, 2)), kind) for kind in kinds_of.split()]
        made.converged = converged
        made.reasons = () if converged or steps < len(made.batches) else ("all runs are made",)
        mean, sd = np.array([396.24, 0.2741]), np.array([31.2, 0.114])
        made.steps = [Step(8, 8, "posterior", mean, sd, 1e-3, moved, None, None)] * steps
        report = report_batch(made, space)
        assert report.line.startswith(f"batch {steps}: E 396 ± 31, ν 0.27 ± 0.11")
        assert report.line.endswith(line)
    report = BatchReport(2, ("a 1 ± 1",) * 5, 0.1, "batch", "why", "it errs")
    assert report.line.startswith("batch 2: a 1 ± 1, a 1 ± 1, a 1 ± 1, …, moved 0.10 sd")
    assert report.line.endswith("; check: why; the cheaper model is no longer used: it errs; next: a batch")
