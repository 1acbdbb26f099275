"""Where the model lies in a picture, and in another one by what does not move: known places, motions and errors."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates
from tests.unit.imaging.pictures import grid

from strandline.foundations import InvalidInput
from strandline.imaging import registered
from strandline.imaging.frame import Frame
from strandline.studies.keys.parse import made

PIXEL = (0.006, 0.003)
PLACES = [
    ({}, [110.0, 50.0], [0.06, 0.0]),
    ({}, [100.0, 40.0], [0.0, 0.03]),
    ({"y": "down"}, [100.0, 60.0], [0.0, 0.03]),
    ({"x": "left"}, [90.0, 50.0], [0.06, 0.0]),
    ({"rotation": 90.0}, [100.0, 40.0], [0.03, 0.0]),
    ({"rotation": 90.0}, [90.0, 50.0], [0.0, 0.06]),
    ({"rotation": -90.0, "x": "left"}, [100.0, 60.0], [0.03, 0.0]),
]


def test_known_places():
    for options, pixels, mm in PLACES:
        frame = made(Frame, {"origin": [100, 50], **options}, "frame", pixel=PIXEL)
        assert frame.mirrors == (np.linalg.det(frame.matrix) < 0)
        np.testing.assert_allclose(frame.to_mm(np.array([pixels, [100.0, 50.0]])), [mm, [0, 0]], atol=1e-15)
        np.testing.assert_allclose(frame.to_pixels(np.array([mm])), [pixels], rtol=1e-13)
    dx, dy = Frame((0.0, 0.0), PIXEL, rotation=30.0).to_pixels(np.array([[1.0, 0.0]]))[0] * PIXEL
    assert np.degrees(np.arctan2(-dy, dx)) == pytest.approx(30.0, rel=1e-12)  # in mm although pixels are oblong


MISTAKES = [
    ({}, r"observation\.frame\.origin: got nothing"),
    ({"origin": [1, "a"]}, r"observation\.frame\.origin\.1: got a"),
    ({"origin": [1, 2], "rotation": 400}, r"observation\.frame\.rotation: got 400"),
    ({"origin": [1, 2], "rotaton": 3}, "Did you mean rotation"),
]


def test_mistakes_are_one_line():
    for options, said in MISTAKES:
        with pytest.raises(InvalidInput, match=said) as caught:
            made(Frame, options, "observation.frame", pixel=PIXEL)
        assert "\n" not in str(caught.value)


SHAPE = (90, 120)
ALL = [np.array([[8.0, 8.0], [112.0, 8.0], [112.0, 82.0], [8.0, 82.0]])]
MIDDLE, SHIFT, TURN, WIDE = np.array([59.5, 44.5]), (3.2, -1.7), 0.6, (2.0, 1.0)


@lru_cache
def texture():
    smooth = gaussian_filter(np.random.default_rng(99).standard_normal((260, 260)), 4.0)
    return smooth / smooth.std()


def scene(x, y):
    """Return a smooth texture at these places, the same whenever it is asked for."""
    return map_coordinates(texture(), [y + 60, x + 60], order=3)


def line(x, y):
    """Return a horizontal bright line without any structure along it."""
    return 3 * np.exp(-0.5 * ((y - 45) / 3) ** 2) + 0 * x


def turned(away, turn):
    """Return offsets that are turned by an angle in degrees."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return away @ np.array([[c, s], [-s, c]])


def pair(what=scene, *, noise=0.3, seed=0, stretch=(1.0, 1.0), shift=SHIFT, turn=TURN):
    """Return a picture and one whose contents moved: turned about the middle, shifted, with other light."""
    random, places = np.random.default_rng(seed), np.stack(grid(SHAPE), axis=-1) * stretch
    back = turned(places - MIDDLE * stretch - shift, -turn) + MIDDLE * stretch
    first, second = (what(at[..., 0], at[..., 1]) for at in (places, back))
    return tuple(one + noise * random.standard_normal(SHAPE) for one in (first, 0.8 * second + 0.5))


def error(found, shift=SHIFT, turn=TURN):
    """Return the errors of a registration: shift of the middle of the fixed regions, px, and rotation, degrees."""
    away = (np.array(found.centre) - MIDDLE) * found.stretch
    return np.append(found.shift - (turned(away, turn) + shift - away), found.rotation - turn)


@pytest.mark.parametrize("stretch", [(1.0, 1.0), WIDE])
def test_a_known_motion_is_found_and_points_follow(stretch):
    found = registered(*pair(stretch=stretch), ALL, pixel=stretch)
    assert np.abs(error(found)).max() < 0.1
    mistaken = error(registered(*pair(stretch=stretch), ALL))  # as if pixels were square
    assert (np.abs(mistaken[:2]).max() > 0.5) == (stretch == WIDE)
    found = registered(*pair(stretch=stretch, noise=0.0), ALL, pixel=stretch)
    points = np.array([[10.0, 20.0], [100.0, 70.0]])
    true = (turned((points - MIDDLE) * stretch, TURN) + SHIFT) / stretch + MIDDLE
    np.testing.assert_allclose(found(points), true, atol=0.06)


def test_regions_may_have_any_numbers_of_corners():
    """Some of them are looked at when types are checked at run time."""
    corners = [np.linspace(0, 2 * np.pi, number, endpoint=False) for number in range(3, 40)]
    rings = [MIDDLE + 30 * np.stack([np.cos(angle), np.sin(angle)], axis=1) for angle in corners]
    assert np.abs(error(registered(*pair(), rings))).max() < 0.2


def test_the_errors_of_a_registration_are_its_own():
    """Those of the shift are of its worst direction; a third of them, or three times as large ones, would show."""
    found = [registered(*pair(noise=1.0, seed=seed), ALL) for seed in range(6)]
    own = np.array([[one.shift_sd, one.shift_sd, one.rotation_sd] for one in found])
    rms = np.sqrt(np.mean((np.array([error(one) for one in found]) / own) ** 2, axis=0))
    rms = np.array([rms[:2].mean(), rms[2]])
    assert [((by * rms > 0.6) & (by * rms < 1.4)).all() for by in (1 / 3, 1, 3)] == [False, True, False]


def test_a_direction_without_structure_stays_uncertain():
    found = registered(*pair(line, shift=(0.0, 1.4), turn=0.2), ALL)
    along, across, turn = error(found, (0.0, 1.4), 0.2)
    assert 2.0 < found.shift_sd < 12.0
    assert abs(along) < 2.0 * found.shift_sd
    assert abs(across) < 0.1
    assert abs(turn) < 0.2


def speckled(seed):
    """Return errors over stated sds along a floor with two gaps in speckle: across, and the sd itself."""
    random, (x, y) = np.random.default_rng(seed), grid(SHAPE)

    def scan(right):
        gaps = sum(np.exp(-0.5 * ((x - right - at) / 5) ** 4) for at in (35, 80))
        mean = 1 + 60 * np.exp(-0.5 * ((y - 45) / 2) ** 4) * (1 - gaps)
        field = np.sqrt(mean) * random.standard_normal((2, *SHAPE))
        return np.asarray(sum(gaussian_filter(part, 1.2) ** 2 for part in field))

    right = 3 * random.standard_normal()
    found = registered(scan(0.0), scan(right), ALL, speckle=True)
    return (found.shift[0] - right) / found.shift_sd, found.shift_sd


def test_speckle():
    """The noise of bright places is large; the slopes are noisy too and must not count as information."""
    found = np.array([speckled(seed) for seed in range(5)])
    assert 0.5 < np.sqrt(np.mean(found[:, 0] ** 2)) < 1.5
    assert np.median(found[:, 1]) < 2.0


def test_what_cannot_be_registered_is_refused():
    first, second = pair()
    other = np.random.default_rng(5).standard_normal(SHAPE)
    for seen, regions, said in (
        (second, [np.array([[8.0, 8.0], [14.0, 8.0], [14.0, 14.0]])], "fixed regions of the picture"),
        (other, ALL, "correlation"),
    ):
        with pytest.raises(InvalidInput, match=said):
            registered(first, seen, regions)
