"""Oracles: closed forms (erf, Bessel), scipy's adaptive quadrature, observed orders of convergence."""

import math

import numpy as np
import pytest
from scipy import integrate, special
from tests.unit.discrepancy.curves import level, line, ring

from strandline.discrepancy import Currents
from strandline.discrepancy.memo import Snapshot
from strandline.discrepancy.products import kernel_integrals
from strandline.discrepancy.products.kernel_integrals import refined_product
from strandline.errors import InvalidInput, InvalidInterface, NumericsError
from strandline.interface import Interface, PointErrors, oriented_like

ARC = np.array([[0.02 * i, 0.3 * math.sin(0.08 * i)] for i in range(40)])
"""An open curve of segments about 0.03 mm long."""


def subdivided(interface: Interface, parts: int, seed: int | None = None) -> Interface:
    """Return the same open curve with each segment cut into `parts`, equal or at random places."""
    shares = np.tile(np.arange(parts) / parts, (len(interface.cells), 1))
    if seed is not None:
        shares[:, 1:] = np.sort(np.random.default_rng(seed).uniform(0.01, 0.99, shares[:, 1:].shape), axis=1)
    steps = shares[..., None] * (interface.ends - interface.starts)[:, None]
    return Interface.polyline(np.vstack([(interface.starts[:, None] + steps).reshape(-1, 2), interface.ends[-1:]]))


def line_product(length: float, gap: float, width: float) -> float:
    """Closed form of ⟨S,T⟩ for two opposite parallel lines."""
    along = width * math.sqrt(2 * math.pi) * length * math.erf(length / (math.sqrt(2) * width))
    ends = 2 * width**2 * -math.expm1(-0.5 * (length / width) ** 2)
    return (along - ends) * math.exp(-0.5 * (gap / width) ** 2)


def test_parallel_lines_closed_form():
    width, gap = 0.005, 0.003
    for ratio, segments in ((0.01, 1), (0.5, 3), (5.99, 1), (6.01, 3), (17.0, 1), (100.0, 3)):
        length = ratio * width * segments
        lower, upper = (level(y, segments + 1, length=length) for y in (0.0, gap))
        exact = 2 * (line_product(length, 0.0, width) - line_product(length, gap, width))
        assert Currents(width)(upper, lower) == pytest.approx(exact, abs=1e-6 * line_product(length, 0.0, width))
        assert Currents(width, tolerance=1e-12)(upper, lower) == pytest.approx(exact, rel=1e-10)


def test_two_segments_one_after_the_other_closed_form():
    """Second differences of the closed form for one line; also what may be left out as too far away."""
    width, first, second = 0.1, 0.59, 1.7
    for gap in (0.0, 0.1, 0.3, 0.8):
        ahead, behind = line((first + gap, 0), (first + gap + second, 0)), line((0, 0), (first, 0))
        lengths = (first + gap + second, gap, first + gap, gap + second)
        exact = 0.5 * sum(sign * line_product(x, 0.0, width) for sign, x in zip((1, 1, -1, -1), lengths, strict=True))
        for a, b in ((ahead, behind), (behind, ahead)):
            for tolerance in (1e-4, 1e-10):
                bound = tolerance * kernel_integrals.natural_scale(a, width)
                assert refined_product(a, b, width, tolerance=tolerance) == pytest.approx(exact, abs=bound)


def test_concentric_circles_converge_to_the_bessel_form_with_order_two():
    inner, outer, width = 0.5, 0.54, 0.1

    def product(a, b):
        scaled = special.ive(1, a * b / width**2) * math.exp(-0.5 * ((a - b) / width) ** 2)
        return 4 * np.pi**2 * a * b * scaled

    exact = product(inner, inner) - 2 * product(inner, outer) + product(outer, outer)
    errors = np.array([abs(Currents(width)(ring(n, inner), ring(n, outer)) - exact) for n in (64, 128, 256)])
    assert errors[-1] < 1e-3 * exact
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


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


def test_refined_norm_does_not_depend_on_the_nodes():
    observed, simulated = Interface.polyline(ARC), Interface.polyline(ARC + np.array([0.0, 0.002]) * ARC[:, :1])
    for width, parts, seed in ((3e-4, 2, None), (0.005, 7, None), (0.05, 3, 1), (10.0, 3, 1)):
        measure = Currents(width)
        other = measure(subdivided(simulated, parts, seed), subdivided(observed, parts + 1))
        bound = measure.tolerance * measure.inner(observed, observed)
        assert other == pytest.approx(measure(simulated, observed), abs=bound)


def test_centre_rule_is_the_double_sum_of_the_paper_and_converges_to_the_refined_norm():
    a, b, width = Interface.polyline(ARC), Interface.polyline(ARC[:20] + 0.01), 0.05
    distances = np.linalg.norm(a.centres[:, None] - b.centres, axis=2)
    total = (np.exp(-(distances**2) / (2 * width**2)) * (a.normals @ b.normals.T)).sum()
    assert Currents(width, quadrature="centre").inner(a, b) == pytest.approx(total, rel=1e-13)
    observed, simulated, width = a, Interface.polyline(ARC * [1.0, 1.05]), 0.03
    exact, centre = Currents(width, tolerance=1e-12)(simulated, observed), Currents(width, quadrature="centre")
    errors = np.array([abs(centre(subdivided(simulated, k), subdivided(observed, k)) - exact) for k in (2, 4, 8)])
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_distance_to_itself_is_zero_and_never_negative():
    for measure in (Currents(0.005), Currents(5.0), Currents(0.1, quadrature="centre")):
        assert measure(Interface.polyline(ARC.copy()), Interface.polyline(ARC)) == 0.0
        for step in (1e-15, 1e-12, 1e-9):
            assert measure(Interface.polyline(ARC + step), Interface.polyline(ARC)) >= 0.0


def test_tolerance_is_relative_to_the_observed_norm_where_normals_cancel():
    """A closed curve much smaller than the kernel: ⟨T,T⟩ is a millionth of its naive scale."""
    small, large, width = ring(24, 0.5), ring(24, 0.51), 300.0
    coarse, fine = Currents(width, tolerance=1e-2), Currents(width, tolerance=1e-6)
    assert coarse.inner(small, small) < 1e-5 * kernel_integrals.natural_scale(small, width)
    assert abs(coarse(large, small) - fine(large, small)) < 1e-2 * fine.inner(small, small)


def test_tolerance_holds_between_two_walls_that_nearly_cancel():
    """A loop 1e-4 widths high: ⟨T,T⟩ is 1e-8 of its naive scale, and so is the error allowed."""
    width, length, height = 1.0, 5.9, 1e-4
    loop = line((0, 0), (length, 0), (length, height), (0, height), closed=True)
    measure, whole = Currents(width, tolerance=0.1), line_product(length, 0.0, width)
    exact = (whole / width**2 + 2) * height**2  # long walls, and each short one with itself
    assert measure.inner(loop, loop) == pytest.approx(exact, rel=0.01)
    cross = whole * -math.expm1(-0.5 * (height / width) ** 2)
    assert abs(measure(line((0, 0), (length, 0)), loop) - whole + 2 * cross - exact) < 0.1 * exact


@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
def test_gauss_order_keeps_its_bound_without_waste(tolerance):
    """Worst case of the bound's integrand: the kernel itself along the piece, its peak anywhere."""

    def error(ratio, order):
        nodes, weights = np.polynomial.legendre.leggauss(order)
        s = 0.5 * ratio * nodes[:, None] - np.linspace(-ratio, ratio, 101)
        edge = (0.5 * ratio + np.linspace(-ratio, ratio, 101)) / math.sqrt(2)
        edges = special.erf(edge) - special.erf(edge - ratio / math.sqrt(2))
        return np.abs(0.5 * weights @ np.exp(-0.5 * s**2) - math.sqrt(np.pi / 2) * edges / ratio).max()

    for ratio in (0.125, 1.0, 4.5, 6.0):
        order = kernel_integrals.gauss_order(ratio, tolerance)
        assert error(ratio, order) <= tolerance
        assert order <= 2 or error(ratio, max(order // 2, 1)) > tolerance
    with pytest.raises(NumericsError, match="larger tolerance"):
        kernel_integrals.gauss_order(500.0, 1e-12)


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


def test_what_is_kept_of_an_observation_follows_its_content():
    observed, measure = Interface.polyline(ARC.copy()), Currents(0.02)
    assert Snapshot.of(observed) == Snapshot.of(Interface.polyline(ARC.copy()))
    assert hash(Snapshot.of(observed)) == hash(Snapshot.of(Interface.polyline(ARC.copy())))
    assert Snapshot.of(observed) != Snapshot.of(Interface.polyline(ARC + 1e-12))
    simulated = Interface.polyline(ARC + 0.01)
    assert measure(simulated, observed) > 0
    observed.points[:] += 0.01
    assert measure(simulated, observed) == 0.0


def test_a_flipped_interface_is_refused_and_can_be_turned():
    observed, simulated, measure = Interface.polyline(ARC), Interface.polyline(ARC + 0.01), Currents(0.02)
    for seen in (observed.reversed(), ring(20, 1.1).reversed()):
        with pytest.raises(InvalidInterface, match=r"against.*oriented_like"):
            measure(ring(20) if seen.closed else simulated, seen)
    turned, flipped = oriented_like(observed.reversed(), simulated)
    assert flipped
    assert measure(simulated, turned) == pytest.approx(measure(simulated, observed), rel=1e-9)


def test_what_cannot_be_compared_is_refused():
    surface = Interface(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInterface, match="coordinates"):
        Currents(0.1)(surface, Interface.polyline(ARC))
    with pytest.raises(InvalidInterface, match="coordinates"):
        Currents(0.1).inner(Interface.polyline(ARC), surface)
    for options, name in (
        ({"width": 0.0}, "width"),
        ({"width": math.nan}, "width"),
        ({"width": 1.0, "quadrature": "simpson"}, "quadrature"),
        ({"width": 1.0, "tolerance": 0.0}, "tolerance"),
        ({"width": 1.0, "tolerance": 1.0}, "tolerance"),
    ):
        with pytest.raises(InvalidInput, match=name):
            Currents(**options)


@pytest.mark.parametrize("variance", [1e-5, 5e-4])
def test_a_tolerance_that_suits_the_noise_changes_no_likelihood(variance):
    s = np.linspace(0.0, 1.0, 120)
    seen = Interface.polyline(np.column_stack([s, 0.3 * np.sin(np.pi * s)]))
    runs = np.stack([np.column_stack([s, h * np.sin(np.pi * s) ** 2]) for h in np.linspace(0.2, 0.4, 40)])
    exact, template = Currents(0.01), Interface.polyline(runs[0])
    looser = exact.tolerating(variance, seen)
    assert looser.tolerance > exact.tolerance
    difference = looser.many(runs, template, seen) - exact.many(runs, template, seen)
    assert 0 < np.abs(difference).max() / (2 * variance) < 0.01


def test_a_tolerance_is_never_smaller_than_the_stated_one():
    seen = line((0, 0), (1, 0.1), (2, 0))
    assert Currents(0.1, tolerance=0.01).tolerating(1e-12, seen).tolerance == 0.01
    assert Currents(0.1, quadrature="centre").tolerating(1.0, seen) == Currents(0.1, quadrature="centre")


def test_noise_variance_of_independent_points() -> None:
    """A slow change of the offsets e moves d² = ∬ e e' q by as much as white noise of density s²h does: s²h ∫q."""
    seen = ring(400)
    spacing = float(seen.lengths.mean())
    for width, sd in ((0.1, 0.01), (0.2, 0.03)):
        expected = sd**2 * spacing * math.sqrt(2 * math.pi) / width
        assert Currents(width).noise_variance(PointErrors(sd), seen) == pytest.approx(expected, rel=1e-3)
    assert Currents(0.5 * spacing).noise_variance(PointErrors(0.01), seen) is None
