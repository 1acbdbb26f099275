"""Where observed points lie on a simulated interface: parts, closed outlines, surfaces, and noise."""

import numpy as np
from tests.unit.calibration.arches import TRUTH, arch
from tests.unit.discrepancy.surfaces import sheet

from strandline.calibration.footprint import footprint
from strandline.interface import Interface, PointErrors


def curve(number: int = 401) -> Interface:
    t = np.linspace(0.0, 1.0, number)
    return Interface.polyline(np.stack([t, 0.3 * np.sin(np.pi * t)], axis=1))


def circle(angle: np.ndarray, *, closed: bool = True) -> Interface:
    return Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=closed)


def test_an_observation_of_the_nodes_stays_one() -> None:
    true = arch(TRUTH)
    noisy = PointErrors(0.01).draw(true, np.random.default_rng(1))
    np.testing.assert_array_equal(footprint(noisy, true).on(true.points), true.points)


def test_a_part_stays_that_part_and_follows_the_interface_when_it_moves() -> None:
    """Places are weighted means of the nodes, also where there are as many points as nodes."""
    whole = curve()
    part = Interface.polyline(whole.points[100:301:5])
    found = footprint(part, whole)
    np.testing.assert_allclose(found.on(whole.points), part.points, atol=2e-4)
    assert found.cells is part.cells
    shift = np.array([0.2, -0.4])
    np.testing.assert_allclose(found.on(whole.points + shift), found.on(whole.points) + shift, atol=1e-12)
    as_many = curve(41)
    np.testing.assert_allclose(footprint(part, as_many).on(as_many.points), part.points, atol=2e-3)


def test_noise_along_the_interface_changes_no_order() -> None:
    whole, random = curve(), np.random.default_rng(2)
    part = whole.points[40:361:4]
    noisy = Interface.polyline(part + 0.0015 * random.standard_normal(part.shape))
    laid = Interface.polyline(footprint(noisy, whole).on(whole.points))
    assert (laid.normals @ np.array([0.0, 1.0]) > 0).all()
    assert laid.lengths.min() > 0.2 * np.median(laid.lengths)


def test_a_closed_outline_may_begin_anywhere_and_a_part_may_pass_its_beginning() -> None:
    whole = circle(2 * np.pi * np.arange(60) / 60)
    for first in (0, 17):
        turned = Interface.polyline(np.roll(whole.points[::2], -first, axis=0), closed=True)
        np.testing.assert_allclose(footprint(turned, whole).on(whole.points), turned.points, atol=1e-9)
    whole, part = circle(2 * np.pi * np.arange(120) / 120), circle(np.linspace(-0.8, 0.9, 40), closed=False)
    np.testing.assert_allclose(footprint(part, whole).on(whole.points), part.points, atol=2e-3)


def test_points_of_a_surface_keep_their_place_in_its_triangles() -> None:
    whole, observed = sheet(6, bend=0.1), sheet(9, bend=0.1, seed=3)
    found = footprint(observed, whole)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, rtol=1e-12)
    assert found.weights.min() > -1e-9
    laid = found.on(whole.points)
    assert np.linalg.norm(laid - observed.points, axis=1).max() < 0.05
    stretch = np.array([2.0, 1.0, 1.0])
    np.testing.assert_allclose(found.on(whole.points * stretch), laid * stretch, atol=1e-12)
