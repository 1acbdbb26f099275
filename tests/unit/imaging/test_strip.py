"""Samples along normals and which of them count; the light of the columns of a picture."""

import numpy as np
import pytest
from tests.unit.imaging.pictures import circle, grid, shadow, steep

from strandline.imaging.course import course_through, smoothed
from strandline.imaging.strip import grey_values, inside_polygon, strip_along
from strandline.imaging.template import columns_levelled

Y = np.array([2.0, 60.0, 117.0])


def test_samples_of_a_plane_are_exact() -> None:
    x, y = grid((50, 80))
    course = course_through(np.array([[10.0, 20], [40, 30], [70, 22]]), closed=False, sigma=3.0)
    for order in (1, 3):
        strip = strip_along(grey_values(2 * x - 3 * y), course, reach=6.0, order=order)
        at = course.at(np.broadcast_to(strip.places, strip.samples.shape))
        np.testing.assert_allclose(strip.samples, 2 * at[..., 0] - 3 * at[..., 1], atol=1e-9 if order == 1 else 0.2)
        assert strip.usable.all()


def test_samples_outside_of_the_picture_do_not_count() -> None:
    course = course_through(np.array([[5.0, 3], [70, 3]]), closed=False, sigma=3.0)
    strip = strip_along(grey_values(np.ones((50, 80))), course, reach=8.0)
    np.testing.assert_array_equal(strip.usable, np.broadcast_to(strip.places <= 3.0, strip.usable.shape))
    assert (strip.samples[~strip.usable] == 0).all()


def test_normals_point_to_the_left_as_seen() -> None:
    along = course_through(np.array([[5.0, 20], [70, 20]]), closed=False, sigma=3.0)
    np.testing.assert_allclose(along.normals, np.broadcast_to([0.0, -1.0], along.normals.shape), atol=1e-12)
    clockwise = course_through(circle(40), closed=True, sigma=5.0)
    assert clockwise.curvatures == pytest.approx(np.full(len(clockwise.points), 1 / 41.0), rel=0.1)
    assert (clockwise.reversed().curvatures < 0).all()


def test_beyond_the_centre_of_a_bend_samples_belong_to_other_normals() -> None:
    course = course_through(circle(40, radius=10.0), closed=True, sigma=2.0)
    inner = -np.array([2.0, 5.0, 12.0, 14.0])
    own = course.own(inner)
    assert own[:, :2].all()
    assert not own[:, 2:].any()
    assert course.own(-inner).all()


def test_the_ends_of_an_open_path_stay_in_place() -> None:
    points = np.array([[5.0, 20], [30, 25], [70, 20]])
    course = smoothed(points, closed=False, sigma=5.0)
    np.testing.assert_allclose(course.points[[0, -1]], points[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(np.diff(course.arc), 1.0, atol=0.02)


def test_interpolation_takes_out_noise_as_it_says() -> None:
    noise = np.random.default_rng(1).standard_normal((100, 400))
    course = course_through(np.array([[10.0, 30], [390, 60]]), closed=False, sigma=3.0)
    strip = strip_along(grey_values(noise), course)
    assert strip.samples.var() == pytest.approx(strip.kept, rel=0.05)


def test_inside_a_polygon() -> None:
    x, y = grid((20, 20))
    inside = inside_polygon(np.stack([x, y], axis=-1), np.array([[4.5, 3.5], [10.5, 3.5], [10.5, 8.5], [4.5, 8.5]]))
    assert inside.sum() == 30
    assert inside[4:9, 5:11].all()


def ratio(slope: float, light: np.ndarray, off: float = 0.0) -> np.ndarray:
    """Return levelled samples over those of the evenly lit picture, if the edge is sought `off` px from its place."""
    course = course_through(np.stack([50 + slope * (Y - 60), Y], axis=1), closed=False, sigma=3.0)
    even = strip_along(grey_values(steep(slope)), course, reach=20.0)
    lit = strip_along(grey_values(steep(slope) * light), course, reach=20.0)
    columns = course.at(np.broadcast_to(even.places, even.samples.shape))[..., 0].round().astype(int)
    profile = even.samples[len(even.samples) // 2]
    offsets = np.full(len(course.points), off)
    expected = np.interp(even.places - offsets[:, None], even.places, profile)
    levelled = columns_levelled(lit, expected, offsets, columns)
    return np.asarray(levelled.samples[even.usable] / even.samples[even.usable])


def test_a_shadow_along_columns_is_taken_out_but_an_edge_sought_two_pixels_off_is_no_shadow() -> None:
    for slope in (0.2, 0.4):
        levelled = ratio(slope, shadow(55.0, width=8.0))
        assert levelled.std() / levelled.mean() < 0.12
    for slope in (0.0, 0.2):
        levelled = ratio(slope, np.ones(100), off=2.0)
        assert levelled.std() / levelled.mean() < 0.05
        assert levelled.mean() == pytest.approx(1.0, abs=0.03)


def test_nothing_is_done_where_nothing_can_be_used() -> None:
    course = course_through(np.stack([np.full(3, 50.0), Y], axis=1), closed=False, sigma=3.0)
    strip = strip_along(grey_values(np.full((120, 100), np.nan)), course, reach=20.0)
    columns = np.full(strip.samples.shape, 50)
    levelled = columns_levelled(strip, np.ones(strip.samples.shape), np.zeros(len(strip.samples)), columns)
    np.testing.assert_array_equal(levelled.samples, strip.samples)
