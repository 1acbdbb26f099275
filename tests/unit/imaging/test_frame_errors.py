"""Errors of an edge from several frames of one state: what they show, and what they cannot show."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr
from tests.unit.imaging.pictures import circle, disc

from strandline.errors import InvalidInput
from strandline.imaging import Edge, FrameErrors, Picture, errors_from_frames, find_edge

PIXEL = (0.01, 0.01)
SHAPE = (60, 240)
PATH = np.array([[3.0, 30.0], [120.0, 30.0], [236.0, 30.0]])


def frames(
    number: int, *, noise: float = 0.1, wave: float = 0.0, reach: float = 3.0, jump: float = 0.0
) -> list[Picture]:
    """Return frames of a straight edge with noise of the pixels, waves of their own along it, and shifts, px."""
    out, x = [], np.arange(SHAPE[1])
    for seed in range(number):
        random = np.random.default_rng(seed)
        waves = gaussian_filter1d(random.standard_normal(len(x) + 100), reach)[50:-50] * wave
        at = 30.3 + waves * np.sqrt(2 * reach * np.sqrt(np.pi)) + jump * random.standard_normal()
        shown = 1 + 2 * ndtr((np.arange(SHAPE[0])[:, None] - at) / 1.5)
        out.append(picture(shown + noise * random.standard_normal(SHAPE)))
    return out


def picture(values: np.ndarray) -> Picture:
    return Picture(values, PIXEL, "frame", "0")


def compared(
    given: Sequence[Picture], path: np.ndarray = PATH, *, exclude: Sequence[np.ndarray] = (), closed: bool = False
) -> tuple[Edge, FrameErrors]:
    """Return the edge in the mean of frames, and what the frames show of its errors."""
    mean = np.mean([one.values for one in given], axis=0)
    edge = find_edge(mean, path, pixel=PIXEL, exclude=exclude, closed=closed)
    return edge, errors_from_frames(given, edge, number=len(given), exclude=exclude)


def test_noise_of_the_pixels_shows_alike_in_the_frames_and_in_their_mean() -> None:
    edge, found = compared(frames(9, noise=0.3))
    off = PIXEL[0] * float(np.std(edge.points[:, 1]))
    assert found.mean.sd == pytest.approx(off, rel=0.2)
    assert found.mean.sd == pytest.approx(edge.errors.sd, rel=0.2)
    assert found.one.sd == pytest.approx(3 * found.mean.sd)
    assert (found.frames, found.compared, found.one.length) == (9, 9, found.mean.length)


def test_waves_that_differ_from_frame_to_frame_show_only_in_the_frames() -> None:
    """The truth is s 0.3 px and ℓ = √π · 3 px in one frame; the mean picture alone sees little of it."""
    edge, found = compared(frames(8, wave=0.3))
    level = (0.3 * PIXEL[0]) ** 2 * np.sqrt(np.pi) * 3 * PIXEL[0] / 8
    assert found.larger
    assert found.mean.sd**2 * found.mean.length == pytest.approx(level, rel=0.4)
    assert edge.errors.level < 0.3 * level
    taken = found.put_into(edge).errors
    assert (taken.sd, taken.length) == (found.mean.sd, found.mean.length)
    assert taken.offset == pytest.approx(np.hypot(edge.errors.offset, found.mean.offset))


def test_what_all_frames_share_shows_in_none_and_the_picture_alone_is_taken() -> None:
    """The same waves in each frame, as of speckle at rest."""
    shared, random = frames(1, noise=0.0, wave=0.6, reach=1.0)[0].values, np.random.default_rng(5)
    edge, found = compared([picture(shared + 0.02 * random.standard_normal(SHAPE)) for _ in range(6)])
    assert not found.larger
    assert found.mean.sd < 0.3 * edge.errors.sd
    assert found.put_into(edge).errors.sd == edge.errors.sd


def test_neither_a_camera_that_shakes_nor_a_region_that_is_left_out_is_an_error_of_single_points() -> None:
    """Beside a region, the longest piece is compared."""
    still, shaken = compared(frames(8))[1], compared(frames(8, jump=1.0))[1]
    assert shaken.one.sd == pytest.approx(still.one.sd, rel=0.1)
    moved = np.std([np.random.default_rng(seed).standard_normal() for seed in range(8)], ddof=1)
    across = np.hypot(shaken.one.shift, shaken.one.offset)
    assert 0.4 * moved * PIXEL[0] < across < 2 * moved * PIXEL[0]
    assert shaken.mean.shift == pytest.approx(shaken.one.shift / np.sqrt(8))
    region = np.array([[60.0, 10.0], [90.0, 10.0], [90.0, 50.0], [60.0, 50.0]])
    assert compared(frames(6), exclude=[region])[1].one.sd == pytest.approx(still.one.sd, rel=0.2)


def test_a_closed_edge() -> None:
    random = np.random.default_rng(3)
    given = [picture(disc() + 0.05 * random.standard_normal((120, 120))) for _ in range(4)]
    for exclude in ([], [np.array([[90.0, 40.0], [115.0, 40.0], [115.0, 80.0], [90.0, 80.0]])]):
        edge, found = compared(given, circle(), exclude=exclude, closed=True)
        assert found.mean.sd == pytest.approx(edge.errors.sd, rel=0.3)


def test_of_many_frames_some_are_compared() -> None:
    few = frames(4)
    found = errors_from_frames((few[k // 3 % 4] for k in range(64)), compared(few)[0], number=64)
    assert (found.frames, found.compared) == (64, 22)


def test_frames_that_show_no_errors_are_refused() -> None:
    same = frames(1)
    noise = picture(np.random.default_rng(1).standard_normal(SHAPE))
    for given, said in (
        (same, "number of contours"),
        (same * 3, "identical"),
        ([*frames(8), noise], "frame 9 by itse"),
    ):
        with pytest.raises(InvalidInput, match=said):
            compared(given)
