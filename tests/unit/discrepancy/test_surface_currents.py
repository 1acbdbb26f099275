"""Oracles: closed forms for squares and spheres, all pairs in NumPy, observed orders, bounds against fine rules."""

import math

import numpy as np
import pytest
from scipy import optimize
from tests.unit.discrepancy.surfaces import divided, sheet, sphere, turned

from strandline.discrepancy import Currents
from strandline.discrepancy.products import surface_integrals
from strandline.discrepancy.products.kernel_integrals import natural_scale
from strandline.discrepancy.products.surface_integrals import error_bound, surface_nodes, triangle_order, triangle_rule
from strandline.errors import InvalidInterface, NumericsError
from strandline.interface import Interface


def square_product(size: float, gap: float, width: float) -> float:
    """Closed form of ⟨S,T⟩ for two opposite parallel squares: that of two lines, squared."""
    along = width * math.sqrt(2 * math.pi) * size * math.erf(size / (math.sqrt(2) * width))
    line = along + 2 * width**2 * math.expm1(-0.5 * (size / width) ** 2)
    return line**2 * math.exp(-0.5 * (gap / width) ** 2)


def sphere_product(a: float, b: float, width: float) -> float:
    """Closed form of ⟨S,T⟩ for two concentric spheres: 8π²a²b² e^(-(a²+b²)/2σ²) ∫ t exp(abt/σ²) dt over -1 … 1."""
    k = a * b / width**2
    scaled = (k * (1 + math.exp(-2 * k)) + math.expm1(-2 * k)) / k**2
    return 8 * math.pi**2 * a**2 * b**2 * math.exp(-0.5 * ((a - b) / width) ** 2) * scaled


def test_parallel_squares_closed_form():
    for width, nodes, seed in ((0.3, 4, 1), (2.0, 2, None)):
        gap = 0.5 * width
        lower, upper, whole = sheet(nodes, seed=seed), sheet(3, height=gap), square_product(1.0, 0.0, width)
        exact = 2 * (whole - square_product(1.0, gap, width))
        assert Currents(width)(upper, lower) == pytest.approx(exact, abs=1e-6 * whole)
        assert Currents(width, tolerance=1e-10)(upper, lower) == pytest.approx(exact, rel=1e-8)


def test_a_square_much_larger_than_the_kernel():
    assert Currents(0.05, tolerance=1e-2).inner(sheet(2), sheet(2)) == pytest.approx(
        square_product(1.0, 0.0, 0.05), rel=0.01
    )
    assert natural_scale(sheet(2), 0.03) == pytest.approx(2 * math.pi * 0.03**2)
    assert natural_scale(sheet(2), 10.0) == pytest.approx(1.0)


@pytest.mark.parametrize("quadrature", ["refined", "centre"])
def test_concentric_spheres_converge_to_the_closed_form_with_order_two(quadrature):
    inner, outer, width = 1.0, 1.2, 0.4
    products = [sphere_product(*pair, width) for pair in ((inner, inner), (inner, outer), (outer, outer))]
    exact = products[0] - 2 * products[1] + products[2]
    measure = Currents(width, quadrature=quadrature, tolerance=1e-4)
    errors = np.array([abs(measure(sphere(inner, k), sphere(outer, k)) - exact) for k in (2, 3)])
    assert errors[-1] < 0.05 * exact
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("width", [0.3, 3.0])
def test_refined_norm_does_not_depend_on_the_triangles(width):
    """One bent sheet with every triangle cut in four, and one flat square with quite other triangles."""
    measure, bent, flat = Currents(width), sheet(5, bend=0.2), sheet(5, seed=1)
    assert measure(divided(bent), bent) < measure.tolerance * measure.inner(bent, bent)
    assert measure(sheet(4, seed=2), flat) < measure.tolerance * measure.inner(flat, flat)


def test_centre_rule_is_the_double_sum_of_the_paper_and_converges_to_the_refined_norm():
    a, b, width = sheet(5, bend=0.2, seed=1), sphere(0.5, 1), 0.3
    squares = ((a.centres[:, None] - b.centres) ** 2).sum(axis=2)
    total = (np.exp(-squares / (2 * width**2)) * (a.normals @ b.normals.T)).sum()
    assert Currents(width, quadrature="centre").inner(a, b) == pytest.approx(total, rel=1e-13)
    observed, simulated, errors = sheet(5, bend=0.2), sheet(5, bend=0.22), []
    exact = Currents(0.2, tolerance=1e-8)(simulated, observed)
    for _ in range(3):
        observed, simulated = divided(observed), divided(simulated)
        errors.append(abs(Currents(0.2, quadrature="centre")(simulated, observed) - exact))
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("quadrature", ["refined", "centre"])
def test_rigid_motions_scale_and_orientation(quadrature):
    measure, twin = (Currents(width, quadrature=quadrature) for width in (0.2, 2.0))
    a, b = sheet(5, bend=0.2, seed=1), sheet(4, bend=0.25, seed=2)
    d2, cross = measure(a, b), measure.inner(a, b)
    assert measure(turned(a, 3), turned(b, 3)) == pytest.approx(d2, rel=1e-6)
    assert measure.inner(a.reversed(), b) == pytest.approx(-cross, rel=1e-12)
    assert twin(*(Interface(10.0 * one.points, one.cells) for one in (a, b))) == pytest.approx(1e4 * d2, rel=1e-6)
    assert measure(a, a) <= 1e-12 * cross
    assert measure(Interface(a.points.copy(), a.cells), a) <= 1e-12 * cross


def test_a_flipped_surface_is_refused():
    for simulated, observed in ((sheet(5, height=0.01), sheet(5)), (sphere(1.0, 2), sphere(1.1, 2))):
        with pytest.raises(InvalidInterface, match="against"):
            Currents(0.1)(simulated, observed.reversed())


def test_two_sides_of_a_thin_plate_cancel_and_are_integrated_to_a_share_of_what_is_left():
    """A plate 0.001 widths thick: ⟨T,T⟩ is a millionth of its naive scale."""
    width, gap, lower = 1.0, 1e-3, sheet(3)
    points = np.concatenate([lower.points, lower.points + np.array([0.0, 0.0, gap])])
    plate = Interface(points, np.concatenate([lower.cells[:, ::-1], lower.cells + len(lower.points)]))
    exact = 2 * (square_product(1.0, 0.0, width) - square_product(1.0, gap, width))
    assert exact < 1e-6 * natural_scale(plate, width)
    assert Currents(width, tolerance=1e-4).inner(plate, plate) == pytest.approx(exact, rel=1e-4)


def test_rule_integrates_polynomials_up_to_its_degree():
    for order in (1, 2, 3, 7, 14):
        shares, weights = triangle_rule(order)
        assert weights.min() > 0
        for p in range(2 * order):
            for q in range(2 * order - p):
                exact = 2 * math.factorial(p) * math.factorial(q) / math.factorial(p + q + 2)
                assert weights @ (shares[:, 0] ** p * shares[:, 2] ** q) == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
def test_order_keeps_its_bound_without_waste(tolerance):
    """Worst case over places of the kernel in and around an equilateral triangle of that radius; fine rule as truth."""
    angle = np.array([0.5, 7 / 6, 11 / 6]) * np.pi
    for ratio in (0.125, 1.0, 2.5):
        corners = ratio * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        places = np.random.default_rng(1).uniform(-2 * ratio, 2 * ratio, (50, 3))

        def mean(order, corners=corners, places=places):
            shares, weights = triangle_rule(order)
            r2 = ((shares @ corners - places[:, None]) ** 2).sum(axis=2)
            return np.exp(-0.5 * r2) @ weights

        order, exact = triangle_order(ratio, tolerance), mean(29)
        errors = [np.abs(mean(k) - exact).max() for k in range(1, order + 1)]
        assert all(error <= max(error_bound(k, ratio), 1e-14) for k, error in enumerate(errors, start=1))
        assert errors[-1] <= tolerance
        assert order <= 3 or errors[order // 2 - 1] > tolerance


def test_the_highest_order_is_tried_and_a_rule_out_of_reach_refused():
    highest = surface_integrals._HIGHEST
    assert triangle_order(6.0, error_bound(highest, 6.0)) == highest
    with pytest.raises(NumericsError, match="larger tolerance"):
        triangle_order(20.0, 1e-12)


def test_divided_triangles_cover_the_whole_once():
    """Each equal piece holds one point of the centre rule; indicator functions of the pieces count them."""
    for parts in (1, 2, 5):
        shares, weights = surface_integrals._divided_rule(parts, 1)
        assert weights == pytest.approx(np.full(parts**2, 1 / parts**2))
        assert len(np.unique(np.floor(parts * shares), axis=0)) == parts**2 or parts == 1
        assert shares.sum(axis=1) == pytest.approx(1.0)
        assert shares.min() > 0


def test_normals_of_the_nodes_add_up_to_those_of_the_triangles():
    surface = sheet(4, bend=0.3, seed=1)
    for width in (0.02, 0.1, 10.0):
        nodes = surface_nodes(surface, width, 1e-6)
        assert nodes.normals.sum(axis=0) == pytest.approx(surface.normals.sum(axis=0), abs=1e-13)
        moments = surface.centres.T @ surface.normals
        assert nodes.points.T @ nodes.normals == pytest.approx(moments, abs=1e-13)


def test_radius_of_the_smallest_disc():
    for seed in range(3):
        corners = np.random.default_rng(seed).normal(size=(3, 3)) * [1.0, 0.3, 0.1]
        found = optimize.minimize(
            lambda share, corners=corners: np.linalg.norm(
                corners - np.append(share, 1 - share.sum()) @ corners, axis=1
            ).max(),
            np.full(2, 1 / 3),
            method="Nelder-Mead",
            options={"xatol": 1e-8, "fatol": 1e-9, "maxiter": 4000},
        ).fun
        assert surface_integrals._enclosing_radii(corners[None]) == pytest.approx([found], rel=1e-5)
    acute = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, math.sqrt(0.75), 0.0]])
    obtuse = np.array([[0.0, 0.0, 0.0], [1.9, 0.0, 0.0], [0.95, 0.3, 0.0]])
    for scale in (1e-3, 1e3):
        found = surface_integrals._enclosing_radii(scale * np.stack([acute, obtuse]))
        np.testing.assert_allclose(found, [scale / math.sqrt(3), 0.95 * scale], rtol=1e-12)
