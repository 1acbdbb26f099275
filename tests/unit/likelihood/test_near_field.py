"""Residuals near the best fit as polynomials of the field, and the likelihoods that follow from them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, SPACE, TRUTH, arch
from tests.unit.likelihood.near_arches import ALL, GLOBAL, LOCAL, around, by, joint, likelihood, near, widened

from strandline.discrepancy import ClosestPoint, Currents, NormalOffset, signed_distances
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood, compared
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.linearised import linearise
from strandline.likelihood.near_field import BENT, TRUSTED, near_field
from strandline.likelihood.nearby import OfStatedErrors, _ByOffsets
from strandline.likelihood.residuals import residuals_of

WIDENING = {LOCAL: 1e7, GLOBAL: 1e8}
"""Makes the variance of the field count for as much as the noise."""


@pytest.mark.parametrize("errors", ALL)
def test_slopes_and_sums_are_those_of_the_residuals(errors: PointErrors) -> None:
    """Slopes at smooth observed points: elsewhere the registration itself depends a little on the field."""
    smooth, surrogate = JointErrors((Observation(arch(TRUTH), errors),), (errors,)), likelihood(errors).surrogate
    found, size = near_field(surrogate, smooth, near(errors).at), 1e-3

    def exact(coefficients: np.ndarray) -> np.ndarray:
        templates = {name: layout.template for name, layout in surrogate.layouts.items()}
        return residuals_of(smooth, surrogate.points(coefficients), templates)

    steps = np.concatenate([size * np.eye(len(found.at)), -size * np.eye(len(found.at))])
    moved = exact(found.at + steps)
    differences = (moved[: len(found.at)] - moved[len(found.at) :]) / (2 * size)
    tolerance = 0.05 if errors is GLOBAL else 1e-3
    np.testing.assert_allclose(found.slopes.T, differences, atol=tolerance * np.abs(found.slopes).max())
    np.testing.assert_allclose(found.residuals, exact(found.at[None])[0], atol=0.02 * SD)

    field = near(errors)
    z = 1e-5 * np.random.default_rng(4).standard_normal((5, len(field.at)))
    pairs = np.array([[a * b for k, a in enumerate(row) for b in row[k:]] for row in z])
    r = field.residuals + z @ field.slopes.T + pairs @ field.bends.T
    squares, products = field.sums(field.at + z)
    assert np.abs(pairs @ field.bends.T).max() > 1e-10
    np.testing.assert_allclose(squares, (r**2 / field.model.local).sum(axis=1))
    np.testing.assert_allclose(products, r @ field.model.features, rtol=1e-9, atol=1e-9)


def test_what_the_modes_leave_has_slopes_of_its_own() -> None:
    """Between the ends: beyond them the outline goes on straight, and turns with what is random from node to node."""
    found = likelihood(LOCAL).surrogate
    rows = np.random.default_rng(3).standard_normal((3, found.modes.basis.shape[1]))
    surrogate = replace(found, modes=replace(found.modes, tail=0.01 * np.linalg.qr(rows.T)[0].T))
    smooth, at = JointErrors((Observation(arch(TRUTH), LOCAL),), (LOCAL,)), near(LOCAL).at
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}
    steps = 1e-2 * np.concatenate([np.eye(3), -np.eye(3)])
    moved = residuals_of(smooth, surrogate.points(np.tile(at, (6, 1)), steps), templates)
    slopes = near_field(surrogate, smooth, at).tail.T
    assert slopes.shape[0] == 3
    exact = (moved[:3] - moved[3:]) / 2e-2
    np.testing.assert_allclose(slopes[:, 1:-1], exact[:, 1:-1], atol=1e-3 * np.abs(slopes).max())


def test_bends_are_second_derivatives() -> None:
    """On average: those of the polyline itself are nothing but kinks at its nodes."""
    surrogate = likelihood(LOCAL).surrogate
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}
    smooth = JointErrors((Observation(arch(TRUTH).resampled(1201), LOCAL),), (LOCAL,))
    found, size = near_field(surrogate, smooth, near(LOCAL).at), 0.04
    one, other = np.triu_indices(len(found.at))
    step = size * np.eye(len(found.at))

    def off(z: np.ndarray) -> np.ndarray:
        r = residuals_of(smooth, surrogate.points(found.at + z), templates)
        return np.asarray(r - found.residuals - z @ found.slopes.T)

    pairs = step[one] + step[other]
    expected = np.array([found.bends @ [a * b for k, a in enumerate(z) for b in z[k:]] for z in pairs])
    differences = 0.5 * (off(pairs) + off(-pairs))[:, 60:-60]
    assert np.abs(differences - expected[:, 60:-60]).mean() < 0.15 * np.abs(differences).mean()


def test_bends_count_by_half_where_they_are_as_large_as_is_trusted() -> None:
    found = near(LOCAL)
    z = np.random.default_rng(6).standard_normal(len(found.at))
    one, other = np.triu_indices(min(len(found.at), BENT))
    ahead, bent = found.slopes @ z, found.bends @ (z[one] * z[other])
    size = TRUSTED * np.sqrt((ahead**2 @ (1 / found.model.local)) / (bent**2 @ (1 / found.model.local)))
    _, share = found.bending(np.array([size * z, 1e-3 * size * z]))
    np.testing.assert_allclose(share, [0.5, 1.0], atol=1e-5)


def test_where_nothing_can_be_followed_there_is_no_likelihood_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    """The centre rule of currents follows no offsets; residuals that are not finite are of no use."""
    assert by(Currents(0.03, quadrature="centre")).nearby is None
    lin = linearise(likelihood(LOCAL).surrogate, joint(LOCAL))
    broken = replace(lin, field=replace(lin.field, slopes=np.full_like(lin.field.slopes, np.nan)))
    monkeypatch.setattr("strandline.likelihood.nearby.linearise", lambda *given: broken)
    assert replace(likelihood(LOCAL)).nearby is None


@pytest.mark.parametrize("errors", ALL)
def test_fields_drawn_nearby_are_as_good(errors: PointErrors) -> None:
    found, x = widened(likelihood(errors), WIDENING[errors]), around(errors)
    some, exact = found.expected(x, plug_in=found.plug_in(x)), found.expected(x)
    assert np.abs(exact - found.plug_in(x)).max() > 0.5
    assert (some != exact).all()
    assert (np.abs(some - exact) <= 0.1 + 0.1 * (exact.max() - exact)).all()


def test_a_neighbour_that_is_wrong_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: slopes that are half as large again."""
    found, x = widened(likelihood(LOCAL), WIDENING[LOCAL]), around(LOCAL)
    right = near(LOCAL)
    wrong = OfStatedErrors(replace(right, slopes=1.5 * right.slopes), right.model)
    monkeypatch.setattr(FieldLikelihood, "nearby", wrong)
    np.testing.assert_array_equal(found.expected(x, plug_in=found.plug_in(x)), found.expected(x))


def off(found: FieldLikelihood, x: np.ndarray) -> np.ndarray:
    """Return how much log L nearby is off, but for a constant."""
    assert found.nearby is not None
    return np.asarray(found.nearby.log_likelihood(found.surrogate.mean(x)) - found.plug_in(x))


def test_it_leads_to_the_posterior() -> None:
    for errors in (LOCAL, GLOBAL, UnknownErrors()):
        x = around(errors if isinstance(errors, PointErrors) else LOCAL, 100)
        assert np.ptp(off(likelihood(errors), x)) < 1.0


def test_other_measures_follow_offsets() -> None:
    x = around(LOCAL, 60)
    for measure in (
        Currents(0.03),
        ClosestPoint(direction="to_observed", weighting="length"),
        ClosestPoint(direction="symmetric"),
        NormalOffset(),
    ):
        found = by(measure)
        values = found.plug_in(x)
        near_best = values > values.max() - 6
        assert near_best.sum() > 10
        assert np.ptp(values[near_best]) > 2
        assert np.ptp(off(found, x)[near_best]) < 0.2 * np.ptp(values[near_best])


def test_fields_of_another_measure_are_drawn_nearby(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: forty times the squares of offsets, which shows, and moves nothing but the draws."""
    measure = Currents(0.03)
    found, x = widened(by(measure, 0.004), 1e7), around(LOCAL, 60)
    some = found.expected(x, plug_in=found.plug_in(x))
    exact = found._drawn(found.surrogate.predict(x))
    assert np.abs(exact - found.plug_in(x)).max() > 0.2
    assert (some != exact).any()
    np.testing.assert_allclose(some[exact > exact.max() - 6], exact[exact > exact.max() - 6], atol=0.2)
    monkeypatch.setattr(type(measure), "of_offsets", lambda *given: 40 * (given[1] ** 2).sum(axis=1))
    planted = replace(found)
    np.testing.assert_array_equal(planted.expected(x, plug_in=found.plug_in(x)), planted.expected(x))
    np.testing.assert_allclose(planted.expected(x), exact, atol=0.5)
    np.testing.assert_array_equal(found.expected(x), exact)


def test_the_best_inputs_fit_best() -> None:
    lin = linearise(likelihood(GLOBAL).surrogate, joint(GLOBAL))
    grid = SPACE.prior_quantiles(np.random.default_rng(6).random((2000, 2)))
    assert joint(GLOBAL).model.square(lin.residuals) <= -2 * likelihood(GLOBAL).plug_in(grid).max() + 0.1
    at = near_field(likelihood(GLOBAL).surrogate, joint(GLOBAL), lin.field.at)
    np.testing.assert_array_equal(at.slopes, lin.field.slopes)


def test_weights_of_offsets_do_not_depend_on_their_side_and_small_ones_take_the_typical_size() -> None:
    """The norm of currents of width σ grows with each offset r as 1 - exp(-r²/2σ²)."""
    width, line = 0.05, Interface.polyline(np.stack([np.linspace(0.0, 2.0, 41), np.zeros(41)], axis=1))
    of = _ByOffsets(compared(Observation(line, 1e-4), Currents(width), 41), 41)
    r = np.zeros(41)
    r[10], r[30] = 0.12, -0.12
    found, typical = of.weights(r), float(np.sqrt(np.mean(r**2)))
    np.testing.assert_allclose(found, of.weights(-r))
    assert found[10] == pytest.approx(found[30])
    share = [(1 - np.exp(-(size**2) / (2 * width**2))) / size**2 for size in (typical, 0.12)]
    assert found[20] / found[10] == pytest.approx(share[0] / share[1], rel=1e-3)


def test_a_shifted_observation_is_followed_even_if_some_points_do_not_feel_the_shift() -> None:
    """Half of the interface is flat: its signed distances do not change with a shift along it."""
    s = np.linspace(0.0, 2.0, 401)
    y = np.where(s > 1, 0.3 * np.sin(np.pi * np.maximum(s - 1, 0.0)) ** 2, 0.0)
    true = Interface.polyline(np.stack([s, y], axis=1))
    errors, shift = PointErrors(1e-3, shift=0.05), np.array([0.05, 0.0])
    seen = Interface.polyline(true.points[40:-40] + shift)
    found = JointErrors((Observation(seen, errors),), (errors,))
    (r,) = residuals_of(found, {"": true.points[None]}, {"": true})
    assert not found.model.shared.all()
    by_shift = found.model.shared @ np.array([1.0, 0.0])
    np.testing.assert_allclose(r, by_shift, atol=2e-3)
    assert np.abs(signed_distances(seen.points, true) - by_shift).max() > 4e-3
