"""The warps are those that predict best, and a design that grows run by run chooses them anew only now and then."""

import numpy as np
import pytest

from strandline.design.space_filling import sobol
from strandline.surrogate.field import warp_choice
from strandline.surrogate.field.warp_choice import Data, choose_warping, fewest_runs
from strandline.surrogate.field.warping import Warping

LOW, HIGH = np.array([100.0, 0.1]), np.array([800.0, 0.5])
PLACES = np.linspace(0.0, 1.0, 15)
PLAIN = Warping(("identity", "identity"), LOW, HIGH)


def data(number: int, *, power: float = -1.0) -> Data:
    """Return runs whose field is straight in this power of the first input."""
    x = LOW + (HIGH - LOW) * sobol(number, 2, scramble=3)
    field = (x[:, :1] / 100) ** power * np.sin(2 * PLACES) + x[:, 1:] * PLACES
    return Data(x, field, np.full(15, 1 / 15), None)


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Forget all choices; return a list of how many runs each new one is made with."""
    counts: list[int] = []
    inner = warp_choice._chosen
    monkeypatch.setattr(warp_choice, "_kept", type(warp_choice._kept)())
    monkeypatch.setattr(warp_choice, "_chosen", lambda few, *rest: counts.append(len(few.x)) or inner(few, *rest))
    return counts


def test_a_choice_is_kept_until_the_runs_have_grown_by_a_quarter(chosen: list[int]) -> None:
    names = [choose_warping(data(number), PLAIN, 1e-5).names for number in range(8, 21)]
    assert set(names) == {("reciprocal", "identity")}
    assert chosen == [7, 9, 12, 15, 19]
    warp_choice._kept.clear()
    assert [choose_warping(data(20), PLAIN, 1e-5).names for _ in range(2)] == names[:2]
    assert chosen[5:] == [19]


def test_other_fields_at_the_same_inputs_are_chosen_for_anew_and_few_choices_are_kept(chosen: list[int]) -> None:
    """A correction of a cheaper model changes the fields of old runs."""
    assert choose_warping(data(9), PLAIN, 1e-5).names == ("reciprocal", "identity")
    assert choose_warping(data(9, power=1.0), PLAIN, 1e-5).names == ("identity", "identity")
    assert len(chosen) == 2
    for power in np.linspace(-1.0, 1.0, warp_choice.KEPT + 1):
        choose_warping(data(9, power=float(power)), PLAIN, 1e-5)
    assert len(warp_choice._kept) == warp_choice.KEPT


@pytest.mark.parametrize("gradients", [False, True])
def test_the_fewest_runs_that_there_may_be_are_enough_to_choose(gradients: bool) -> None:
    for dim in (1, 2, 3):
        number = fewest_runs(dim, gradients=gradients)
        x = sobol(number, dim)
        slopes = np.zeros((number, 15, dim)) if gradients else None
        few = Data(x, np.outer(x[:, 0], PLACES), np.full(15, 1 / 15), slopes)
        assert warp_choice._choosing_runs(few) == number
