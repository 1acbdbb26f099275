"""Along an edge: samples on normals and which of them count, the light of columns, the noise, and a random walk."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from tests.unit.imaging.pictures import circle, grid, shadow, steep

from strandline.imaging.course import course_through, smoothed
from strandline.imaging.noise_covariance import noise_covariance, roughness, scatter_of, sum_to_first_zero
from strandline.imaging.random_walk import walk
from strandline.imaging.strip import grey_values, inside_polygon, strip_along
from strandline.imaging.template import columns_levelled

Y = np.array([2.0, 60.0, 117.0])


def course_of(points, sigma=3.0):
    return course_through(np.array(points, float), closed=False, sigma=sigma)


def test_samples_of_a_plane_are_exact_and_those_outside_of_the_picture_do_not_count():
    x, y = grid((50, 80))
    course = course_of([[10, 20], [40, 30], [70, 22]])
    for order, atol in ((1, 1e-9), (3, 0.2)):
        strip = strip_along(grey_values(2 * x - 3 * y), course, reach=6.0, order=order)
        at = course.at(np.broadcast_to(strip.places, strip.samples.shape))
        np.testing.assert_allclose(strip.samples, 2 * at[..., 0] - 3 * at[..., 1], atol=atol)
        assert strip.usable.all()
    strip = strip_along(grey_values(np.ones((50, 80))), course_of([[5, 3], [70, 3]]), reach=8.0)
    np.testing.assert_array_equal(strip.usable, np.broadcast_to(strip.places <= 3.0, strip.usable.shape))
    assert (strip.samples[~strip.usable] == 0).all()
    inside = inside_polygon(np.stack([x, y], axis=-1), np.array([[4.5, 3.5], [10.5, 3.5], [10.5, 8.5], [4.5, 8.5]]))
    assert inside.sum() == 30
    assert inside[4:9, 5:11].all()


def test_normals_point_to_the_left_as_seen_and_the_ends_of_an_open_path_stay_in_place():
    along = course_of([[5, 20], [70, 20]])
    np.testing.assert_allclose(along.normals, np.broadcast_to([0.0, -1.0], along.normals.shape), atol=1e-12)
    clockwise = course_through(circle(40), closed=True, sigma=5.0)
    assert clockwise.curvatures == pytest.approx(np.full(len(clockwise.points), 1 / 41.0), rel=0.1)
    assert (clockwise.reversed().curvatures < 0).all()
    points = np.array([[5.0, 20], [30, 25], [70, 20]])
    course = smoothed(points, closed=False, sigma=5.0)
    np.testing.assert_allclose(course.points[[0, -1]], points[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(np.diff(course.arc), 1.0, atol=0.02)


def test_beyond_the_centre_of_a_bend_samples_belong_to_other_normals():
    course = course_through(circle(40, radius=10.0), closed=True, sigma=2.0)
    inner = -np.array([2.0, 5.0, 12.0, 14.0])
    own = course.own(inner)
    assert own[:, :2].all()
    assert not own[:, 2:].any()
    assert course.own(-inner).all()


def test_interpolation_takes_out_noise_as_it_says():
    noise = np.random.default_rng(1).standard_normal((100, 400))
    strip = strip_along(grey_values(noise), course_of([[10, 30], [390, 60]]))
    assert strip.samples.var() == pytest.approx(strip.kept, rel=0.05)


def ratio(slope, light, off=0.0):
    """Return levelled samples over those of the evenly lit picture, if the edge is sought `off` px from its place."""
    course = course_of(np.stack([50 + slope * (Y - 60), Y], axis=1))
    even, lit = (strip_along(grey_values(steep(slope) * by), course, reach=20.0) for by in (1.0, light))
    columns = course.at(np.broadcast_to(even.places, even.samples.shape))[..., 0].round().astype(int)
    profile, offsets = even.samples[len(even.samples) // 2], np.full(len(course.points), off)
    expected = np.interp(even.places - offsets[:, None], even.places, profile)
    return columns_levelled(lit, expected, offsets, columns).samples[even.usable] / even.samples[even.usable]


def test_a_shadow_along_columns_is_taken_out_but_an_edge_sought_two_pixels_off_is_no_shadow():
    for slope in (0.2, 0.4):
        levelled = ratio(slope, shadow(55.0, width=8.0))
        assert levelled.std() / levelled.mean() < 0.12
    for slope in (0.0, 0.2):
        levelled = ratio(slope, np.ones(100), off=2.0)
        assert levelled.std() / levelled.mean() < 0.05
        assert levelled.mean() == pytest.approx(1.0, abs=0.03)
    nothing = strip_along(grey_values(np.full((120, 100), np.nan)), course_of([[50, y] for y in Y]), reach=20.0)
    shape = nothing.samples.shape
    levelled = columns_levelled(nothing, np.ones(shape), np.zeros(len(nothing.samples)), np.full(shape, 50))
    np.testing.assert_array_equal(levelled.samples, nothing.samples)


PLACES = np.linspace(-8, 8, 33)
BASIS = np.stack([np.exp(-0.5 * PLACES**2), PLACES > 0, PLACES <= 0], axis=1).astype(float)


def correlations(errors):
    return np.array([np.mean(errors[: len(errors) - k] * errors[k:]) for k in range(12)]) / errors.var()


@pytest.mark.parametrize("blur", [(0.0, 0.0), (1.0, 1.5)])
def test_covariance_and_scatter_are_those_of_the_noise_although_a_fit_took_part_of_it_out(blur):
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((20000, 33)), blur, mode="wrap")
    residuals, row = noise - noise @ (BASIS @ np.linalg.pinv(BASIS)).T, np.linalg.pinv(BASIS)[0]
    found = noise_covariance(residuals, np.ones_like(residuals, dtype=bool), BASIS)
    for along in (0, 1, 3):
        for across in (0, 1, 3):
            expected = np.mean(noise[: len(noise) - along, : 33 - across] * noise[along:, across:])
            assert found[along, across] == pytest.approx(expected, abs=0.03 * found[0, 0])
    places = noise @ row
    scatter = scatter_of(places, found, row)
    assert scatter.sd == pytest.approx(places.std(), rel=0.04)
    if any(blur):
        assert scatter.length == pytest.approx(sum_to_first_zero(correlations(places)), rel=0.1)


def test_roughness_makes_up_for_what_the_smooth_line_follows():
    white = np.random.default_rng(3).standard_normal(20000)
    for errors in (white, gaussian_filter1d(white, 1.5)):
        found = roughness(errors + np.linspace(0, 50, 20000), correlations(errors))
        assert found == pytest.approx(errors.std(), rel=0.05)
    assert sum_to_first_zero(np.array([1.0, 0.0, 0.7])) == 0.5
    assert sum_to_first_zero(np.exp(-np.arange(200) / 10.0)) == pytest.approx(10.0, rel=0.01)


def test_the_posterior_is_that_of_a_gaussian_walk_and_normals_that_show_nothing_are_bridged():
    candidates = np.arange(-8.0, 8.01, 0.25)
    seen, sd, drift = np.sin(np.arange(60) / 8.0) + 0.5, 1.5, 0.5
    table = -0.5 * ((seen[:, None] - candidates) / sd) ** 2
    found = walk(table, candidates, drift, draws=2000, random=np.random.default_rng(1))
    steps = np.diff(np.eye(60), axis=0)
    covariance = np.linalg.inv(np.eye(60) / sd**2 + steps.T @ steps / drift**2)
    np.testing.assert_allclose(found.mean, covariance @ seen / sd**2, atol=2e-3)
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=5e-3)
    np.testing.assert_allclose(found.draws.mean(axis=0), found.mean, atol=0.1)
    np.testing.assert_allclose(np.cov(found.draws.T)[30, 25:36], covariance[30, 25:36], rtol=0.12)
    table = -0.5 * ((candidates - 2.0) / 0.3) ** 2 * np.ones((40, 1))
    table[10:30] = 0.0
    found = walk(table, candidates, 0.3)
    np.testing.assert_allclose(found.mean, 2.0, atol=0.02)
    assert found.sd[20] > 2 * found.sd[5]
