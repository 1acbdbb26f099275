"""The cost of a batch, estimated beforehand."""

import numpy as np
import pytest

from strandline.design.active import SLOW_BATCH, cost, seconds_of_a_batch
from strandline.interface import Interface, Observation

EVALUATIONS = 1200 * (1 + 20 * 10 + 16)  # of a design with five inputs


def line(number: int) -> Interface:
    return Interface.polyline(np.stack([np.arange(float(number)), np.zeros(number)], axis=1))


class Clock:
    """A clock of its own: a comparison takes a millisecond."""

    now = 0.0

    def measure(self, simulated: Interface, observed: Interface) -> float:
        self.now += 1e-3
        return float(np.sum((simulated.points - observed.points) ** 2))


def estimated(clock: Clock, *names: str, faster: tuple[float, ...] = (1.0,)) -> float:
    """Return the estimate for some conditions, by clocks that go faster than that one."""
    seen = tuple(Observation(line(3), 1e-4, name) for name in names)
    clocks = tuple(lambda by=by: by * clock.now for by in faster)
    return seconds_of_a_batch(seen, clock.measure, {name: line(3) for name in names}, 5, clocks=clocks)


def test_it_is_the_time_of_all_comparisons_of_all_conditions() -> None:
    one = estimated(Clock(), "")
    assert one == pytest.approx(1e-3 * EVALUATIONS)
    assert one > SLOW_BATCH
    assert estimated(Clock(), "a", "b") == pytest.approx(2 * one)


@pytest.mark.parametrize("faster", [(10.0, 1.0), (1.0, 10.0)], ids=["wall-clock time", "threads"])
def test_other_work_on_the_machine_does_not_count(faster: tuple[float, ...]) -> None:
    """Wall-clock time goes ten times as fast as the processor's, or threads of the measure use ten processors."""
    assert estimated(Clock(), "", faster=faster) == pytest.approx(1e-3 * EVALUATIONS)


def test_the_fastest_of_three_trials_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is of 32 interfaces."""
    seconds = iter([5.0, 3.2, 4.0])
    monkeypatch.setattr(cost, "_seconds", lambda *given: next(seconds))
    assert estimated(Clock(), "") == pytest.approx(0.1 * EVALUATIONS)
