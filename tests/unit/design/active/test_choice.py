"""Which runs are chosen, against brute force."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active.fakes import SPACE, known, state_of

from strandline.design import sobol
from strandline.design.active import CRITERIA
from strandline.design.active.choice import choose
from strandline.design.active.state import State
from strandline.errors import InvalidInput
from strandline.surrogate.field.mode_process import ModeProcess
from strandline.surrogate.field.restricted_evidence import Observed, condition_mode

RUNS = SPACE.to_physical(sobol(10, 2))
RNG = np.random.default_rng(1)
CANDIDATES, UNKNOWN, TARGETS = RNG.uniform(-1, 1, (12, 2)), RNG.uniform(-1, 1, (5, 2)), RNG.uniform(-0.5, 0.5, (15, 2))


@pytest.fixture(scope="module")
def state() -> State:
    return state_of(known(RUNS))


def with_run(process: ModeProcess, z: np.ndarray) -> ModeProcess:
    """Return the process with a value at z too; what it is makes no difference to the variance at a given scale."""
    seen = process.observed
    more = Observed(np.append(seen.z, z[None], axis=0), np.append(seen.values, 0.0), None, seen.linear)
    found = ModeProcess(more, process.lengths, process.nugget, condition_mode(more, process.lengths, process.nugget))
    return replace(found, widening=process.scale / found.factors.variance)


def left(processes: list[ModeProcess], z: np.ndarray) -> float:
    """Return the sum over modes and targets of the variance."""
    return float(sum(process.variance(z).sum() for process in processes))


def test_the_largest_reduction_of_the_variance_is_picked(state: State) -> None:
    surrogate = state.knowledge.surrogate
    z, targets = (surrogate.warping.standardise(x) for x in (CANDIDATES, TARGETS))
    processes = list(surrogate.processes[:6])
    pick = CRITERIA["expected_variance"](state, CANDIDATES, UNKNOWN, TARGETS)
    for _ in range(3):
        remaining = [left([with_run(p, row) for p in processes], targets) for row in z]
        order = np.argsort(remaining)
        assert remaining[order[-1]] > 1.2 * remaining[order[0]]
        best = int(order[0])
        np.testing.assert_array_equal(pick(False), CANDIDATES[best])
        processes = [with_run(p, z[best]) for p in processes]


def test_a_run_that_explores_goes_where_least_is_known(state: State) -> None:
    surrogate = state.knowledge.surrogate
    variance = surrogate.predict(UNKNOWN).variance[:, :6].sum(axis=1)
    pick = CRITERIA["expected_variance"](state, CANDIDATES, UNKNOWN, TARGETS)
    np.testing.assert_array_equal(pick(True), UNKNOWN[np.argmax(variance)])


def test_runs_that_fail_are_avoided() -> None:
    ok = RUNS[:, 0] < 0.3
    free, wary = state_of(known(RUNS)), state_of(known(RUNS, ok))
    wary = replace(wary, knowledge=replace(free.knowledge, feasibility=wary.knowledge.feasibility, highest=0.0))
    chosen = [choose(s, SPACE, 16, explore=0.25, first=10, criterion="expected_variance", seed=3) for s in (free, wary)]
    assert (chosen[1][:, 0] > 0.5).sum() < (chosen[0][:, 0] > 0.5).sum()


def test_repulsion_picks_what_is_farthest_from_all_runs(state: State) -> None:
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
def test_the_share_that_explores_is_kept_over_all_batches(state: State, criterion: str) -> None:
    particles = {row.tobytes() for row in state.positions}
    for share in (0.0, 0.1, 0.5):
        exploring = 0
        for first in range(10, 30, 4):
            chosen = choose(state, SPACE, 4, explore=share, first=first, criterion=criterion, seed=first)
            assert len(np.unique(chosen, axis=0)) == 4
            exploring += sum(row.tobytes() not in particles for row in chosen)
        assert exploring == int(30 * share) - int(10 * share)


def test_near_the_posterior_the_flanks_are_left_out(state: State) -> None:
    """The same number of runs lies closer to the mean, in standard deviations of the posterior."""

    z = (state.positions - state.mean) / state.sd
    narrow = replace(state, log_weights=np.asarray(log_softmax(-np.sum(z**2, axis=1))))

    def distance(near: bool) -> float:
        options: Any = {"explore": 0.0, "first": 10, "criterion": "expected_variance", "seed": 3}
        chosen = choose(narrow, SPACE, 30, near=near, **options)
        return float(np.mean(np.linalg.norm((chosen - narrow.mean) / narrow.sd, axis=1)))

    assert distance(near=True) < 0.85 * distance(near=False)


@pytest.mark.parametrize("criterion", list(CRITERIA))
def test_the_choice_follows_from_its_arguments(state: State, criterion: str) -> None:
    def chosen(seed: int) -> np.ndarray:
        return choose(state, SPACE, 5, explore=0.2, first=10, criterion=criterion, seed=seed)

    np.testing.assert_array_equal(chosen(1), chosen(1))
    assert not np.array_equal(chosen(1), chosen(2))


def test_a_criterion_that_picks_wrongly_is_refused(state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one again, a point elsewhere, a number."""
    wrongly: list[tuple[Any, int]] = [(lambda pool: pool[0], 2), (lambda pool: np.array([9.0, 9.0]), 1), (len, 1)]
    for wrong, runs in wrongly:
        mine = lambda state, pool, *others, wrong=wrong: lambda exploring: wrong(pool)  # noqa: E731
        monkeypatch.setitem(CRITERIA, "mine", mine)
        with pytest.raises(InvalidInput, match="what the criterion mine picks"):
            choose(state, SPACE, runs, explore=0.0, first=10, criterion="mine", seed=3)
