"""The light of the columns of a picture."""

import numpy as np
import pytest
from tests.imaging.pictures import shadow, steep

from strandline.imaging.course import course_through
from strandline.imaging.strip import grey_values, strip_along
from strandline.imaging.template import columns_levelled

Y = np.array([2.0, 60.0, 117.0])


def _ratio(slope: float, light: np.ndarray, off: float = 0.0) -> np.ndarray:
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


@pytest.mark.parametrize("slope", [0.2, 0.4])
def test_a_shadow_along_columns_is_taken_out_of_a_steep_flank(slope: float) -> None:
    ratio = _ratio(slope, shadow(55.0, width=8.0))
    assert ratio.std() / ratio.mean() < 0.12


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_an_edge_sought_two_pixels_off_is_not_taken_for_a_shadow(slope: float) -> None:
    ratio = _ratio(slope, np.ones(100), off=2.0)
    assert ratio.std() / ratio.mean() < 0.05
    assert ratio.mean() == pytest.approx(1.0, abs=0.03)


def test_nothing_is_done_where_nothing_can_be_used() -> None:
    course = course_through(np.stack([np.full(3, 50.0), Y], axis=1), closed=False, sigma=3.0)
    strip = strip_along(grey_values(np.full((120, 100), np.nan)), course, reach=20.0)
    columns = np.full(strip.samples.shape, 50)
    levelled = columns_levelled(strip, np.ones(strip.samples.shape), np.zeros(len(strip.samples)), columns)
    np.testing.assert_array_equal(levelled.samples, strip.samples)
