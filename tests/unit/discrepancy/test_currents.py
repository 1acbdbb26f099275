"""Oracles: closed forms (erf, Bessel), adaptive quadrature, all pairs in NumPy, orders of convergence, bounds."""

import math

import numpy as np
import pytest
from scipy import integrate, special
from scipy.optimize import minimize_scalar
from tests.unit.discrepancy.curves import graph, level, line, ring
from tests.unit.discrepancy.surfaces import divided, sheet, sphere

from strandline.discrepancy import Currents, kernel_integrals
from strandline.discrepancy.kernel_integrals import (
    error_bound,
    gauss_order,
    natural_scale,
    refined_product,
    triangle_order,
    triangle_rule,
)
from strandline.discrepancy.many_currents import Division, PiecePairs, compiled_sum, plain_sum
from strandline.foundations import InvalidInterface, NumericsError
from strandline.interface import Interface, PointErrors, oriented_like

ARC = np.array([[0.02 * i, 0.3 * math.sin(0.08 * i)] for i in range(40)])


def subdivided(interface: Interface, parts: int) -> Interface:
    """Return the same open curve with each segment cut into equal `parts`."""
    steps = (np.arange(parts) / parts)[:, None] * (interface.ends - interface.starts)[:, None]
    return Interface.polyline(np.vstack([(interface.starts[:, None] + steps).reshape(-1, 2), interface.ends[-1:]]))


def line_product(length: float, gap: float, width: float) -> float:
    """Closed form of ⟨S,T⟩ for two opposite parallel lines."""
    along = width * math.sqrt(2 * math.pi) * length * math.erf(length / (math.sqrt(2) * width))
    ends = 2 * width**2 * -math.expm1(-0.5 * (length / width) ** 2)
    return (along - ends) * math.exp(-0.5 * (gap / width) ** 2)


def square_product(size: float, gap: float, width: float) -> float:
    """Closed form of ⟨S,T⟩ for two opposite parallel squares: that of two lines, squared."""
    return line_product(size, 0.0, width) ** 2 * math.exp(-0.5 * (gap / width) ** 2)


def circle_product(a: float, b: float, width: float) -> float:
    scaled = special.ive(1, a * b / width**2) * math.exp(-0.5 * ((a - b) / width) ** 2)
    return 4 * np.pi**2 * a * b * scaled


def sphere_product(a: float, b: float, width: float) -> float:
    """Closed form for two concentric spheres: 8π²a²b² e^(-(a²+b²)/2σ²) ∫ t exp(abt/σ²) dt over -1 … 1."""
    k = a * b / width**2
    scaled = (k * (1 + math.exp(-2 * k)) + math.expm1(-2 * k)) / k**2
    return 8 * math.pi**2 * a**2 * b**2 * math.exp(-0.5 * ((a - b) / width) ** 2) * scaled


def test_parallel_lines_and_squares_closed_form():
    width, gap = 0.005, 0.003
    for ratio, segments in ((0.01, 1), (0.5, 3), (5.99, 1), (6.01, 3), (17.0, 1), (100.0, 3)):
        length = ratio * width * segments
        lower, upper = (level(y, segments + 1, length=length) for y in (0.0, gap))
        whole = line_product(length, 0.0, width)
        exact = 2 * (whole - line_product(length, gap, width))
        assert Currents(width)(upper, lower) == pytest.approx(exact, abs=1e-6 * whole)
        assert Currents(width, tolerance=1e-12)(upper, lower) == pytest.approx(exact, rel=1e-10)
    for width, nodes, seed in ((0.3, 4, 1), (2.0, 2, None)):
        lower, upper, whole = sheet(nodes, seed=seed), sheet(3, height=0.5 * width), square_product(1.0, 0.0, width)
        exact = 2 * (whole - square_product(1.0, 0.5 * width, width))
        assert Currents(width)(upper, lower) == pytest.approx(exact, abs=1e-6 * whole)
        assert Currents(width, tolerance=1e-10)(upper, lower) == pytest.approx(exact, rel=1e-8)
    large = Currents(0.05, tolerance=1e-2).inner(sheet(2), sheet(2))
    assert large == pytest.approx(square_product(1.0, 0.0, 0.05), rel=0.01)
    assert natural_scale(sheet(2), 0.03) == pytest.approx(2 * math.pi * 0.03**2)
    assert natural_scale(sheet(2), 10.0) == pytest.approx(1.0)


def test_two_segments_one_after_the_other_closed_form():
    """Second differences of the closed form for one line; also what may be left out as too far away."""
    width, first, second = 0.1, 0.59, 1.7
    for gap in (0.0, 0.1, 0.3, 0.8):
        ahead, behind = line((first + gap, 0), (first + gap + second, 0)), line((0, 0), (first, 0))
        lengths = (first + gap + second, gap, first + gap, gap + second)
        exact = 0.5 * sum(sign * line_product(x, 0.0, width) for sign, x in zip((1, 1, -1, -1), lengths, strict=True))
        for a, b in ((ahead, behind), (behind, ahead)):
            for tolerance in (1e-4, 1e-10):
                bound = tolerance * natural_scale(a, width)
                assert refined_product(a, b, width, tolerance=tolerance) == pytest.approx(exact, abs=bound)


@pytest.mark.parametrize("width", [0.002, 0.05, 3.0])
def test_very_many_segments_take_gauss_points_of_both_curves(monkeypatch, width):
    """Segments of many lengths, from far below the width to many widths, against the closed form over the other."""
    s, t = np.cumsum(1e-4 + np.random.default_rng(2).uniform(size=300) ** 6) / 40, np.linspace(0.0, 1.0, 20)
    a, b = graph(s, 0.2 * np.sin(9 * s)), subdivided(graph(t, 0.2 * np.sin(9 * t) + 0.01), 12)
    exact = [refined_product(a, other, width, tolerance=1e-13) for other in (a, b)]
    monkeypatch.setattr(kernel_integrals, "SMALL", 1)
    for tolerance in (1e-4, 1e-10):
        found = [refined_product(a, other, width, tolerance=tolerance) for other in (a, b)]
        np.testing.assert_allclose(found, exact, atol=tolerance * natural_scale(a, width), rtol=0)
    monkeypatch.setattr(kernel_integrals, "gauss_order", lambda ratio, tolerance: 1)
    coarse = refined_product(a, b, width, tolerance=1e-10)
    assert abs(coarse - exact[1]) > 1e-10 * natural_scale(a, width)


CONCENTRIC = [
    (Currents(0.1), circle_product, (0.5, 0.54), [lambda r, n=n: ring(n, r) for n in (64, 128, 256)], 1e-3),
    (Currents(0.4, tolerance=1e-4), sphere_product, (1.0, 1.2), [lambda r, k=k: sphere(r, k) for k in (2, 3)], 0.05),
]


@pytest.mark.parametrize(("measure", "product", "radii", "shapes", "least"), CONCENTRIC)
def test_concentric_shapes_converge_to_the_closed_form_with_order_two(measure, product, radii, shapes, least):
    inner, outer = radii
    exact = sum(product(r, r, measure.width) for r in radii) - 2 * product(inner, outer, measure.width)
    errors = np.abs([measure(shape(inner), shape(outer)) / exact - 1 for shape in shapes])
    assert errors[-1] < least
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.2)


@pytest.mark.parametrize("width", [0.1, 0.5, 3.0])
def test_product_of_two_segments_against_adaptive_quadrature(width):
    rng = np.random.default_rng(int(10 * width))
    first, second = (Interface.polyline(rng.normal(size=(2, 2))) for _ in range(2))
    (a0, a1), (b0, b1) = first.points, second.points

    def kernel(t, s):
        return math.exp(-0.5 * np.sum((a0 + s * (a1 - a0) - b0 - t * (b1 - b0)) ** 2) / width**2)

    value, _ = integrate.dblquad(kernel, 0, 1, 0, 1, epsabs=1e-9, epsrel=1e-9)
    exact = value * float(first.normals[0] @ second.normals[0])
    assert Currents(width, tolerance=1e-10).inner(first, second) == pytest.approx(exact, abs=1e-8)


def test_centre_rule_is_the_double_sum_of_the_paper_and_converges_to_the_refined_norm():
    arc, bent = Interface.polyline(ARC), sheet(5, bend=0.2, seed=1)
    for a, b, width in ((arc, Interface.polyline(ARC[:20] + 0.01), 0.05), (bent, sphere(0.5, 1), 0.3)):
        squares = ((a.centres[:, None] - b.centres) ** 2).sum(axis=2)
        total = (np.exp(-squares / (2 * width**2)) * (a.normals @ b.normals.T)).sum()
        assert Currents(width, quadrature="centre").inner(a, b) == pytest.approx(total, rel=1e-13)
    lines, sheets = [(Interface.polyline(ARC * [1.0, 1.05]), arc)], [(sheet(5, bend=0.22), sheet(5, bend=0.2))]
    for _ in range(3):
        lines.append(tuple(subdivided(one, 2) for one in lines[-1]))
        sheets.append(tuple(map(divided, sheets[-1])))
    for pairs, width, tolerance, near in ((lines, 0.03, 1e-12, 0.1), (sheets, 0.2, 1e-8, 0.15)):
        exact, centre = Currents(width, tolerance=tolerance)(*pairs[0]), Currents(width, quadrature="centre")
        errors = [abs(centre(*pair) - exact) for pair in pairs[1:]]
        assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=near)


def test_tolerance_holds_between_two_walls_that_nearly_cancel():
    """A loop 1e-4 widths high: ⟨T,T⟩ is 1e-8 of its naive scale, and so is the error allowed. A plate as thin."""
    width, length, height = 1.0, 5.9, 1e-4
    loop = line((0, 0), (length, 0), (length, height), (0, height), closed=True)
    measure, whole = Currents(width, tolerance=0.1), line_product(length, 0.0, width)
    exact = (whole / width**2 + 2) * height**2  # long walls, and each short one with itself
    assert measure.inner(loop, loop) == pytest.approx(exact, rel=0.01)
    cross = whole * -math.expm1(-0.5 * (height / width) ** 2)
    assert abs(measure(line((0, 0), (length, 0)), loop) - whole + 2 * cross - exact) < 0.1 * exact
    lower, upper = sheet(3), sheet(3, height=1e-3)
    points = np.concatenate([lower.points, upper.points])
    plate = Interface(points, np.concatenate([lower.cells[:, ::-1], upper.cells + len(lower.points)]))
    exact = 2 * (square_product(1.0, 0.0, width) - square_product(1.0, 1e-3, width))
    assert Currents(width, tolerance=1e-4).inner(plate, plate) == pytest.approx(exact, rel=1e-4)


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


def test_rule_integrates_polynomials_up_to_its_degree_and_one_out_of_reach_is_refused():
    highest = kernel_integrals._HIGHEST
    assert triangle_order(6.0, error_bound(highest, 6.0)) == highest
    with pytest.raises(NumericsError, match="larger tolerance"):
        triangle_order(20.0, 1e-12)
    for order in (1, 2, 3, 7, 14):
        shares, weights = triangle_rule(order)
        assert weights.min() > 0
        for p, q in ((i, j) for i in range(2 * order) for j in range(2 * order - i)):
            exact = 2 * math.factorial(p) * math.factorial(q) / math.factorial(p + q + 2)
            assert weights @ (shares[:, 0] ** p * shares[:, 2] ** q) == pytest.approx(exact, rel=1e-11)


def test_divided_triangles_cover_the_whole_once():
    """Each equal piece holds one point of the centre rule; indicator functions of the pieces count them."""
    for parts in (1, 2, 5):
        shares, weights = kernel_integrals._divided_rule(parts, 1)
        assert weights == pytest.approx(np.full(parts**2, 1 / parts**2))
        assert len(np.unique(np.floor(parts * shares), axis=0)) == parts**2 or parts == 1
        assert shares.sum(axis=1) == pytest.approx(1.0)
        assert shares.min() > 0


def test_the_smallest_disc_has_the_radius_of_the_circumscribed_circle_or_half_the_longest_side():
    acute = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    obtuse = np.array([[0.0, 0.0, 0.0], [1.9, 0.0, 0.0], [0.95, 0.3, 0.0]])
    for scale in (1e-3, 1e3):
        found = kernel_integrals._enclosing_radii(scale * np.stack([acute, obtuse]))
        np.testing.assert_allclose(found, [0.625 * scale, 0.95 * scale], rtol=1e-12)


def test_blocks_of_many_pairs_add_up():
    """The product of more segments than one block holds is the sum of the products of its parts."""
    observed, simulated = (subdivided(Interface.polyline(ARC + shift), 8) for shift in (0.0, 0.004))
    assert len(observed.cells) ** 2 > kernel_integrals.BLOCK
    parts = [Interface.polyline(simulated.points[first : first + 40]) for first in range(0, 312, 39)]
    for product in (
        lambda a: kernel_integrals.centre_product(a, observed, 0.011),
        lambda a: refined_product(a, observed, 0.011, tolerance=1e-12),
    ):
        assert product(simulated) == pytest.approx(sum(map(product, parts)), rel=1e-10)


def test_what_cannot_be_compared_is_refused_and_a_flipped_interface_can_be_turned():
    observed, simulated, measure = Interface.polyline(ARC), Interface.polyline(ARC + 0.01), Currents(0.02)
    for one, seen in ((simulated, observed), (ring(20), ring(20, 1.1)), (sheet(5, height=0.01), sheet(5))):
        with pytest.raises(InvalidInterface, match=r"against.*oriented_like"):
            measure(one, seen.reversed())
    back, flipped = oriented_like(observed.reversed(), simulated)
    assert flipped
    assert measure(simulated, back) == pytest.approx(measure(simulated, observed), rel=1e-9)
    for refused in (measure, measure.inner):
        with pytest.raises(InvalidInterface, match="coordinates"):
            refused(sheet(2), observed)


@pytest.mark.parametrize("variance", [1e-5, 5e-4])
def test_a_tolerance_that_suits_the_noise_changes_no_likelihood(variance):
    s = np.linspace(0.0, 1.0, 120)
    seen = graph(s, 0.3 * np.sin(np.pi * s))
    runs = np.stack([np.column_stack([s, h * np.sin(np.pi * s) ** 2]) for h in np.linspace(0.2, 0.4, 40)])
    exact, template = Currents(0.01), Interface.polyline(runs[0])
    looser = exact.tolerating(variance, seen)
    assert looser.tolerance > exact.tolerance
    difference = looser.many(runs, template, seen) - exact.many(runs, template, seen)
    assert 0 < np.abs(difference).max() / (2 * variance) < 0.01
    assert Currents(0.1, tolerance=0.01).tolerating(1e-12, seen).tolerance == 0.01  # never less than the stated one
    assert Currents(0.1, quadrature="centre").tolerating(1.0, seen) == Currents(0.1, quadrature="centre")


def test_noise_variance_of_independent_points_and_none_for_what_is_coarser_than_the_kernel():
    """A slow change of the offsets e moves d² = ∬ e e' q by as much as white noise of density s²h does: s²h ∫q."""
    seen = ring(400)
    spacing = float(seen.lengths.mean())
    for width, sd in ((0.1, 0.01), (0.2, 0.03)):
        expected = sd**2 * spacing * math.sqrt(2 * math.pi) / width
        assert Currents(width).noise_variance(PointErrors(sd), seen) == pytest.approx(expected, rel=1e-3)
    assert Currents(0.5 * spacing).noise_variance(PointErrors(0.01), seen) is None
    assert Currents(0.1).noise_variance(PointErrors(0.01), sheet(2)) is None
    assert Currents(3.0).noise_variance(PointErrors(0.01), sheet(2)) > 0


def test_parallel_lines_are_as_far_apart_as_their_distance_says():
    """Long lines, whose ends hardly count: d² of the currents per length is that of `of_offsets`."""
    measure, seen = Currents(0.2), level(0.0, 201, length=20.0)
    for apart in (0.05, 0.3):
        (found,) = measure.of_offsets(np.full((1, 201), apart), seen, 201)
        assert found == pytest.approx(measure(level(apart, 201, length=20.0), seen), rel=0.02)


def test_sums_in_numpy_are_the_compiled_ones():
    random = np.random.default_rng(1)
    points, cells = random.random((6, 2, 3)), np.array([[k, k + 1] for k in range(5)])
    pieces = Division.of(cells, np.linalg.norm(np.diff(points, axis=0), axis=1).max(axis=1), 0.5).pieces(points)
    pairs = PiecePairs.near(pieces, pieces, 10.0)
    plain = plain_sum(pieces, pieces, pairs, (3, 3))
    np.testing.assert_allclose(plain, compiled_sum(pieces, pieces, pairs, (3, 3)), rtol=1e-12)


def test_the_least_order_of_a_gauss_rule_is_that_of_its_bound():
    """The bound of `gauss_order`, minimised over all ellipses."""

    def bound(order, ratio):
        def log_bound(log_excess):
            rho = 1 + np.exp(log_excess)
            growth = (ratio * (rho - 1 / rho)) ** 2 / 32
            return np.log(4) + growth + (1 - 2 * order) * np.log(rho) - np.log(rho - 1)

        return np.exp(minimize_scalar(log_bound, bounds=(-7.0, 7.0), method="bounded").fun)

    for ratio, tolerance in ((0.1, 1e-3), (1.0, 1e-6), (3.0, 1e-10), (8.0, 1e-4)):
        order = gauss_order(ratio, tolerance)
        assert bound(order, ratio) < 1.01 * tolerance
        assert bound(order - 1, ratio) > 0.99 * tolerance
    with pytest.raises(NumericsError, match="larger tolerance"):
        gauss_order(500.0, 1e-12)
