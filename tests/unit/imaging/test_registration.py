"""Registration of two pictures on what does not move: known motions, and errors that it states itself."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from strandline.errors import InvalidInput
from strandline.imaging import Registration, registered

SHAPE = (90, 120)
ALL = [np.array([[8.0, 8.0], [112.0, 8.0], [112.0, 82.0], [8.0, 82.0]])]
SHIFT, TURN = (3.2, -1.7), 0.6


@lru_cache
def texture() -> np.ndarray:
    smooth = gaussian_filter(np.random.default_rng(99).standard_normal((260, 260)), 4.0)
    return smooth / smooth.std()


def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a smooth texture at these places, the same whenever it is asked for."""
    return map_coordinates(texture(), [y + 60, x + 60], order=3)


def line(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a horizontal bright line without any structure along it."""
    return 3 * np.exp(-0.5 * ((y - 45) / 3) ** 2) + 0 * x


def pair(what=scene, *, noise=0.3, seed=0, stretch=(1.0, 1.0), shift=SHIFT, turn=TURN):  # type: ignore[no-untyped-def]
    """Return a picture and one whose contents moved: turned about the middle, shifted, with other light."""
    random, sides = np.random.default_rng(seed), np.array(stretch)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    middle = np.array([59.5, 44.5]) * sides
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    away = np.stack([x, y], axis=-1) * sides - middle - shift
    back = away @ np.array([[c, -s], [s, c]]) + middle
    first = what(x * sides[0], y * sides[1])
    second = 0.8 * what(back[..., 0], back[..., 1]) + 0.5
    return tuple(one + noise * random.standard_normal(SHAPE) for one in (first, second))


def error(found: Registration, shift: tuple[float, float] = SHIFT, turn: float = TURN) -> np.ndarray:
    """Return the errors of a registration: shift of the middle of the fixed regions, px, and rotation, degrees."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    middle, sides = np.array([59.5, 44.5]), np.array(found.stretch)
    away = (np.array(found.centre) - middle) * sides
    return np.append(found.shift - (away @ np.array([[c, s], [-s, c]]) + shift - away), found.rotation - turn)


@pytest.mark.parametrize("stretch", [(1.0, 1.0), (2.0, 1.0)])
def test_a_known_motion_is_found(stretch: tuple[float, float]) -> None:
    found = registered(*pair(stretch=stretch), ALL, pixel=stretch)
    assert np.abs(error(found)).max() < 0.1
    assert found.correlation > 0.8


def test_height_and_width_of_a_pixel_must_not_be_mixed_up() -> None:
    assert np.abs(error(registered(*pair(stretch=(2.0, 1.0)), ALL))[:2]).max() > 0.5


def test_points_follow() -> None:
    stretch = (2.0, 1.0)
    found = registered(*pair(stretch=stretch, noise=0.0), ALL, pixel=stretch)
    points, sides = np.array([[10.0, 20.0], [100.0, 70.0]]), np.array(stretch)
    c, s = np.cos(np.radians(TURN)), np.sin(np.radians(TURN))
    middle = np.array([59.5, 44.5]) * sides
    true = ((points * sides - middle) @ np.array([[c, s], [-s, c]]) + middle + SHIFT) / sides
    np.testing.assert_allclose(found(points), true, atol=0.06)


def right(rms: np.ndarray) -> bool:
    """Whether errors over their stated sds are what right ones give: those of the shift are of its worst direction."""
    return bool((rms > 0.6).all() and (rms < 1.4).all())


def test_its_errors_are_its_own() -> None:
    found = [registered(*pair(noise=1.0, seed=seed), ALL) for seed in range(6)]
    own = np.array([[one.shift_sd, one.shift_sd, one.rotation_sd] for one in found])
    rms = np.sqrt(np.mean((np.array([error(one) for one in found]) / own) ** 2, axis=0))
    rms = np.array([rms[:2].mean(), rms[2]])
    assert right(rms)
    assert not right(3 * rms)
    assert not right(rms / 3)


def test_a_direction_without_structure_stays_uncertain() -> None:
    found = registered(*pair(line, shift=(0.0, 1.4), turn=0.2), ALL)
    assert 2.0 < found.shift_sd < 12.0
    assert abs(error(found, (0.0, 1.4), 0.2)[0]) < 2.0 * found.shift_sd
    assert abs(error(found, (0.0, 1.4), 0.2)[1]) < 0.1
    assert abs(found.rotation - 0.2) < 0.2


def speckled(seed: int) -> np.ndarray:
    """Return errors over stated sds along a floor with two gaps in speckle: across, and the sd itself."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def scan(right: float) -> np.ndarray:
        gaps = sum(np.exp(-0.5 * ((x - right - at) / 5) ** 4) for at in (35, 80))
        mean = 1 + 60 * np.exp(-0.5 * ((y - 45) / 2) ** 4) * (1 - gaps)
        field = np.sqrt(mean) * random.standard_normal((2, *SHAPE))
        return np.asarray(sum(gaussian_filter(part, 1.2) ** 2 for part in field))

    right = 3 * random.standard_normal()
    found = registered(scan(0.0), scan(right), ALL, speckle=True)
    return np.array([(found.shift[0] - right) / found.shift_sd, found.shift_sd])


def test_speckle() -> None:
    """The noise of bright places is large; the slopes are noisy too and must not count as information."""
    found = np.array([speckled(seed) for seed in range(5)])
    assert 0.5 < np.sqrt(np.mean(found[:, 0] ** 2)) < 1.5
    assert np.median(found[:, 1]) < 2.0


def test_what_cannot_be_registered_is_refused() -> None:
    first, second = pair()
    other = np.random.default_rng(5).standard_normal(SHAPE)
    outside = np.array([[60.0, 50.0], [110.0, 50.0], [110.0, 80.0], [60.0, 80.0]])
    for seen, regions, said in (
        (second, [np.array([[8.0, 8.0], [14.0, 8.0], [14.0, 14.0]])], "fixed regions of the picture"),
        (other, ALL, "correlation"),
        (second[:40, :50], [outside], "fixed regions in the other picture: got 0"),
    ):
        with pytest.raises(InvalidInput, match=said):
            registered(first, seen, regions)
