"""Inputs made straighter: warps that predict best, chosen only now and then, monotone and with the chain rule."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from strandline.design.refinement import sobol
from strandline.surrogate.field import field as module
from strandline.surrogate.field.field import WARPS, Data, Warping, choose_warping, eligible, fewest_runs

LOW, HIGH = np.array([100.0, 0.1]), np.array([800.0, 0.5])
PLACES = np.linspace(0.0, 1.0, 15)
PLAIN = Warping(("identity", "identity"), LOW, HIGH)


def names_of(number, *, power=-1.0):
    """Return the warps chosen for runs whose field is straight in this power of the first input."""
    x = LOW + (HIGH - LOW) * sobol(number, 2, scramble=3)
    field = (x[:, :1] / 100) ** power * np.sin(2 * PLACES) + x[:, 1:] * PLACES
    return choose_warping(Data(x, field, np.full(15, 1 / 15), None), PLAIN, 1e-5).names


@pytest.fixture
def chosen(monkeypatch):
    """Forget all choices; return a list of how many runs each new one is made with."""
    counts, inner = [], module._chosen
    monkeypatch.setattr(module, "_kept", type(module._kept)())
    monkeypatch.setattr(module, "_chosen", lambda few, *rest: counts.append(len(few.x)) or inner(few, *rest))
    return counts


def test_a_choice_is_kept_until_the_runs_have_grown_by_a_quarter(chosen):
    names = [names_of(number) for number in range(8, 21)]
    assert set(names) == {("reciprocal", "identity")}
    assert chosen == [7, 9, 12, 15, 19]


def test_other_fields_at_the_same_inputs_are_chosen_for_anew(chosen):
    """A correction of a cheaper model changes the fields of old runs."""
    assert names_of(9) == ("reciprocal", "identity")
    assert names_of(9, power=1.0) == ("identity", "identity")
    assert len(chosen) == 2


@pytest.mark.parametrize("gradients", [False, True])
def test_the_fewest_runs_that_there_may_be_are_enough_to_choose(gradients):
    for dim in (1, 2, 3):
        number = fewest_runs(dim, gradients=gradients)
        x = sobol(number, dim)
        slopes = np.zeros((number, 15, dim)) if gradients else None
        few = Data(x, np.outer(x[:, 0], PLACES), np.full(15, 1 / 15), slopes)
        assert module._choosing_runs(few) == number


def quantity(x):
    """Return three values a run."""
    a, b = x.T
    return np.stack([1e3 * b / a, np.log(a) * b, a * b**2 / 1e3], axis=1)


def test_gradients_follow_the_chain_rule_and_the_box_spans_what_a_uniform_distribution_does():
    """Mean 0 and deviation 1 of a uniform distribution over the warped box: from -√3 to √3."""
    x = np.random.default_rng(1).uniform(LOW, HIGH, (7, 2))
    for names in product(WARPS, repeat=2):
        warping, by_input, by_standardised = Warping(names, LOW, HIGH), [], []
        for j, step in enumerate(1e-5 * np.diag(HIGH - LOW)):
            change = quantity(x + step) - quantity(x - step)
            by_input.append(change / (2 * step[j]))
            gone = warping.standardise(x + step) - warping.standardise(x - step)
            by_standardised.append(change / gone[:, j : j + 1])
        found = warping.gradients(x, np.stack(by_input, axis=-1))
        np.testing.assert_allclose(found, np.stack(by_standardised, axis=-1), rtol=1e-6)
        ends = np.sort(warping.standardise(np.stack([LOW, HIGH])), axis=0)
        np.testing.assert_allclose(ends, np.sqrt(3.0) * np.array([[-1, -1], [1, 1]]), rtol=1e-12)


def test_a_warp_is_monotone_and_only_wide_and_positive_inputs_are_warped():
    for warp in WARPS.values():
        assert len(set(np.sign(np.diff(warp.apply(np.linspace(0.2, 9.0, 200)))))) == 1
    low, high = np.array([100.0, -0.8, 1.0, 0.0, 1.0]), np.array([800.0, 0.5, 1.5, 1.0, 2.0])
    assert eligible(low, high) == [0, 4]


@pytest.mark.stand_in
def test_fits_are_quick_only_where_they_are_compared(monkeypatch):
    asked, fit = [], module.fit_mode
    monkeypatch.setattr(module, "fit_mode", lambda one, quick: (asked.append(quick), fit(one, quick=quick))[1])
    z = np.random.default_rng(1).random((8, 1))
    data = module.Data(z, np.sin(3 * z) * np.ones((8, 4)), np.full(4, 0.25), None)
    warping = SimpleNamespace(standardise=lambda x: 2 * x - 1)
    for most, quick in ((None, False), (1, True)):
        module.fit_modes(data, warping, 1e-3, most)
        assert asked.pop() is quick
