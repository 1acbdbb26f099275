"""Which runs are chosen, against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active.fakes import SPACE, even, known, state_of

from strandline.design.active import CRITERIA
from strandline.design.active.choice import choose
from strandline.errors import InvalidInput
from strandline.surrogate.field.mode_process import ModeProcess
from strandline.surrogate.field.restricted_evidence import Observed, condition_mode

RUNS = even(10)
RNG = np.random.default_rng(1)
CANDIDATES, UNKNOWN, TARGETS = RNG.uniform(-1, 1, (12, 2)), RNG.uniform(-1, 1, (5, 2)), RNG.uniform(-0.5, 0.5, (15, 2))


@pytest.fixture(scope="module")
def state():
    return state_of(known(RUNS))


def with_run(process, z):
    """Return the process with a value at z too; what it is makes no difference to the variance at a given scale."""
    seen = process.observed
    more = Observed(np.append(seen.z, z[None], axis=0), np.append(seen.values, 0.0), None, seen.linear)
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


def test_near_the_posterior_the_flanks_are_left_out(state):
    """The same number of runs lies closer to the mean, in standard deviations of the posterior."""
    z = (state.positions - state.mean) / state.sd
    narrow = replace(state, log_weights=log_softmax(-np.sum(z**2, axis=1)))
    options = {"explore": 0.0, "first": 10, "criterion": "expected_variance", "seed": 3}
    near, far = (choose(narrow, SPACE, 30, near=near, **options) for near in (True, False))
    distances = [np.mean(np.linalg.norm((one - narrow.mean) / narrow.sd, axis=1)) for one in (near, far)]
    assert distances[0] < 0.85 * distances[1]


def test_a_criterion_that_picks_wrongly_is_refused(state, monkeypatch):
    """The first one again, a point elsewhere, a number."""
    wrongly = [(lambda pool: pool[0], 2), (lambda pool: np.array([9.0, 9.0]), 1), (len, 1)]
    for wrong, runs in wrongly:
        mine = lambda state, pool, *others, wrong=wrong: lambda exploring: wrong(pool)  # noqa: E731
        monkeypatch.setitem(CRITERIA, "mine", mine)
        with pytest.raises(InvalidInput, match="what the criterion mine picks"):
            choose(state, SPACE, runs, explore=0.0, first=10, criterion="mine", seed=3)
