"""What is known of an edge: from several frames of one state, and through the smooth outline along it."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from tests.unit.imaging.pictures import straight

from strandline.foundations import InvalidInput
from strandline.imaging import Picture, errors_from_frames, find_edge, outline_of
from strandline.imaging.frame_errors import _longest

PIXEL = (0.01, 0.01)
SHAPE = (60, 240)
PATH = np.array([[3.0, 30.0], [120.0, 30.0], [236.0, 30.0]])


def picture(values):
    return Picture(values, PIXEL, "frame", "0")


def frames(number, *, noise=0.1, wave=0.0, reach=3.0):
    """Return frames of a straight edge with noise of the pixels and waves of their own along it, px."""
    out = []
    for seed in range(number):
        random = np.random.default_rng(seed)
        waves = gaussian_filter1d(random.standard_normal(SHAPE[1] + 100), reach)[50:-50] * wave
        at = 30.3 + waves * np.sqrt(2 * reach * np.sqrt(np.pi))
        out.append(picture(straight(SHAPE, at=at) + noise * random.standard_normal(SHAPE)))
    return out


def compared(given):
    """Return the edge in the mean of frames, and what the frames show of its errors."""
    mean = np.mean([one.values for one in given], axis=0)
    edge = find_edge(mean, PATH, pixel=PIXEL)
    return edge, errors_from_frames(given, edge, number=len(given))


def test_noise_of_the_pixels_shows_alike_in_the_frames_and_in_their_mean():
    edge, found = compared(frames(9, noise=0.3))
    off = PIXEL[0] * float(np.std(edge.points[:, 1]))
    assert found.mean.sd == pytest.approx(off, rel=0.2)
    assert found.mean.sd == pytest.approx(edge.errors.sd, rel=0.2)
    assert found.one.sd == pytest.approx(3 * found.mean.sd)
    assert (found.frames, found.compared, found.one.length) == (9, 9, found.mean.length)


def test_waves_that_differ_from_frame_to_frame_show_only_in_the_frames():
    """The truth is s 0.3 px and ℓ = √π · 3 px in one frame; the mean picture alone sees little of it."""
    edge, found = compared(frames(8, wave=0.3))
    level = (0.3 * PIXEL[0]) ** 2 * np.sqrt(np.pi) * 3 * PIXEL[0] / 8
    assert found.larger
    assert found.mean.sd**2 * found.mean.length == pytest.approx(level, rel=0.4)
    assert edge.errors.level < 0.3 * level
    taken = found.put_into(edge).errors
    assert (taken.sd, taken.length) == (found.mean.sd, found.mean.length)
    assert taken.offset == pytest.approx(np.hypot(edge.errors.offset, found.mean.offset))


def test_what_all_frames_share_shows_in_none_and_the_picture_alone_is_taken():
    """The same waves in each frame, as of speckle at rest."""
    shared, random = frames(1, noise=0.0, wave=0.6, reach=1.0)[0].values, np.random.default_rng(5)
    edge, found = compared([picture(shared + 0.02 * random.standard_normal(SHAPE)) for _ in range(6)])
    assert not found.larger
    assert found.mean.sd < 0.3 * edge.errors.sd
    assert found.put_into(edge).errors.sd == edge.errors.sd


def test_frames_that_show_no_errors_are_refused():
    few = frames(4)
    noise = picture(np.random.default_rng(1).standard_normal(SHAPE))
    for given, said in (
        (few[:1], "number of contours"),
        (few[:1] * 3, "identical"),
        ([*frames(8), noise], "frame 9 by itself"),
    ):
        with pytest.raises(InvalidInput, match=said):
            compared(given)


SD, LENGTH = 0.003, 0.03
ANGLE = np.linspace(np.pi, 0.0, 401)
ARCH = np.stack([1.0 + 0.4 * np.cos(ANGLE), 0.3 * np.sin(ANGLE)], axis=1)
"""An arch from the floor to the floor, mm."""
CLICKS = ARCH[::40] + 0.006 * np.random.default_rng(0).standard_normal((11, 2)) * [[1.0, 0.0]]


def arch_edge(seed):
    """Return the inner 90 % of the arch with correlated noise along its normals."""
    along = np.gradient(ARCH, axis=0)
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    noise = gaussian_filter1d(np.random.default_rng(seed).standard_normal(len(ARCH)), 6.0, mode="wrap")
    noise *= SD * np.sqrt(2 * np.sqrt(np.pi) * 6.0)
    return (ARCH + noise[:, None] * normals)[20:-20]


@lru_cache
def outline(seed):
    """Return the outline; the integral of the noise's correlation is 2 × LENGTH."""
    spacing = float(np.median(np.linalg.norm(np.diff(ARCH, axis=0), axis=1)))
    return outline_of(arch_edge(seed), CLICKS, sd=SD, length=np.sqrt(np.pi) * 6.0 * spacing)


def off_arch(found):
    """Return the distances of the outline's inner points from the arch, mm."""
    radial = np.hypot((found.points[:, 0] - 1.0) / 0.4, found.points[:, 1] / 0.3)
    angle = np.arctan2(found.points[:, 1] / 0.3, (found.points[:, 0] - 1.0) / 0.4)
    return ((radial - 1.0) * 0.12 / np.hypot(0.3 * np.cos(angle), 0.4 * np.sin(angle)))[30:-30]


def test_the_errors_of_an_outline_are_its_own():
    """Half or twice what they are would show."""
    found = [outline(seed) for seed in range(7)]
    ratio = np.sqrt(np.mean(np.concatenate([off_arch(one) / one.sd for one in found]) ** 2))
    assert [0.7 < by * ratio < 1.35 for by in (0.5, 1.0, 2.0)] == [False, True, False]


def test_an_outline_stands_on_the_floor():
    found = outline(1)
    assert found.points[[0, -1], 1].tolist() == [0.0, 0.0]
    assert found.points[1:-1, 1].min() > 0
    np.testing.assert_allclose(found.points[[0, -1], 0], [0.6, 1.4], atol=0.03)


def test_a_path_that_does_not_stand_on_the_floor_is_refused():
    """One ends in the air, one below the floor; the third begins a little above the floor, and goes down."""
    x = np.linspace(0.0, 1.0, 60)
    down, up, below = np.stack([x, 0.02 - x], axis=1), np.array([0.0, 0.1]), np.array([0.0, -0.5])
    for moved, path, said in (
        (arch_edge(1) + up, CLICKS + up, "above it"),
        (arch_edge(1) + below, CLICKS + below, "below y = 0"),
        (down, down[::10], "below y = 0 nearly everywhere"),
    ):
        with pytest.raises(InvalidInput, match=said):
            outline_of(moved, path, sd=SD, length=LENGTH)


def test_the_longest_piece_of_a_closed_edge_may_go_past_its_first_point():
    kept = np.array([1, 1, 0, 1, 0, 1, 1], bool)
    assert _longest(kept, closed=True).tolist() == [5, 6, 0, 1]
    assert _longest(kept, closed=False).tolist() == [0, 1]
