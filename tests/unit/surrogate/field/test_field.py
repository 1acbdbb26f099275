"""The surrogate of the interface on a displacement with a closed form: V/E times a shape that depends on ν."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from strandline.design import sobol
from strandline.errors import InvalidInput, TooFewRuns
from strandline.interface import Interface
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fewest_runs, fit_field
from strandline.surrogate.field.modes import Modes

LOW, HIGH = np.array([100.0, -0.8]), np.array([800.0, 0.5])
S = np.linspace(0.0, 1.0, 25)
LOAD = 40.0


def points(x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run point xyz"]:
    """Return the nodes: displaced along by a sine, across by a bent shape that widens with ν."""
    E, nu = x[:, :1], x[:, 1:]
    across = LOAD / E * (S**2 * (3 - S) + np.exp(1.5 * nu) * np.sin(3 * S))
    along = LOAD / E * nu**2 * np.sin(np.pi * S)
    return np.stack([S + 0.3 * along, across], axis=-1)


def gradients(x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run point xyz dim"]:
    E, nu = x[:, :1], x[:, 1:]
    flat = np.stack([np.broadcast_to(S, (len(x), len(S))), np.zeros((len(x), len(S)))], axis=-1)
    by_modulus = -(points(x) - flat) / E[..., None]
    across = LOAD / E * 1.5 * np.exp(1.5 * nu) * np.sin(3 * S)
    along = LOAD / E * 2 * nu * np.sin(np.pi * S)
    return np.stack([by_modulus, np.stack([0.3 * along, across], axis=-1)], axis=-1)


def training(runs: int, *, with_gradients: bool = False, scramble: int | None = 1) -> FieldTraining:
    x = LOW + (HIGH - LOW) * sobol(runs, 2, scramble=scramble)
    interfaces = [{"": Interface.polyline(row)} for row in points(x)]
    slopes = [{"": row} for row in gradients(x)] if with_gradients else None
    return FieldTraining(x, interfaces, slopes, LOW, HIGH)


TEST_POINTS = LOW + (HIGH - LOW) * sobol(64, 2, scramble=99)


def error(surrogate: FieldSurrogate) -> float:
    found = surrogate.points(surrogate.mean(TEST_POINTS))[""]
    return float(np.sqrt(np.mean(np.sum((found - points(TEST_POINTS)) ** 2, axis=2))))


def test_the_derivatives_of_this_file_are_right() -> None:
    for j in range(2):
        h = 1e-5 * (HIGH - LOW) * np.eye(2)[j]
        differences = (points(TEST_POINTS + h) - points(TEST_POINTS - h)) / (2 * h[j])
        np.testing.assert_allclose(gradients(TEST_POINTS)[..., j], differences, rtol=1e-6, atol=1e-9)


def test_the_error_falls_with_the_runs() -> None:
    errors = [error(fit_field(training(runs))) for runs in (8, 16, 32)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]
    assert errors[2] < 2e-3


def test_gradients_lower_the_error_at_equal_runs() -> None:
    for runs in (8, 16):
        plain, helped = (error(fit_field(training(runs, with_gradients=given))) for given in (False, True))
        assert helped < 0.4 * plain


def test_gradients_of_the_wrong_sign_are_worse_than_none() -> None:
    right = training(12, with_gradients=True)
    assert right.gradients is not None
    wrong = replace(right, gradients=[{"": -run[""]} for run in right.gradients])
    assert error(fit_field(wrong)) > 3 * error(fit_field(training(12)))


def test_a_stiffness_enters_straight() -> None:
    """The displacement is straight in 1/E: that warp is found, and is better than none."""
    found = fit_field(training(14))
    assert found.warping.names == ("reciprocal", "identity")


def test_what_is_predicted_is_an_interface_of_each_condition() -> None:
    base = training(12)
    two = [{"light": run[""], "heavy": Interface.polyline(2 * run[""].points)} for run in base.interfaces]
    found = fit_field(replace(base, interfaces=two))
    x = np.array([300.0, 0.1])
    predicted = found.interfaces(x)
    assert list(predicted) == ["light", "heavy"]
    np.testing.assert_allclose(predicted["heavy"].points, 2 * predicted["light"].points, atol=1e-3)
    np.testing.assert_allclose(predicted["light"].points, points(x[None])[0], atol=5e-3)
    assert found.runs == 12
    assert found.registration_error == 0.0


def test_left_out_errors_are_those_of_the_field() -> None:
    found = fit_field(training(12))
    fields = found.left_out_fields().reshape(12, 25, 2)
    weights = found.layouts[""].weights
    mean_square = np.sum(fields**2, axis=2) @ weights
    np.testing.assert_allclose(found.left_out_error() ** 2, mean_square + found.modes.remainder**2, rtol=1e-9)


def test_the_tail_is_added_where_it_is_asked_for() -> None:
    found = fit_field(training(12), tolerance=2e-2)
    assert found.modes.remainder > 1e-4
    rest = len(found.modes.tail)
    drawn = np.random.default_rng(1).standard_normal((20000, rest))
    coefficients = np.repeat(found.mean(TEST_POINTS[:1]), len(drawn), axis=0)
    with_tail, without = (found.points(coefficients, tail)[""] for tail in (drawn, None))
    weights = found.layouts[""].weights
    rms = np.sqrt(np.mean(np.sum((with_tail - without) ** 2, axis=2) @ weights))
    assert rms == pytest.approx(found.modes.remainder, rel=0.03)


def drawn_mode(seed: int, train: int = 28, test: int = 40) -> tuple[FieldTraining, np.ndarray, np.ndarray]:
    """Return runs of a field whose only coefficient is a draw of a known process, test inputs, and its values there."""
    rng = np.random.default_rng(seed)
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    x = np.concatenate([2 * sobol(train, 2, scramble=seed) - 1, rng.uniform(-1, 1, (test, 2))])
    z = np.sqrt(3.0) * x / np.array([1.0, 1.3])
    K = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2)) + 1e-9 * np.eye(len(z))
    g = np.linalg.cholesky(K) @ rng.standard_normal(len(z))
    shape = np.stack([np.zeros_like(S), np.sin(2 * S)], axis=-1)
    flat = np.stack([S, np.zeros_like(S)], axis=-1)
    fields = flat + 0.01 * g[:, None, None] * shape
    interfaces = [{"": Interface.polyline(row)} for row in fields[:train]]
    return FieldTraining(x[:train], interfaces, None, low, high), x[train:], fields[train:]


def surprise(seed: int, factor: float) -> float:
    """Return the mean of (true error)²/(predicted error)² of the field at test points; `factor` plants a bug."""
    given, x, fields = drawn_mode(seed)
    found = fit_field(given)
    found = replace(found, processes=tuple(replace(p, widening=p.widening * factor) for p in found.processes))
    errors = np.sum((found.points(found.mean(x))[""] - fields) ** 2, axis=2) @ found.layouts[""].weights
    return float(np.mean(errors / found.predicted_error(x) ** 2))


def calibrated(ratios: list[float]) -> bool:
    """Tell whether errors are as large as predicted, over seeds: within a factor of √2 in standard deviation.

    Length scales are estimated, so that single seeds are off by more; with few runs so are most of them.
    """
    return 0.5 < float(np.median(ratios)) < 2.0


def test_errors_are_as_large_as_predicted() -> None:
    assert calibrated([surprise(seed, 1.0) for seed in range(20)])


def test_a_variance_of_a_hundredth_shows() -> None:
    assert not calibrated([surprise(seed, 0.01) for seed in range(6)])
    assert not calibrated([surprise(seed, 100.0) for seed in range(6)])


def test_the_predicted_error_is_the_spread_of_drawn_fields() -> None:
    found, x, random = fit_field(training(8)), TEST_POINTS[:3], np.random.default_rng(5)
    (layout,), prediction = found.layouts.values(), found.predict(x)
    assert prediction.variance.shape[1] > 1
    for mean, variance, one in zip(prediction.mean, prediction.variance, found.predicted_error(x), strict=True):
        drawn = found.points(mean + np.sqrt(variance) * random.standard_normal((4000, len(mean))))[""]
        along = np.var(drawn, axis=0).sum(axis=1) @ layout.weights
        assert one == pytest.approx(np.sqrt(along + found.modes.remainder**2), rel=0.05)


@pytest.mark.parametrize("with_gradients", [False, True])
def test_too_few_runs_are_refused(with_gradients: bool) -> None:
    needed = fewest_runs(2, gradients=with_gradients)
    assert needed == (3 if with_gradients else 5)
    fit_field(training(needed, with_gradients=with_gradients))
    with pytest.raises(TooFewRuns, match=f"at least {needed} for 2 input"):
        fit_field(training(needed - 1, with_gradients=with_gradients))


def test_inputs_that_change_nothing_are_refused() -> None:
    base = training(8)
    with pytest.raises(InvalidInput, match="the same one in all 8 runs"):
        fit_field(replace(base, interfaces=[base.interfaces[0]] * 8))


def test_runs_with_other_nodes_are_learnt_from_by_arclength() -> None:
    base = training(16, with_gradients=True)
    uneven = [
        {"": run[""].resampled(40 + 3 * i).reversed() if i % 2 else run[""].resampled(40 + 3 * i)}
        for i, run in enumerate(base.interfaces)
    ]
    found = fit_field(replace(base, interfaces=uneven))
    assert found.layouts[""].way == "arclength"
    assert not found.gradients
    assert found.registration_error > 0
    predicted = found.interfaces(np.array([300.0, 0.1]))[""].resampled(41).points
    expected = Interface.polyline(points(np.array([[300.0, 0.1]]))[0]).resampled(41).points
    np.testing.assert_allclose(predicted, expected, atol=5e-3)


def test_the_modes_may_leave_what_the_tolerance_says() -> None:
    one: Modes = fit_field(training(20), tolerance=2e-2).modes
    fine: Modes = fit_field(training(20), tolerance=1e-6).modes
    assert fine.remainder <= 1e-6 < one.remainder <= 2e-2
    assert len(one.basis) < len(fine.basis)


def test_scatter_is_the_root_mean_square_of_what_equal_runs_differ_by() -> None:
    """Each run is off by two waves along the interface, whose mean squares are half of their variances."""
    base, random = training(60), np.random.default_rng(3)
    waves = np.stack([np.sin(np.pi * S), np.sin(2 * np.pi * S)])
    off = 2e-3 * random.standard_normal((60, 2)) @ waves
    rough = [
        {"": Interface.polyline(run[""].points + np.stack([0 * S, row], axis=1))}
        for run, row in zip(base.interfaces, off, strict=True)
    ]
    assert fit_field(replace(base, interfaces=rough)).scatter == pytest.approx(2e-3, rel=0.25)


def test_derivatives_are_used_only_if_the_nodes_of_all_conditions_correspond() -> None:
    base = training(16, with_gradients=True)
    assert base.gradients is not None
    both = [{"a": run[""], "b": run[""].resampled(40 + 3 * i)} for i, run in enumerate(base.interfaces)]
    slopes = [{"a": row[""], "b": row[""]} for row in base.gradients]
    found = fit_field(replace(base, interfaces=both, gradients=slopes))
    assert found.ways == ("arclength", "nodes")
    assert not found.gradients
