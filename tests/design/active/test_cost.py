"""The cost of a batch, estimated beforehand."""

import numpy as np
import pytest

from strandline.design.active import SLOW_BATCH, cost, seconds_of_a_batch
from strandline.discrepancy import Discrepancy
from strandline.interface import Interface, Observation

EVALUATIONS = 1200 * (1 + 20 * 10 + 16)  # of a design with five inputs


def line(number: int) -> Interface:
    return Interface.polyline(np.stack([np.arange(float(number)), np.zeros(number)], axis=1))


@pytest.fixture
def taking(monkeypatch: pytest.MonkeyPatch) -> Discrepancy:
    """A measure that takes a millisecond, by a clock of its own."""
    clock = [0.0]
    monkeypatch.setattr(cost.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(cost.time, "process_time", lambda: clock[0])

    def measure(simulated: Interface, observed: Interface) -> float:
        clock[0] += 1e-3
        return float(np.sum((simulated.points - observed.points) ** 2))

    return measure


def test_it_is_the_time_of_all_comparisons(taking: Discrepancy) -> None:
    seconds = seconds_of_a_batch((Observation(line(9), 1e-4),), taking, {"": line(9)}, 5)
    assert seconds == pytest.approx(1e-3 * EVALUATIONS)
    assert seconds > SLOW_BATCH


def test_conditions_add_up(taking: Discrepancy) -> None:
    seen = tuple(Observation(line(9), 1e-4, name) for name in ("a", "b"))
    seconds = seconds_of_a_batch(seen, taking, {"a": line(9), "b": line(9)}, 5)
    assert seconds == pytest.approx(2e-3 * EVALUATIONS)


@pytest.mark.parametrize("busy", ["perf_counter", "process_time"])
def test_other_work_on_the_machine_does_not_count(
    taking: Discrepancy, busy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clock goes ten times as fast as the processor's, or the threads of the measure use ten processors."""
    slow = getattr(cost.time, busy)
    monkeypatch.setattr(cost.time, busy, lambda: 10 * slow())
    seconds = seconds_of_a_batch((Observation(line(9), 1e-4),), taking, {"": line(9)}, 5)
    assert seconds == pytest.approx(1e-3 * EVALUATIONS)


def test_the_fastest_trial_counts(taking: Discrepancy, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three, each of 32 interfaces."""
    seconds = iter([5.0, 3.2, 4.0])
    monkeypatch.setattr(cost, "_seconds", lambda *given: next(seconds))
    found = seconds_of_a_batch((Observation(line(9), 1e-4),), taking, {"": line(9)}, 5)
    assert found == pytest.approx(0.1 * EVALUATIONS)
