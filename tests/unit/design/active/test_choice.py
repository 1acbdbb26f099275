"""Which runs are chosen, against brute force, and which would be lost where runs are known to fail."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active.fakes import MEAN, SPACE, Assumed, even, inputs_of, known, normal, own, record, state_of

import strandline as sl
from strandline.design.active import CRITERIA, Active, ActiveDesign, State
from strandline.design.active.choice import (
    MOST,
    SAFE,
    UNLIKELY,
    Losses,
    _accepted,
    choose,
    price_of_a_hang,
    safe_candidates,
)
from strandline.design.active.coverage_runs import points_elsewhere
from strandline.surrogate.field.mode_process import ModeData, ModeProcess, condition_mode

RUNS = even(10)
RNG = np.random.default_rng(1)
CANDIDATES, UNKNOWN, TARGETS = RNG.uniform(-1, 1, (12, 2)), RNG.uniform(-1, 1, (5, 2)), RNG.uniform(-0.5, 0.5, (15, 2))


@pytest.fixture(scope="module")
def state():
    return state_of(known(RUNS))


def with_run(process, z):
    """Return the process with a value at z too; what it is makes no difference to the variance at a given scale."""
    seen = process.observed
    more = ModeData(np.append(seen.z, z[None], axis=0), np.append(seen.values, 0.0), None, seen.linear)
    found = ModeProcess(more, process.lengths, process.nugget, condition_mode(more, process.lengths, process.nugget))
    return replace(found, widening=process.scale / found.factors.variance)


def test_the_largest_reduction_of_the_variance_is_picked_and_where_least_is_known_by_a_run_that_explores(state):
    surrogate = state.knowledge.surrogate
    z, targets = (surrogate.warping.standardise(x) for x in (CANDIDATES, TARGETS))
    processes = list(surrogate.processes[:6])
    pick = CRITERIA["expected_variance"](state, CANDIDATES, UNKNOWN, TARGETS)
    for _ in range(3):
        remaining = [sum(with_run(p, row).variance(targets).sum() for p in processes) for row in z]
        best = int(np.argmin(remaining))
        assert max(remaining) > 1.2 * remaining[best]
        np.testing.assert_array_equal(pick(False), CANDIDATES[best])
        processes = [with_run(p, z[best]) for p in processes]
    variance = surrogate.predict(UNKNOWN).variance[:, :6].sum(axis=1)
    pick = CRITERIA["expected_variance"](state, CANDIDATES, UNKNOWN, TARGETS)
    np.testing.assert_array_equal(pick(True), UNKNOWN[np.argmax(variance)])


def test_runs_that_fail_are_avoided():
    ok = RUNS[:, 0] < 0.3
    free, wary = state_of(known(RUNS)), state_of(known(RUNS, ok))
    wary = replace(wary, knowledge=replace(free.knowledge, feasibility=wary.knowledge.feasibility, highest=0.0))
    chosen = [choose(s, SPACE, 16, explore=0.25, first=10, criterion="expected_variance", seed=3) for s in (free, wary)]
    assert (chosen[1][:, 0] > 0.5).sum() < (chosen[0][:, 0] > 0.5).sum()


def test_repulsion_picks_what_is_farthest_from_all_runs(state):
    standardise = state.knowledge.surrogate.warping.standardise
    spread = standardise(TARGETS).std(axis=0)
    known_runs = [*(standardise(RUNS) / spread)]
    pick = CRITERIA["repulsion"](state, CANDIDATES, UNKNOWN, TARGETS)
    for exploring in (False, False, True, False):
        pool = UNKNOWN if exploring else CANDIDATES
        distances = [min(np.linalg.norm(z - one) for one in known_runs) for z in standardise(pool) / spread]
        best = int(np.argmax(distances))
        np.testing.assert_array_equal(pick(exploring), pool[best])
        known_runs.append((standardise(pool) / spread)[best])


@pytest.mark.parametrize("criterion", list(CRITERIA))
def test_the_share_that_explores_is_kept_over_all_batches_and_the_choice_follows_from_its_arguments(state, criterion):
    def chosen(share, first, seed):
        return choose(state, SPACE, 4, explore=share, first=first, criterion=criterion, seed=seed)

    particles = {row.tobytes() for row in state.positions}
    for share in (0.0, 0.1, 0.5):
        batches = [chosen(share, first, first) for first in range(10, 30, 4)]
        assert {len(np.unique(batch, axis=0)) for batch in batches} == {4}
        exploring = sum(row.tobytes() not in particles for batch in batches for row in batch)
        assert exploring == int(30 * share) - int(10 * share)
    np.testing.assert_array_equal(chosen(0.2, 10, 1), chosen(0.2, 10, 1))
    assert not np.array_equal(chosen(0.2, 10, 1), chosen(0.2, 10, 2))


def test_a_criterion_that_picks_wrongly_is_refused(state, monkeypatch):
    """The first one again, a point elsewhere, a number."""
    for wrong, runs in [(lambda pool: pool[0], 2), (lambda pool: np.array([9.0, 9.0]), 1), (len, 1)]:
        mine = lambda state, pool, *others, wrong=wrong: lambda exploring: wrong(pool)  # noqa: E731
        monkeypatch.setitem(CRITERIA, "mine", mine)
        with pytest.raises(sl.InvalidInput, match="what the criterion mine picks"):
            choose(state, SPACE, runs, explore=0.0, first=10, criterion="mine", seed=3)


ALLOWED, SD = 60, 0.15
FIRST, X = even(12), even(60)


def near_the_truth(x):
    """Return whether a run lies in a disc over the truth, where runs fail."""
    return np.linalg.norm(x - MEAN) < 0.5


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
    one = ActiveDesign(Active(ALLOWED, unseen=1.0), SPACE, batch=4, scramble=1, **options)
    one.start(FIRST)
    x = FIRST
    while (batch := one.next(x, [record(row, ok=not fails(row)) for row in x])) is not None:
        x = np.concatenate([x, batch.points])
    return one, len(x), sum(fails(row) for row in x[len(FIRST) :])


def test_no_more_than_a_tenth_of_the_runs_is_lost():
    """The observation is best explained by inputs that fail."""
    one, runs, lost = lost_in(near_the_truth)
    assert (one.converged, runs) == (False, ALLOWED)
    assert 1 <= lost <= MOST * ALLOWED + 2
    assert any("of the posterior lies where runs are likely to fail" in reason for reason in one.reasons)


def test_without_that_limit_far_more_are_lost_but_not_by_a_region_that_fails_elsewhere(monkeypatch):
    """The planted bug: every batch and every check may be made."""
    limited, _, _ = lost_in(lambda x: x[0] < -0.5)
    monkeypatch.setattr(Losses, "bears", lambda self, x: True)
    monkeypatch.setattr(Losses, "bears_check", lambda self, state, draws: True)
    assert lost_in(near_the_truth)[2] > 3 * MOST * ALLOWED
    free, _, _ = lost_in(lambda x: x[0] < -0.5)
    assert limited.converged
    for one, other in zip(limited.batches, free.batches, strict=True):
        np.testing.assert_array_equal(one.points, other.points)


@pytest.fixture(scope="module")
def losses():
    """A quarter of the box fails; more runs than may be are lost there."""
    return Losses(known(X, X[:, 0] < 0.5), ALLOWED, frozenset())


def test_the_first_runs_and_failures_at_random_are_no_losses(losses):
    failed = ~losses.knowledge.ok & (losses.chance(X) < UNLIKELY)
    assert losses.lost == failed.sum() > 10
    assert losses.left == MOST * ALLOWED - losses.lost < 0
    first = frozenset(row.tobytes() for row in X[:30])
    assert Losses(losses.knowledge, ALLOWED, first).lost == failed[30:].sum() > 5
    at_random = Losses(known(X, np.random.default_rng(3).random(60) > 0.2), ALLOWED, frozenset())
    assert (at_random.lost, at_random.bears(X)) == (0, True)


def test_runs_at_safe_points_are_always_borne_and_a_posterior_where_runs_fail_is_not_checked(losses):
    safe, gone = np.array([[-0.5, 0.0]]), np.array([[0.9, 0.0]])
    assert losses.chance(gone)[0] < UNLIKELY < SAFE < losses.chance(safe)[0]
    assert [losses.bears(x) for x in (safe, gone, np.concatenate([safe, gone]))] == [True, False, False]
    np.testing.assert_array_equal(losses.bearable(np.concatenate([gone, safe])), safe)
    looked = points_elsewhere(X[:8], SPACE, 0.05, 50, losses.likely)
    assert 0 < len(looked) < len(points_elsewhere(X[:8], SPACE, 0.05, 50))
    assert losses.likely(looked).all()
    inside, outside = (state_of(losses.knowledge, mean=mean, sd=0.1) for mean in [(0.9, 0.0), (-0.4, 0.0)])
    assert [losses.bears_check(one, 9) for one in (inside, outside)] == [False, True]
    assert losses.words(outside) == ()
    assert losses.words(inside)[0].endswith(f"{losses.lost} runs were lost there")
    assert not Losses(losses.knowledge, 1000, frozenset(), price=20.0).bears(gone)
    times = (("ok", 1.0), ("ok", 3.0), ("timeout", 40.0))
    runs = [replace(record(gone[0], ok=state == "ok"), state=state, seconds=seconds) for state, seconds in times]
    assert (price_of_a_hang(runs), price_of_a_hang(runs[:2])) == (20.0, 1.0)
    many = Losses(losses.knowledge, 1000, frozenset())
    assert (many.bears(gone), many.bears_check(inside, 9)) == (True, True)


def test_safe_runs_are_chosen(losses):
    """Where hardly a particle is safe, points of the box take their place."""
    state = state_of(losses.knowledge, mean=(0.9, 0.0), sd=0.1)
    options = {"explore": 0.25, "first": 60, "seed": 2, "criterion": "expected_variance"}
    assert (losses.chance(state.positions) >= SAFE).mean() < 0.05
    anywhere, chosen = (choose(state, SPACE, 12, losses=one, **options) for one in (None, losses))
    assert (losses.chance(anywhere) < UNLIKELY).any()
    assert (losses.chance(chosen) >= SAFE).all()
    assert len(np.unique(chosen, axis=0)) == 12
    state = state_of(losses.knowledge, mean=(0.2, 0.0), sd=0.3)
    found = safe_candidates(losses, state, state.positions, SPACE, 1)
    np.testing.assert_array_equal(found, state.positions[losses.chance(state.positions) >= SAFE])


def test_a_criterion_may_pick_a_point_twice_once_one_of_its_pools_is_used_up():
    one, two = np.array([[0.1, 0.2]]), np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    np.testing.assert_array_equal(_accepted(one[0], {True: one, False: two}, [one[0]], "mine"), one[0])
    with pytest.raises(sl.InvalidInput, match="mine picks"):
        _accepted(one[0], {True: two, False: two}, [one[0]], "mine")
