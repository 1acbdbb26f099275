"""The smooth outline through an edge: how far it is off, what it says of that, and outlines that it refuses."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from strandline.errors import InvalidInput
from strandline.imaging import Outlined, outline_of

SD, LENGTH = 0.003, 0.03
ANGLE = np.linspace(np.pi, 0.0, 401)
TRUE = np.stack([1.0 + 0.4 * np.cos(ANGLE), 0.3 * np.sin(ANGLE)], axis=1)
"""An arch from the floor to the floor, mm."""
PATH = (
    TRUE[:: len(TRUE) // 10] + [[0.0, 0.0]] + 0.006 * np.random.default_rng(0).standard_normal((11, 2)) * [[1.0, 0.0]]
)


def edge(seed: int) -> np.ndarray:
    """Return the inner 90 % of the arch with correlated noise along its normals."""
    along = np.gradient(TRUE, axis=0)
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    noise = gaussian_filter1d(np.random.default_rng(seed).standard_normal(len(TRUE)), 6.0, mode="wrap")
    noise *= SD * np.sqrt(2 * np.sqrt(np.pi) * 6.0)
    return np.asarray((TRUE + noise[:, None] * normals)[20:-20])


@lru_cache
def fitted(seed: int) -> Outlined:
    """Return the outline; the integral of the noise's correlation is 2 × LENGTH."""
    spacing = float(np.median(np.linalg.norm(np.diff(TRUE, axis=0), axis=1)))
    return outline_of(edge(seed), PATH, sd=SD, length=np.sqrt(np.pi) * 6.0 * spacing)


def off(found: Outlined) -> np.ndarray:
    """Return the distances of the outline's inner points from the arch, mm."""
    radial = np.hypot((found.points[:, 0] - 1.0) / 0.4, found.points[:, 1] / 0.3)
    angle = np.arctan2(found.points[:, 1] / 0.3, (found.points[:, 0] - 1.0) / 0.4)
    scale = 0.12 / np.hypot(0.3 * np.cos(angle), 0.4 * np.sin(angle))
    return np.asarray(((radial - 1.0) * scale)[30:-30])


def right(ratio: float) -> bool:
    """Whether errors over stated standard deviations are near 1."""
    return 0.7 < ratio < 1.35


def test_its_errors_are_its_own() -> None:
    found = [fitted(seed) for seed in range(7)]
    ratio = float(np.sqrt(np.mean(np.concatenate([off(one) / one.sd for one in found]) ** 2)))
    assert right(ratio)
    assert not right(2 * ratio)
    assert not right(ratio / 2)
    assert all(one.sd < SD for one in found)
    assert all(one.length > LENGTH for one in found)


def test_it_stands_on_the_floor() -> None:
    found = fitted(1)
    assert found.points[[0, -1], 1].tolist() == [0.0, 0.0]
    assert found.points[1:-1, 1].min() > 0
    np.testing.assert_allclose(found.points[[0, -1], 0], [0.6, 1.4], atol=0.03)


def test_draws_scatter_as_it_says() -> None:
    found = fitted(1)
    draws = found.draws(400, seed=3)
    away = ((draws - found.points) * found.normals).sum(axis=2)[:, 60:-60]
    assert np.sqrt((away**2).mean()) == pytest.approx(found.sd, rel=0.2)
    assert (draws[:, [0, -1], 1] == 0).all()
    np.testing.assert_array_equal(draws[:5], found.draws(400, seed=3)[:5])


def test_a_finer_edge_gives_the_same_outline() -> None:
    fine = np.column_stack([np.interp(np.linspace(0, 1, 2000), np.linspace(0, 1, 361), column) for column in edge(1).T])
    other = outline_of(fine, PATH, sd=SD, length=LENGTH)
    assert np.abs(off(other)).max() < 3 * SD


def test_a_path_that_does_not_stand_on_the_floor_is_refused() -> None:
    """One ends in the air, one below the floor; the third begins a little above the floor, and goes down."""
    x = np.linspace(0.0, 1.0, 60)
    down, up, below = np.stack([x, 0.02 - x], axis=1), np.array([0.0, 0.1]), np.array([0.0, -0.5])
    for moved, path, said in (
        (edge(1) + up, PATH + up, "above it"),
        (edge(1) + below, PATH + below, "below y = 0"),
        (down, down[::10], "below y = 0 nearly everywhere"),
    ):
        with pytest.raises(InvalidInput, match=said):
            outline_of(moved, path, sd=SD, length=LENGTH)
