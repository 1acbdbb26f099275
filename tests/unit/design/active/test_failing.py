"""Runs that would be lost where runs are known to fail."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active.fakes import MEAN, SPACE, Assumed, even, inputs_of, known, normal, own, record, state_of

from strandline.design.active import Active, ActiveDesign, State
from strandline.design.active.choice import choose
from strandline.design.active.elsewhere import points_elsewhere
from strandline.design.active.failing import MOST, SAFE, UNLIKELY, Losses, safe_candidates

RUNS, SD = 60, 0.15
FIRST, X = even(12), even(60)
REGIONS = {
    "disc over the truth": lambda x: np.linalg.norm(x - MEAN) < 0.5,
    "half of the box, with the truth": lambda x: x[0] > 0.0,
    "curved border, truth beyond": lambda x: x[1] > -0.4 * np.sin(3 * x[0]),
}


@dataclass(frozen=True, eq=False)
class Wary(Assumed):
    """A normal likelihood, times the probability that a run succeeds."""

    def plug_in(self, x):
        return super().plug_in(x) + self.log_feasibility(x)


def learn(x, records):
    """Return the posterior that these runs teach, on an even set of points."""
    knowledge = Wary(**own(known(x, np.array([one.ok for one in records]))), sd=SD)
    points = even(1000, 6)
    value = knowledge.plug_in(points)
    whole, half = log_softmax(value), log_softmax(0.5 * value)
    return State(knowledge, points, whole, half, whole, value, value, float(np.log(np.mean(np.exp(0.5 * value)))))


def lost_in(fails):
    """Run a design to its end; return it, the number of its runs, and how many failed besides the first ones."""
    options = {"learn": learn, "log_likelihood": lambda one: float(normal(inputs_of(one), sd=SD)), "seed": 1}
    one = ActiveDesign(Active(RUNS, unseen=1.0), SPACE, batch=4, scramble=1, **options)
    one.start(FIRST)
    x = FIRST
    while (batch := one.next(x, [record(row, ok=not fails(row)) for row in x])) is not None:
        x = np.concatenate([x, batch.points])
    return one, len(x), sum(fails(row) for row in x[len(FIRST) :])


@pytest.mark.parametrize(
    "region", [name if k == 0 else pytest.param(name, marks=pytest.mark.long) for k, name in enumerate(REGIONS)]
)
def test_no_more_than_a_tenth_of_the_runs_is_lost(region):
    """The observation is best explained by inputs that fail."""
    one, runs, lost = lost_in(REGIONS[region])
    assert not one.converged
    assert runs == RUNS
    assert 1 <= lost <= MOST * RUNS + 2
    assert any("of the posterior lies where runs are likely to fail" in reason for reason in one.reasons)


@pytest.fixture
def unlimited(monkeypatch):
    """The planted bug: every batch and every check may be made."""

    def planted():
        monkeypatch.setattr(Losses, "bears", lambda self, x: True)
        monkeypatch.setattr(Losses, "bears_check", lambda self, state, draws: True)

    return planted


def test_without_that_limit_far_more_are_lost(unlimited):
    unlimited()
    assert lost_in(REGIONS["disc over the truth"])[2] > 3 * MOST * RUNS


def test_a_region_that_fails_elsewhere_changes_nothing(unlimited):
    here, _, _ = lost_in(lambda x: x[0] < -0.5)
    unlimited()
    free, _, _ = lost_in(lambda x: x[0] < -0.5)
    assert here.converged
    for one, other in zip(here.batches, free.batches, strict=True):
        np.testing.assert_array_equal(one.points, other.points)


def test_failures_at_random_are_no_losses():
    losses = Losses(known(X, np.random.default_rng(3).random(60) > 0.2), RUNS, frozenset())
    assert losses.lost == 0
    assert losses.bears(X)


@pytest.fixture(scope="module")
def losses():
    """A quarter of the box fails; more runs than may be are lost there."""
    return Losses(known(X, X[:, 0] < 0.5), RUNS, frozenset())


def test_the_first_runs_are_not_lost(losses):
    failed = ~losses.knowledge.ok & (losses.chance(X) < UNLIKELY)
    assert losses.lost == failed.sum() > 10
    assert losses.left == MOST * RUNS - losses.lost < 0
    first = frozenset(row.tobytes() for row in X[:30])
    assert Losses(losses.knowledge, RUNS, first).lost == failed[30:].sum() > 5


def test_runs_at_safe_points_are_always_borne(losses):
    safe, gone = np.array([[-0.5, 0.0]]), np.array([[0.9, 0.0]])
    assert losses.chance(safe)[0] > SAFE
    assert losses.chance(gone)[0] < UNLIKELY
    assert losses.bears(safe)
    assert not losses.bears(np.concatenate([safe, gone]))
    assert Losses(losses.knowledge, 1000, frozenset()).bears(gone)
    np.testing.assert_array_equal(losses.bearable(np.concatenate([gone, safe])), safe)


def test_a_posterior_where_runs_fail_is_not_checked(losses):
    inside, outside = (state_of(losses.knowledge, mean=mean, sd=0.1) for mean in [(0.9, 0.0), (-0.4, 0.0)])
    assert not losses.bears_check(inside, 9)
    assert losses.bears_check(outside, 9)
    assert Losses(losses.knowledge, 1000, frozenset()).bears_check(inside, 9)
    assert losses.words(outside) == ()
    assert losses.words(inside)[0].endswith(f"{losses.lost} runs were lost there")


def test_safe_runs_are_chosen(losses):
    """Where hardly a particle is safe, points of the box take their place."""
    state, options = state_of(losses.knowledge, mean=(0.9, 0.0), sd=0.1), {"explore": 0.25, "first": 60, "seed": 2}
    assert (losses.chance(state.positions) >= SAFE).mean() < 0.05
    for criterion in ("expected_variance", "repulsion"):
        options["criterion"] = criterion
        anywhere, chosen = (choose(state, SPACE, 12, losses=one, **options) for one in (None, losses))
        assert (losses.chance(anywhere) < UNLIKELY).any()
        assert (losses.chance(chosen) >= SAFE).all()
        assert len(np.unique(chosen, axis=0)) == 12
    state = state_of(losses.knowledge, mean=(0.2, 0.0), sd=0.3)
    found = safe_candidates(losses, state, state.positions, SPACE, 1)
    np.testing.assert_array_equal(found, state.positions[losses.chance(state.positions) >= SAFE])


def test_nobody_looks_where_runs_fail(losses):
    anywhere, likely = (points_elsewhere(X[:8], SPACE, 0.05, 50, allowed) for allowed in (None, losses.likely))
    assert (losses.chance(anywhere) < UNLIKELY).any()
    assert (losses.chance(likely) >= UNLIKELY).all()
    assert 0 < len(likely) < len(anywhere)
    assert len(points_elsewhere(X[:8], SPACE, 0.05, 50, lambda x: np.zeros(len(x), bool))) == 0
