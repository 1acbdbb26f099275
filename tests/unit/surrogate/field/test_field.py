"""The surrogate of the interface on a displacement with a closed form: V/E times a shape that depends on ν."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from strandline.design import sobol
from strandline.errors import InvalidInput, TooFewRuns
from strandline.interface import Interface
from strandline.surrogate.field import FieldSurrogate, FieldTraining, fewest_runs, fit_field

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


@pytest.fixture(scope="module")
def learnt() -> FieldSurrogate:
    """The surrogate of a dozen runs."""
    return fit_field(training(12))


def test_the_error_falls_with_the_runs() -> None:
    errors = [error(fit_field(training(runs))) for runs in (8, 16, 32)]
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]
    assert errors[2] < 2e-3


def test_gradients_lower_the_error_at_equal_runs_unless_their_sign_is_wrong(learnt: FieldSurrogate) -> None:
    for j, h in enumerate(1e-5 * np.diag(HIGH - LOW)):
        differences = (points(TEST_POINTS + h) - points(TEST_POINTS - h)) / (2 * h[j])
        np.testing.assert_allclose(gradients(TEST_POINTS)[..., j], differences, rtol=1e-6, atol=1e-9)
    right = training(12, with_gradients=True)
    assert right.gradients is not None
    assert error(fit_field(right)) < 0.4 * error(learnt)
    wrong = replace(right, gradients=[{"": -run[""]} for run in right.gradients])
    assert error(fit_field(wrong)) > 3 * error(learnt)


def test_what_is_predicted_is_an_interface_of_each_condition() -> None:
    """The displacement is straight in 1/E: that warp is found."""
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
    assert found.warping.names == ("reciprocal", "identity")


def test_left_out_errors_are_those_of_the_field(learnt: FieldSurrogate) -> None:
    fields = learnt.left_out_fields().reshape(12, 25, 2)
    mean_square = np.sum(fields**2, axis=2) @ learnt.layouts[""].weights
    np.testing.assert_allclose(learnt.left_out_error() ** 2, mean_square + learnt.modes.remainder**2, rtol=1e-9)


def test_the_modes_leave_what_the_tolerance_says_and_the_tail_is_added_where_it_is_asked_for() -> None:
    found, fine = (fit_field(training(12), tolerance=tolerance) for tolerance in (2e-2, 1e-6))
    assert fine.modes.remainder <= 1e-6 < 1e-4 < found.modes.remainder <= 2e-2
    assert len(found.modes.basis) < len(fine.modes.basis)
    drawn = np.random.default_rng(1).standard_normal((5000, len(found.modes.tail)))
    coefficients = np.repeat(found.mean(TEST_POINTS[:1]), len(drawn), axis=0)
    with_tail, without = (found.points(coefficients, tail)[""] for tail in (drawn, None))
    rms = np.sqrt(np.mean(np.sum((with_tail - without) ** 2, axis=2) @ found.layouts[""].weights))
    assert rms == pytest.approx(found.modes.remainder, rel=0.05)


def drawn_mode(seed: int, train: int = 28, test: int = 40) -> tuple[FieldTraining, np.ndarray, np.ndarray]:
    """Return runs of a field whose only coefficient is a draw of a known process, test inputs, and its values there."""
    rng = np.random.default_rng(seed)
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    x = np.concatenate([2 * sobol(train, 2, scramble=seed) - 1, rng.uniform(-1, 1, (test, 2))])
    z = np.sqrt(3.0) * x / np.array([1.0, 1.3])
    K = np.exp(-0.5 * np.sum((z[:, None] - z) ** 2, axis=2)) + 1e-9 * np.eye(len(z))
    g = np.linalg.cholesky(K) @ rng.standard_normal(len(z))
    flat, shape = np.stack([S, 0 * S], axis=-1), np.stack([0 * S, np.sin(2 * S)], axis=-1)
    fields = flat + 0.01 * g[:, None, None] * shape
    interfaces = [{"": Interface.polyline(row)} for row in fields[:train]]
    return FieldTraining(x[:train], interfaces, None, low, high), x[train:], fields[train:]


def test_errors_are_as_large_as_predicted() -> None:
    """Over seeds, within a factor of √2 in standard deviation; planted variances of a hundredth or a hundredfold show.

    Length scales are estimated, so that single seeds are off by more.
    """
    found: dict[float, list[float]] = {1.0: [], 0.01: [], 100.0: []}
    for seed in range(12):
        given, x, fields = drawn_mode(seed)
        surrogate = fit_field(given)
        errors = surrogate.points(surrogate.mean(x))[""] - fields
        squares = np.sum(errors**2, axis=2) @ surrogate.layouts[""].weights
        for factor, ratios in found.items():
            planted = tuple(replace(p, widening=p.widening * factor) for p in surrogate.processes)
            predicted = replace(surrogate, processes=planted).predicted_error(x)
            ratios.append(float(np.mean(squares / predicted**2)))
    assert [0.5 < np.median(ratios) < 2.0 for ratios in found.values()] == [True, False, False]


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


def test_runs_with_other_nodes_are_learnt_from_by_arclength_without_derivatives() -> None:
    base = training(16, with_gradients=True)
    assert base.gradients is not None
    uneven = [run[""].resampled(40 + 3 * i) for i, run in enumerate(base.interfaces)]
    turned = [{"": one.reversed() if i % 2 else one} for i, one in enumerate(uneven)]
    found = fit_field(replace(base, interfaces=turned))
    assert found.layouts[""].way == "arclength"
    assert not found.gradients
    assert found.registration_error > 0
    predicted = found.interfaces(np.array([300.0, 0.1]))[""].resampled(41).points
    expected = Interface.polyline(points(np.array([[300.0, 0.1]]))[0]).resampled(41).points
    np.testing.assert_allclose(predicted, expected, atol=5e-3)
    both = [{"a": run[""], "b": one} for run, one in zip(base.interfaces, uneven, strict=True)]
    mixed = fit_field(
        replace(base, interfaces=both, gradients=[{"a": row[""], "b": row[""]} for row in base.gradients])
    )
    assert mixed.ways == ("arclength", "nodes")
    assert not mixed.gradients


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
