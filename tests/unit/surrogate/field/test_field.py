"""The surrogate of the interface on a displacement with a closed form: V/E times a shape that depends on ν."""

from dataclasses import replace

import numpy as np
import pytest

from strandline.design import sobol
from strandline.foundations import InvalidInput, TooFewRuns
from strandline.interface import Interface
from strandline.surrogate.field import FieldTraining, fewest_runs, fit_field

LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])
S = np.linspace(0.0, 1.0, 25)
LOAD = 40.0


def points(x):
    """Return the nodes: displaced along by a sine, across by a bent shape that widens with ν."""
    E, nu = x[:, :1], x[:, 1:]
    across = LOAD / E * (S**2 * (3 - S) + np.exp(1.5 * nu) * np.sin(3 * S))
    along = LOAD / E * nu**2 * np.sin(np.pi * S)
    return np.stack([S + 0.3 * along, across], axis=-1)


def gradients(x):
    """Return the derivatives of the nodes by E and ν."""
    E, nu = x[:, :1], x[:, 1:]
    flat = np.stack([np.broadcast_to(S, (len(x), len(S))), np.zeros((len(x), len(S)))], axis=-1)
    across = LOAD / E * 1.5 * np.exp(1.5 * nu) * np.sin(3 * S)
    along = LOAD / E * 2 * nu * np.sin(np.pi * S)
    return np.stack([-(points(x) - flat) / E[..., None], np.stack([0.3 * along, across], axis=-1)], axis=-1)


def training(runs, *, with_gradients=False):
    x = LOW + (HIGH - LOW) * sobol(runs, 2, scramble=1)
    slopes = [{"": row} for row in gradients(x)] if with_gradients else None
    return FieldTraining(x, [{"": Interface.polyline(row)} for row in points(x)], slopes, LOW, HIGH)


TEST_POINTS = LOW + (HIGH - LOW) * sobol(64, 2, scramble=99)
ONE = np.array([300.0, 0.1])


def error(surrogate):
    found = surrogate.points(surrogate.mean(TEST_POINTS))[""]
    return float(np.sqrt(np.mean(np.sum((found - points(TEST_POINTS)) ** 2, axis=2))))


def test_the_error_falls_with_the_runs():
    errors = [error(fit_field(training(runs))) for runs in (8, 16, 32)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]
    assert errors[2] < 2e-3


def test_gradients_lower_the_error_at_equal_runs_unless_their_sign_is_wrong():
    right, plain = training(12, with_gradients=True), error(fit_field(training(12)))
    assert error(fit_field(right)) < 0.4 * plain
    wrong = replace(right, gradients=[{"": -run[""]} for run in right.gradients])
    assert error(fit_field(wrong)) > 3 * plain


def test_what_is_predicted_is_an_interface_of_each_condition():
    """The displacement is straight in 1/E: that warp is found."""
    base = training(12)
    two = [{"light": run[""], "heavy": Interface.polyline(2 * run[""].points)} for run in base.interfaces]
    found = fit_field(replace(base, interfaces=two))
    predicted = found.interfaces(ONE)
    assert list(predicted) == ["light", "heavy"]
    np.testing.assert_allclose(predicted["heavy"].points, 2 * predicted["light"].points, atol=1e-3)
    np.testing.assert_allclose(predicted["light"].points, points(ONE[None])[0], atol=5e-3)
    assert (found.runs, found.registration_error) == (12, 0.0)
    assert found.warping.names == ("reciprocal", "identity")


def test_the_modes_leave_what_the_tolerance_says_and_the_tail_is_added_where_it_is_asked_for():
    """Errors of left-out runs are those of the field, with what the modes leave."""
    found, fine = (fit_field(training(12), tolerance=tolerance) for tolerance in (2e-2, 1e-6))
    assert fine.modes.remainder <= 1e-6 < 1e-4 < found.modes.remainder <= 2e-2
    assert len(found.modes.basis) < len(fine.modes.basis)
    drawn, weights = np.random.default_rng(1).standard_normal((5000, len(found.modes.tail))), found.layouts[""].weights
    coefficients = np.repeat(found.mean(TEST_POINTS[:1]), len(drawn), axis=0)
    with_tail, without = (found.points(coefficients, tail)[""] for tail in (drawn, None))
    rms = np.sqrt(np.mean(np.sum((with_tail - without) ** 2, axis=2) @ weights))
    assert rms == pytest.approx(found.modes.remainder, rel=0.05)
    mean_square = np.sum(found.left_out_fields().reshape(12, 25, 2) ** 2, axis=2) @ weights
    np.testing.assert_allclose(found.left_out_error() ** 2, mean_square + found.modes.remainder**2, rtol=1e-9)


def test_the_predicted_error_is_the_spread_of_drawn_fields():
    found, x, random = fit_field(training(8)), TEST_POINTS[:3], np.random.default_rng(5)
    (layout,), prediction = found.layouts.values(), found.predict(x)
    assert prediction.variance.shape[1] > 1
    for mean, variance, one in zip(prediction.mean, prediction.variance, found.predicted_error(x), strict=True):
        drawn = found.points(mean + np.sqrt(variance) * random.standard_normal((4000, len(mean))))[""]
        along = np.var(drawn, axis=0).sum(axis=1) @ layout.weights
        assert one == pytest.approx(np.sqrt(along + found.modes.remainder**2), rel=0.05)


def test_too_few_runs_and_inputs_that_change_nothing_are_refused():
    for with_gradients, needed in ((False, 5), (True, 3)):
        assert fewest_runs(2, gradients=with_gradients) == needed
        fit_field(training(needed, with_gradients=with_gradients))
        with pytest.raises(TooFewRuns, match=f"at least {needed} for 2 input"):
            fit_field(training(needed - 1, with_gradients=with_gradients))
    base = training(8)
    with pytest.raises(InvalidInput, match="the same one in all 8 runs"):
        fit_field(replace(base, interfaces=[base.interfaces[0]] * 8))


def test_runs_with_other_nodes_are_learnt_from_by_arclength_without_derivatives():
    base = training(16, with_gradients=True)
    uneven = [run[""].resampled(40 + 3 * i) for i, run in enumerate(base.interfaces)]
    turned = [{"": one.reversed() if i % 2 else one} for i, one in enumerate(uneven)]
    found = fit_field(replace(base, interfaces=turned))
    assert (found.ways, found.gradients) == (("arclength",), False)
    assert found.registration_error > 0
    expected = Interface.polyline(points(ONE[None])[0])
    predicted, expected = (one.resampled(41).points for one in (found.interfaces(ONE)[""], expected))
    np.testing.assert_allclose(predicted, expected, atol=5e-3)
    both = [{"a": run[""], "b": one} for run, one in zip(base.interfaces, uneven, strict=True)]
    slopes = [{"a": row[""], "b": row[""]} for row in base.gradients]
    mixed = fit_field(replace(base, interfaces=both, gradients=slopes))
    assert (mixed.ways, mixed.gradients) == (("arclength", "nodes"), False)


def test_scatter_is_the_root_mean_square_of_what_equal_runs_differ_by():
    """Each run is off by two waves along the interface, whose mean squares are half of their variances."""
    base, random = training(60), np.random.default_rng(3)
    off = 2e-3 * random.standard_normal((60, 2)) @ np.stack([np.sin(np.pi * S), np.sin(2 * np.pi * S)])
    moved = np.stack([run[""].points for run in base.interfaces]) + np.stack([0 * off, off], axis=2)
    rough = [{"": Interface.polyline(row)} for row in moved]
    assert fit_field(replace(base, interfaces=rough)).scatter == pytest.approx(2e-3, rel=0.25)


def drawn_mode(seed, train=28, test=40):
    """Return runs of a field whose only coefficient is a draw of a known process, test inputs, and its values there."""
    rng, box = np.random.default_rng(seed), np.array([[-1.0, -1.0], [1.0, 1.0]])
    x = np.concatenate([2 * sobol(train, 2, scramble=seed) - 1, rng.uniform(-1, 1, (test, 2))])
    z = np.sqrt(3.0) * x / np.array([1.0, 1.3])
    K = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2)) + 1e-9 * np.eye(len(z))
    g = np.linalg.cholesky(K) @ rng.standard_normal(len(z))
    fields = np.stack([S, 0 * S], axis=-1) + 0.01 * g[:, None, None] * np.stack([0 * S, np.sin(2 * S)], axis=-1)
    interfaces = [{"": Interface.polyline(row)} for row in fields[:train]]
    return FieldTraining(x[:train], interfaces, None, *box), x[train:], fields[train:]


def test_errors_are_as_large_as_predicted():
    """In the median over seeds, for lengths are estimated; a hundredth or a hundredfold of the variance would show."""
    found = {1.0: [], 0.01: [], 100.0: []}
    for seed in range(12):
        given, x, fields = drawn_mode(seed)
        surrogate = fit_field(given)
        errors = surrogate.points(surrogate.mean(x))[""] - fields
        squares = np.sum(errors**2, axis=2) @ surrogate.layouts[""].weights
        for factor, ratios in found.items():
            planted = tuple(replace(p, widening=p.widening * factor) for p in surrogate.processes)
            ratios.append(np.mean(squares / replace(surrogate, processes=planted).predicted_error(x) ** 2))
    assert [0.5 < np.median(ratios) < 2.0 for ratios in found.values()] == [True, False, False]
