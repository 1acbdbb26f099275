"""Thinning: few triangles, the same surface, no folds and no holes."""

import numpy as np
import pytest
from tests.unit.discrepancy.surfaces import sphere

from strandline.imaging.surfaces.mesh import Mesh, cut, vector_areas
from strandline.imaging.surfaces.thinning import thinned
from strandline.interface import Interface


def test_a_sphere_stays_a_sphere() -> None:
    fine = sphere(1.0, 4)
    thin = thinned(Mesh(fine.points, fine.cells), 400)
    assert 300 < len(thin.cells) <= 400
    surface = Interface(thin.points, thin.cells)
    assert surface.closed
    assert np.abs(np.linalg.norm(thin.points, axis=1) - 1).max() < 0.03
    assert (surface.centres * surface.normals).sum() / 3 == pytest.approx(4 * np.pi / 3, rel=0.03)
    outwards = (surface.centres * surface.normals).sum(axis=1)
    assert outwards.min() > 0


def test_a_rim_stays_where_it_is() -> None:
    n = 25
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float))
    points = np.stack([x, y, 2 * np.cos(x / 8)], axis=-1).reshape(-1, 3)
    first = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    cells = np.concatenate(
        [np.stack([first, first + 1, first + n], 1), np.stack([first + 1, first + n + 1, first + n], 1)]
    )
    thin = thinned(Mesh(points, cells), 200)
    assert 100 < len(thin.cells) <= 200
    rim = thin.points[thin.on_rim]
    away = np.abs(np.abs(rim[:, :2] - (n - 1) / 2) - (n - 1) / 2).min(axis=1)
    assert np.median(away) < 1e-9
    assert away.max() < 2  # at the corners, which become rounder
    assert np.abs(thin.points[:, 2] - 2 * np.cos(thin.points[:, 0] / 8)).max() < 0.15
    flat = vector_areas(thin.points, thin.cells)[:, 2]
    assert flat.min() > 0
    assert flat.sum() == pytest.approx((n - 1) ** 2, rel=0.03)


def test_what_cannot_be_thinner_stays() -> None:
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    cells = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    assert len(thinned(Mesh(corners, cells), 2).cells) == 4


def test_a_plane_cuts_a_sphere_in_a_circle() -> None:
    surface = sphere(1.0, 4)
    for axis in range(3):
        segments = cut(Mesh(surface.points, surface.cells), axis, 0.3)
        np.testing.assert_allclose(segments[:, :, axis], 0.3)
        np.testing.assert_allclose(np.linalg.norm(segments, axis=2), 1, atol=0.01)
        length = np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).sum()
        assert length == pytest.approx(2 * np.pi * np.sqrt(1 - 0.09), rel=0.01)
