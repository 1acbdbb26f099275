"""Errors of the points of an outline against dense algebra, rigid motions and their own statistics."""

import numpy as np
import pytest
from scipy import stats
from tests.unit.discrepancy.curves import graph, line, ring
from tests.unit.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy.normal_offset import signed_distances
from strandline.foundations import InvalidInput
from strandline.interface import Interface, Observation, PointErrors, arc_lengths, point_normals, spacings
from strandline.interface.point_errors import correlated

ALL = PointErrors(0.004, 0.02, shift=0.01, rotation=0.5, scale=0.005, offset=0.003)
OFFSET = PointErrors(0.003, offset=0.003)


def arch(number: int = 200, *, closed: bool = False) -> Interface:
    angle = np.linspace(0.0, 2 * np.pi if closed else np.pi, number, endpoint=not closed)
    return graph(-0.5 * np.cos(angle), 0.4 * np.sin(angle), closed=closed)


@pytest.mark.parametrize("closed", [False, True])
def test_square_and_determinant_are_those_of_the_matrix(closed):
    outline = arch(closed=closed)
    residuals = np.random.default_rng(1).normal(size=(3, len(outline.points)))
    for errors in (ALL, PointErrors(0.01), PointErrors(0.01, 0.1, offset=0.1)):
        model = errors.model(outline)
        C = np.diag(model.local) + model.shared @ model.shared.T
        np.testing.assert_allclose(model.square(residuals), [r @ np.linalg.solve(C, r) for r in residuals], rtol=1e-10)
        assert model.log_det == pytest.approx(np.linalg.slogdet(C)[1], rel=1e-12)
        squares, products = (residuals**2) @ (1 / model.local), residuals @ model.features
        np.testing.assert_allclose(model.square_of(squares, products), model.square(residuals), rtol=1e-10)
        expected = model.shared.T @ np.linalg.solve(C, residuals[0])
        np.testing.assert_allclose(model.shared_errors(residuals[:1] @ model.features)[0], expected, atol=1e-9)


def test_global_errors_move_an_outline_as_a_rigid_body_that_grows():
    """Two outlines move together, as pictures of one camera."""
    errors, middle = PointErrors(0.001, shift=0.1, rotation=20.0, scale=0.01), np.array([0.1, 0.2])
    turn = np.radians(16.0)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    for outline in (arch(20), arch(30)):
        expected = middle + [0.03, -0.12] + 1.015 * (outline.points - middle) @ turned
        found = errors.moved(outline, np.array([0.3, -1.2, 0.8, 1.5]), middle=middle)
        np.testing.assert_allclose(found.points, expected, atol=1e-12)


def test_global_errors_do_to_the_distances_what_moving_the_outline_does():
    """Away from the ends, where the closest point of an open outline is its end."""
    outline, every = arch(400), PointErrors(1e-3, shift=1e-4, rotation=0.01, scale=1e-4, offset=1e-4)
    assert every.global_errors(2) == 5
    for number in range(5):
        found = signed_distances(every.moved(outline, np.eye(5)[number]).points, outline)
        np.testing.assert_allclose(found[20:-20], every.model(outline).shared[20:-20, number], atol=6e-7)


def test_normals_are_those_of_the_outline_and_stay_so_under_noise():
    outline = arch(400)
    exact = point_normals(outline, 1e-6)
    between = 0.5 * (outline.normals[1:] + outline.normals[:-1])
    np.testing.assert_allclose(exact[1:-1], between / np.linalg.norm(between, axis=1, keepdims=True), atol=1e-3)
    noisy = PointErrors(0.004).draw(outline, np.random.default_rng(3))
    turned = np.arccos(np.clip((point_normals(noisy, 0.03) * exact).sum(axis=1), -1, 1))
    segment = np.arccos(np.clip((noisy.normals * outline.normals).sum(axis=1) / noisy.lengths / outline.lengths, -1, 1))
    assert np.degrees(turned.std()) < 12 < np.degrees(segment.std())


def test_parts_on_both_sides_of_a_gap_tell_as_much_as_each_alone():
    """A gap is no long segment that makes the points beside it independent; a point between two gaps is."""
    whole, errors = arch(800), PointErrors(0.002, 0.02)
    parts = [Interface.polyline(whole.points[some]) for some in (slice(0, 300), slice(500, 800))]
    seen = Interface.polyline(np.concatenate([part.points for part in parts]))

    def tells(outline):
        return errors.model(outline).information(np.ones((len(outline.points), 1)))[0, 0]

    assert tells(seen) == pytest.approx(sum(tells(part) for part in parts), rel=1e-3)
    x = np.concatenate([np.linspace(0.0, 0.1, 40), [0.5], np.linspace(0.9, 1.0, 40)])
    assert errors.local_variances(graph(x, 0.0))[40] == pytest.approx(0.002**2)


def test_spacings_add_up_to_the_length_and_errors_do_not_lengthen_it():
    closed, true = arch(50, closed=True), arch(300)
    assert spacings(closed).sum() == pytest.approx(closed.lengths.sum(), rel=1e-2)
    rough = PointErrors(0.7 * float(true.lengths.mean())).draw(true, np.random.default_rng(3))
    assert rough.lengths.sum() > 1.2 * true.lengths.sum()
    assert spacings(rough).mean() == pytest.approx(true.lengths.mean(), rel=0.05)
    assert arc_lengths(closed) == pytest.approx(np.cumsum([0.0, *closed.lengths[:-1]]), rel=1e-3)


def squares(errors: PointErrors, *, stated: PointErrors) -> np.ndarray:
    """Return rᵀ C⁻¹ r of drawn outlines along a slow direction: what inputs are compared by."""
    outline = arch(300)
    model, random = stated.model(outline), np.random.default_rng(7)
    slow = np.cos(np.linspace(0.0, 6.0, 300))
    whitened = slow / model.local - model.projection.T @ (model.projection @ slow)
    drawn = [signed_distances(errors.draw(outline, random).points, outline) for _ in range(120)]
    return np.array(drawn) @ whitened / np.sqrt(slow @ whitened)


@pytest.mark.parametrize("errors", [PointErrors(0.003), PointErrors(0.003, 0.06), OFFSET, ALL])
def test_a_slow_shape_is_known_as_well_as_the_covariance_says_and_errors_left_out_show(errors):
    """Planted: correlated points taken as independent, global errors left out."""
    found = squares(errors, stated=errors)
    assert 0.85 < found.std() < 1.15
    assert stats.kstest(found / found.std(), "norm").pvalue > 1e-3
    stated = errors.local_part if errors in (OFFSET, ALL) else PointErrors(errors.sd)
    assert (squares(errors, stated=stated).std() > 1.5) == (stated != errors)


def test_senseless_errors_are_refused():
    for options, said in (
        ({"sd": 0.0}, "above 0"),
        ({"length": -0.1}, "0 or above"),
        ({"scale": 50.0}, "at most 0.5, a share"),
        ({"rotation": 90.0}, "at most 45 degrees"),
    ):
        with pytest.raises(InvalidInput, match=said):
            PointErrors(**{"sd": 0.01, **options})
    with pytest.raises(InvalidInput, match=r"standard deviation of point 2: got -0.001"):
        PointErrors.of_each([1e-3, -1e-3, 2e-3])
    with pytest.raises(InvalidInput, match="half the length"):
        PointErrors(0.01, 2.0).model(arch())
    PointErrors(0.001, shift=0.5).require_fits(arch(100))
    with pytest.raises(InvalidInput, match=r"shift .* got 50 mm; .* or the unit of the observation"):
        PointErrors(0.001, shift=50.0).require_fits(arch(100))


def test_points_with_their_own_sds():
    """Other numbers of points take the root mean square; one turned round keeps each; no global errors are local."""
    outline, random = arch(200), np.random.default_rng(6)
    sds = np.where(np.arange(200) < 100, 1e-4, 3e-4)
    errors = PointErrors.of_each(sds, length=0.02)
    assert errors.sd == pytest.approx(np.sqrt(5) * 1e-4)
    common = PointErrors(errors.sd, 0.02).model(outline).local
    np.testing.assert_allclose(errors.model(outline).local, (sds / errors.sd) ** 2 * common)
    off = np.array([signed_distances(errors.draw(outline, random).points, outline) for _ in range(60)])
    np.testing.assert_allclose(off.std(axis=0)[5:-5], sds[5:-5], rtol=0.5)
    assert off[:, :95].std() == pytest.approx(1e-4, rel=0.1)
    with pytest.raises(InvalidInput, match="200 standard deviations for 50 points"):
        errors.model(arch(50))
    assert PointErrors.of_each([1e-3, 7e-3], length=0.02).of_points(3) == PointErrors(5e-3, 0.02)
    assert PointErrors.of_each([1e-3, 7e-3], shift=0.1).local_part == PointErrors.of_each([1e-3, 7e-3])
    seen = Observation(line((0, 0), (1, 0), (2, 0.5)), PointErrors.of_each([0.001, 0.002, 0.004], shift=0.01), "a")
    turned = seen.reversed()
    np.testing.assert_allclose(turned.noise.sds(turned.interface), [0.004, 0.002, 0.001])
    np.testing.assert_array_equal(turned.interface.points, seen.interface.points[::-1])


def test_surfaces_have_normals_areas_and_global_errors():
    ball = sphere(0.5, 3)
    assert spacings(ball).sum() == pytest.approx(ball.areas.sum())
    np.testing.assert_allclose(point_normals(ball, 0.05), ball.points / 0.5, atol=0.05)
    model = PointErrors(1e-3, shift=1e-3, rotation=0.1, scale=1e-3, offset=1e-3).model(ball)
    assert model.shared.shape == (len(ball.points), 3 + 3 + 1 + 1)
    np.testing.assert_allclose(model.shared[:, 3:6], 0.0, atol=1e-4)
    np.testing.assert_allclose(model.shared[:, 6], 0.5e-3, rtol=0.02)


def correlations(interface: Interface, length: float) -> np.ndarray:
    drawn = correlated(interface, length, 4000, np.random.default_rng(3))
    return drawn.T @ drawn / 4000


def exponential(interface: Interface, length: float) -> np.ndarray:
    return np.exp(-np.linalg.norm(interface.points[:, None] - interface.points, axis=2) / length)


def test_drawn_errors_have_the_correlations_that_they_should_have():
    """Along a line and over a surface, whose waves are random, too; planted: twice the correlation length."""
    tolerance = 0.1  # more than four standard errors of a correlation from 4000 draws
    uneven, surface = graph(np.linspace(0.0, 1.0, 30) ** 1.5, 0.0), sheet(6, bend=0.1)
    np.testing.assert_allclose(correlations(uneven, 0.2), exponential(uneven, 0.2), atol=tolerance)
    assert np.abs(correlations(uneven, 0.4) - exponential(uneven, 0.2)).max() > 2 * tolerance
    np.testing.assert_allclose(correlations(surface, 0.3), exponential(surface, 0.3), atol=2 * tolerance)
    np.testing.assert_allclose(correlations(uneven, 0.0), np.eye(30), atol=tolerance)
    found = correlations(ring(40), 0.5)[0, [1, -1]]  # the ends of a closed line are far apart
    assert found == pytest.approx([np.exp(-2 * np.sin(np.pi / 40) / 0.5), 0.0], abs=tolerance)


def test_the_variance_of_a_slow_mean_is_that_of_the_drawn_errors():
    """Of n points h apart, from their whole covariance; planted: s² max(1, 2ℓ/h), right in both limits only."""
    number, sd, spacing = 400, 0.002, 4.0 / 399
    outline, slow = graph(np.linspace(0.0, 4.0, number), 0.0), np.sin(np.pi * (np.arange(number) + 0.5) / number)
    for share in (0.0, 0.5, 1.0, 8.0):
        length = share * spacing
        covariance = sd**2 * (exponential(outline, length) if length else np.eye(number))
        exact = slow @ covariance @ slow / (slow @ slow)
        found = PointErrors(sd, length).local_variances(outline)
        assert found.mean() == pytest.approx(exact, rel=0.03)
        if 0.2 < share < 2:
            assert sd**2 * max(1.0, 2 * share) != pytest.approx(exact, rel=0.03)
