"""Posteriors that go on from the last one against those that are sampled from the prior."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from tests.unit.design.active.fakes import SPACE, Assumed, known, own, state_of

from strandline.design import sobol
from strandline.design.active import sampling as module
from strandline.design.active.sampling import posterior_state
from strandline.design.active.state import State
from strandline.smc import Particles, carried

X = SPACE.to_physical(sobol(12, 2))
PARTICLES = 600


def assumed(mean: tuple[float, float] = (0.2, 0.1), sd: float = 0.1) -> Assumed:
    return Assumed(**own(known(X)), mean=mean, sd=sd)


def sampled(knowledge: Assumed, seed: int = 5, before: State | None = None) -> State:
    return posterior_state(knowledge, SPACE, (seed,), before=before, particles=PARTICLES)


@pytest.fixture(scope="module")
def before() -> State:
    """The posterior of mean (0.2, 0.1)."""
    return sampled(assumed(), 1)


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
        return assumed((self.mean[0] + self.off, self.mean[1])).plug_in(x) - 3.0


def rough(off: float) -> Rough:
    return Rough(**vars(assumed()), off=off)


def share_far(state: State) -> float:
    return float(np.exp(state.log_weights) @ (state.positions[:, 0] < -0.3))


def worst_z(knowledge: Assumed, before: State | None = None, replicates: int = 16) -> float:
    """Return the largest |z| of means and of log sds over replicates, for a normal posterior."""
    found = [sampled(knowledge, seed, before) for seed in range(replicates)]
    means = np.array([one.mean for one in found]) - knowledge.mean
    widths = np.log(np.array([one.sd for one in found]) / 0.1)
    each = np.concatenate([means / 0.1, widths], axis=1)
    return float(np.abs(each.mean(axis=0) / (each.std(axis=0, ddof=1) / np.sqrt(replicates))).max())


def test_a_posterior_that_moved_a_little_is_found_from_the_one_before(
    before: State, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its evidence. The planted bug: moves that forget the new weights."""
    knowledge = assumed((0.25, 0.08))
    counted = Counted(**vars(knowledge))
    gone_on, afresh = sampled(counted, 3, before), sampled(knowledge, 3)
    assert sum(counted.calls) < 15 * PARTICLES
    assert gone_on.log_evidence_tempered == pytest.approx(afresh.log_evidence_tempered, abs=0.3)
    assert gone_on.log_evidence_tempered != afresh.log_evidence_tempered
    assert worst_z(knowledge, before) < 4

    def forgetful(key: object, state: Particles, *others: object, **options: object) -> Particles:
        return state._replace(log_weights=0 * state.log_weights - np.log(len(state.log_weights)))

    monkeypatch.setattr(carried, "rejuvenate", forgetful)
    assert worst_z(knowledge, before) > 4


def test_a_posterior_far_away_or_without_its_evidence_is_sampled_from_the_prior(before: State) -> None:
    far, near = assumed((-0.6, -0.5)), assumed(sd=0.2)
    np.testing.assert_array_equal(sampled(far).positions, sampled(far, before=before).positions)
    unknown = state_of(known(X), number=PARTICLES)
    np.testing.assert_array_equal(sampled(near).positions, sampled(near, before=unknown).positions)


def test_as_many_particles_as_the_inputs_need_unless_stated(before: State) -> None:
    assert len(before.positions) == PARTICLES
    assert len(posterior_state(assumed(), SPACE, (1,)).positions) == module.PARTICLES[2]


def test_a_mode_that_appears_elsewhere_is_noticed(before: State, monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted bug: nobody looks outside of the particles."""
    knowledge = TwoModes(**vars(assumed()))
    assert 0.3 < share_far(sampled(knowledge, before=before)) < 0.7
    monkeypatch.setattr(carried, "_outside", lambda x, weights, scouts: scouts[:0])
    assert share_far(sampled(knowledge, before=before)) < 0.01


def test_a_rough_likelihood_leads_to_the_exact_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moves by the rough one are not by the exact one; its mean, half a sd off, and its level do not show.

    The planted bug: it is not weighed off.
    """
    knowledge, plain = rough(0.05), Counted(**vars(assumed()))
    exact, found = sampled(plain), sampled(knowledge)
    assert found.log_evidence_tempered == pytest.approx(exact.log_evidence_tempered, abs=0.3)
    assert sum(knowledge.calls) < 0.5 * sum(plain.calls)
    assert worst_z(knowledge) < 4
    forgotten = lambda host, space, near, *others: replace(near, log_likelihood=host(near.positions))  # noqa: E731
    monkeypatch.setattr(module, "_gone_on", forgotten)
    assert worst_z(knowledge) > 4


def test_a_rough_likelihood_that_leads_astray_or_does_not_see_a_mode_is_left() -> None:
    np.testing.assert_array_equal(sampled(assumed()).positions, sampled(rough(-0.9)).positions)

    @dataclass(frozen=True, eq=False)
    class Blind(TwoModes):
        def roughly(self, x: np.ndarray) -> np.ndarray:
            return assumed(self.mean).plug_in(x)

    assert 0.3 < share_far(sampled(Blind(**vars(assumed())))) < 0.7
