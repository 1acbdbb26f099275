"""Posteriors that go on from the last one against those that are sampled from the prior."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest
from tests.design.active.fakes import SPACE, Assumed, known, state_of

from strandline.design import sobol
from strandline.design.active import sampling as module
from strandline.design.active.sampling import posterior_state
from strandline.design.active.state import State
from strandline.smc import Particles, carried

X = SPACE.to_physical(sobol(12, 2))


def assumed(mean: tuple[float, float], sd: float = 0.1) -> Assumed:
    own = {name: getattr(known(X), name) for name in ("x", "ok", "likelihood", "feasibility", "highest")}
    return Assumed(**own, mean=mean, sd=sd)


@cache
def assumed_once() -> Assumed:
    return assumed((0.2, 0.1))


@dataclass(frozen=True, eq=False)
class TwoModes(Assumed):
    """A normal likelihood, and a second mode as heavy that is far away."""

    far: tuple[float, float] = (-0.7, -0.6)

    def plug_in(self, x: np.ndarray) -> np.ndarray:
        other = replace(self, mean=self.far)
        return np.logaddexp(super().plug_in(x), super(TwoModes, other).plug_in(x))


@dataclass(frozen=True, eq=False)
class Counted(Assumed):
    """Counts the points at which the likelihood is evaluated."""

    calls: list[int] = field(default_factory=list)

    def plug_in(self, x: np.ndarray) -> np.ndarray:
        self.calls.append(len(x))
        return super().plug_in(x)


@dataclass(frozen=True, eq=False)
class Rough(Counted):
    """Has a rough likelihood beside the exact one: a normal one whose mean is off."""

    off: float = 0.0

    def roughly(self, x: np.ndarray) -> np.ndarray:
        return replace(assumed_once(), mean=(self.mean[0] + self.off, self.mean[1])).plug_in(x) - 3.0


def rough(mean: tuple[float, float], off: float) -> Rough:
    return Rough(**vars(assumed(mean)), off=off)


def first(mean: tuple[float, float] = (0.2, 0.1)) -> State:
    return posterior_state(assumed(mean), SPACE, (1,))


def z_scores(
    before: State | None, mean: tuple[float, float], replicates: int = 24, knowledge: Assumed | None = None
) -> np.ndarray:
    """Return z of means and of log sds over replicates that go on from `before`, for a normal posterior."""
    known_so_far = knowledge or assumed(mean)
    found = [posterior_state(known_so_far, SPACE, (seed,), before=before) for seed in range(replicates)]
    means = np.array([one.mean for one in found]) - mean
    widths = np.log(np.array([one.sd for one in found]) / 0.1)
    each = np.concatenate([means / 0.1, widths], axis=1)
    return np.asarray(each.mean(axis=0) / (each.std(axis=0, ddof=1) / np.sqrt(replicates)))


def test_a_posterior_that_moved_a_little_is_found_from_the_one_before() -> None:
    before = first()
    counted = Counted(**vars(assumed((0.25, 0.08))))
    posterior_state(counted, SPACE, (3,), before=before)
    assert sum(counted.calls) < 30_000
    assert np.abs(z_scores(before, (0.25, 0.08))).max() < 4


def test_moves_that_forget_the_new_weights_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(carried, "rejuvenate", lambda key, state, *others, **options: replaced(state))

    def replaced(state: Particles) -> Particles:
        return state._replace(log_weights=0 * state.log_weights - np.log(len(state.log_weights)))

    assert np.abs(z_scores(first(), (0.25, 0.08))).max() > 4


def test_the_evidence_goes_on_too() -> None:
    before, knowledge = first(), assumed((0.25, 0.08))
    afresh, gone_on = (posterior_state(knowledge, SPACE, (5,), before=one) for one in (None, before))
    assert gone_on.log_evidence_tempered == pytest.approx(afresh.log_evidence_tempered, abs=0.2)
    assert gone_on.log_evidence_tempered != afresh.log_evidence_tempered


def test_a_posterior_far_away_is_sampled_from_the_prior() -> None:
    knowledge = assumed((-0.6, -0.5))
    afresh, other = (posterior_state(knowledge, SPACE, (5,), before=one) for one in (None, first()))
    np.testing.assert_array_equal(afresh.positions, other.positions)


def test_a_mode_that_appears_elsewhere_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    own = vars(assumed((0.2, 0.1)))
    knowledge = TwoModes(**own)
    found = posterior_state(knowledge, SPACE, (5,), before=first())
    share = np.exp(found.log_weights) @ (found.positions[:, 0] < -0.3)
    assert 0.35 < share < 0.65
    monkeypatch.setattr(carried, "ELSEWHERE", 1e9)
    blind = posterior_state(knowledge, SPACE, (5,), before=first())
    assert np.exp(blind.log_weights) @ (blind.positions[:, 0] < -0.3) < 0.01


def test_a_posterior_without_its_evidence_is_no_start() -> None:
    before = state_of(known(X), number=module.PARTICLES[2])
    knowledge = assumed((0.2, 0.1), 0.2)
    afresh, other = (posterior_state(knowledge, SPACE, (5,), before=one) for one in (None, before))
    np.testing.assert_array_equal(afresh.positions, other.positions)


def test_a_rough_likelihood_leads_to_the_exact_posterior() -> None:
    """Moves by the rough one are not by the exact one; its mean, half a sd off, and its level do not show."""
    knowledge, plain = rough((0.2, 0.1), 0.05), Counted(**vars(assumed((0.2, 0.1))))
    exact = posterior_state(plain, SPACE, (1,))
    assert np.abs(z_scores(None, (0.2, 0.1), knowledge=knowledge)).max() < 4
    knowledge.calls.clear()
    found = posterior_state(knowledge, SPACE, (1,))
    assert found.log_evidence_tempered == pytest.approx(exact.log_evidence_tempered, abs=0.2)
    assert sum(knowledge.calls) < 0.5 * sum(plain.calls)


def test_a_rough_likelihood_that_is_not_weighed_off_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    forgotten = lambda host, space, near, *others: replace(near, log_likelihood=host(near.positions))  # noqa: E731
    monkeypatch.setattr(module, "_gone_on", forgotten)
    assert np.abs(z_scores(None, (0.2, 0.1), knowledge=rough((0.2, 0.1), 0.05))).max() > 4


def test_a_rough_likelihood_that_leads_astray_is_left() -> None:
    exact, other = (posterior_state(one, SPACE, (5,)) for one in (assumed((0.2, 0.1)), rough((0.2, 0.1), -0.9)))
    np.testing.assert_array_equal(exact.positions, other.positions)


def test_a_mode_that_the_rough_likelihood_does_not_see_is_noticed() -> None:
    @dataclass(frozen=True, eq=False)
    class Blind(TwoModes):
        def roughly(self, x: np.ndarray) -> np.ndarray:
            return replace(assumed_once(), mean=self.mean).plug_in(x)

    found = posterior_state(Blind(**vars(assumed((0.2, 0.1)))), SPACE, (5,))
    share = np.exp(found.log_weights) @ (found.positions[:, 0] < -0.3)
    assert 0.35 < share < 0.65
