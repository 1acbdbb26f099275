"""Oracles: closed forms (erf, Bessel), scipy's adaptive quadrature, observed orders of convergence."""

import math

import numpy as np
import pytest
from scipy import integrate, special

from strandline.discrepancy import Currents
from strandline.discrepancy.memo import Snapshot
from strandline.discrepancy.products import kernel_integrals, kernel_sums
from strandline.errors import InvalidInput, InvalidInterface, NumericsError
from strandline.interface import Interface, PointErrors, oriented_like

ARC = np.array([[0.02 * i, 0.3 * math.sin(0.08 * i)] for i in range(40)])
"""An open curve of segments about 0.03 mm long."""


def circle(radius: float, nodes: int) -> Interface:
    angle = 2 * np.pi * np.arange(nodes) / nodes
    return Interface.polyline(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


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


@pytest.mark.parametrize("ratio", [0.01, 0.5, 4.5, 5.99, 6.01, 17.0, 100.0])
@pytest.mark.parametrize("segments", [1, 3])
def test_parallel_lines_closed_form(ratio, segments):
    width, gap = 0.005, 0.003
    length = ratio * width * segments
    x = np.linspace(0.0, length, segments + 1)
    lower = Interface.polyline(np.stack([x, 0 * x], axis=1))
    upper = Interface.polyline(np.stack([x, 0 * x + gap], axis=1))
    exact = 2 * (line_product(length, 0.0, width) - line_product(length, gap, width))
    assert Currents(width)(upper, lower) == pytest.approx(exact, abs=1e-6 * line_product(length, 0.0, width))
    assert Currents(width, tolerance=1e-12)(upper, lower) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("gap", [0.0, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_two_segments_one_after_the_other_closed_form(gap, tolerance):
    """Second differences of the closed form for one line; also what may be left out as too far away."""
    width, first, second = 0.1, 0.59, 1.7
    gap *= width
    ahead = Interface.polyline(np.array([[first + gap, 0.0], [first + gap + second, 0.0]]))
    behind = Interface.polyline(np.array([[0.0, 0.0], [first, 0.0]]))
    lengths = (first + gap + second, gap, first + gap, gap + second)
    exact = 0.5 * sum(sign * line_product(x, 0.0, width) for sign, x in zip((1, 1, -1, -1), lengths, strict=True))
    for a, b in ((ahead, behind), (behind, ahead)):
        scale = kernel_integrals.natural_scale(a, width)
        assert kernel_integrals.refined_product(a, b, width, tolerance=tolerance) == pytest.approx(
            exact, abs=tolerance * scale
        )


def test_concentric_circles_converge_to_the_bessel_form_with_order_two():
    inner, outer, width = 0.5, 0.54, 0.1

    def product(a, b):
        scaled = special.ive(1, a * b / width**2) * math.exp(-0.5 * ((a - b) / width) ** 2)
        return 4 * np.pi**2 * a * b * scaled

    exact = product(inner, inner) - 2 * product(inner, outer) + product(outer, outer)
    errors = [abs(Currents(width)(circle(inner, n), circle(outer, n)) - exact) for n in (64, 128, 256)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1e-3 * exact
    assert rates == pytest.approx([2.0, 2.0], abs=0.1)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("width", [0.1, 0.5, 3.0])
def test_product_of_two_segments_against_adaptive_quadrature(seed, width):
    a0, a1, b0, b1 = np.random.default_rng(seed).uniform(-1, 1, (4, 2))
    first, second = Interface.polyline(np.array([a0, a1])), Interface.polyline(np.array([b0, b1]))

    def kernel(t, s):
        return math.exp(-0.5 * np.sum((a0 + s * (a1 - a0) - b0 - t * (b1 - b0)) ** 2) / width**2)

    value, _ = integrate.dblquad(kernel, 0, 1, 0, 1, epsabs=1e-10, epsrel=1e-10)
    exact = value * float(first.normals[0] @ second.normals[0])
    assert Currents(width, tolerance=1e-10).inner(first, second) == pytest.approx(exact, abs=1e-9)


def test_perpendicular_segments_are_orthogonal():
    across = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0]]))
    up = Interface.polyline(np.array([[0.5, -1.0], [0.5, 1.0]]))
    assert Currents(0.3).inner(across, up) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("width", [3e-4, 0.005, 0.05, 1.0, 10.0])
@pytest.mark.parametrize(("parts", "seed"), [(2, None), (7, None), (3, 1)])
def test_refined_norm_does_not_depend_on_the_nodes(width, parts, seed):
    observed = Interface.polyline(ARC)
    simulated = Interface.polyline(ARC + np.array([0.0, 0.002]) * ARC[:, :1])
    measure = Currents(width)
    shift = measure(subdivided(simulated, parts, seed), subdivided(observed, parts + 1)) - measure(simulated, observed)
    assert abs(shift) < measure.tolerance * measure.inner(observed, observed)


def test_centre_rule_depends_on_the_nodes_where_segments_are_longer_than_the_width():
    """The trap: σ = 0.005 mm and ℓ = 0.022 mm; nodes shifted by half a segment along one and the same line."""
    x = 0.022 * np.arange(66)
    line = Interface.polyline(np.stack([x, 0 * x], axis=1))
    shifted = Interface.polyline(np.stack([np.concatenate([x[:1], x[1:] - 0.011, x[-1:]]), np.zeros(67)], axis=1))
    centre, refined = Currents(0.005, quadrature="centre"), Currents(0.005)
    assert centre(shifted, line) > 0.5 * centre.inner(line, line)
    assert refined(shifted, line) < 1e-6 * refined.inner(line, line)
    finer = subdivided(line, 2)
    assert abs(centre.inner(finer, finer) / centre.inner(line, line) - 1) > 0.3


def test_centre_rule_is_the_double_sum_of_the_paper():
    a, b, width = Interface.polyline(ARC), Interface.polyline(ARC[:20] + 0.01), 0.05
    total = 0.0
    for i in range(len(a.cells)):
        for j in range(len(b.cells)):
            r = np.linalg.norm(a.centres[i] - b.centres[j])
            total += math.exp(-(r**2) / (2 * width**2)) * float(a.normals[i] @ b.normals[j])
    assert Currents(width, quadrature="centre").inner(a, b) == pytest.approx(total, rel=1e-13)


def test_centre_rule_converges_to_the_refined_norm_with_order_two():
    observed, simulated, width = Interface.polyline(ARC), Interface.polyline(ARC * [1.0, 1.05]), 0.03
    exact = Currents(width, tolerance=1e-12)(simulated, observed)
    centre = Currents(width, quadrature="centre")
    errors = [abs(centre(subdivided(simulated, k), subdivided(observed, k)) - exact) for k in (2, 4, 8)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


@pytest.mark.parametrize("quadrature", ["refined", "centre"])
@pytest.mark.parametrize("width", [0.005, 0.1, 5.0])
def test_distance_to_itself_is_zero_and_never_negative(quadrature, width):
    observed = Interface.polyline(ARC)
    measure = Currents(width, quadrature=quadrature)
    assert measure(Interface.polyline(ARC.copy()), observed) == 0.0
    for step in (1e-15, 1e-12, 1e-9):
        assert measure(Interface.polyline(ARC + step), observed) >= 0.0


def test_tolerance_is_relative_to_the_observed_norm_where_normals_cancel():
    """A closed curve much smaller than the kernel: ⟨T,T⟩ is a millionth of its naive scale."""
    small, large, width = circle(0.5, 24), circle(0.51, 24), 300.0
    coarse, fine = Currents(width, tolerance=1e-2), Currents(width, tolerance=1e-6)
    assert coarse.inner(small, small) < 1e-5 * kernel_integrals.natural_scale(small, width)
    assert abs(coarse(large, small) - fine(large, small)) < 1e-2 * fine.inner(small, small)


def test_tolerance_holds_between_two_walls_that_nearly_cancel():
    """A loop 1e-4 widths high: ⟨T,T⟩ is 1e-8 of its naive scale, and so is the error allowed."""
    width, length, height = 1.0, 5.9, 1e-4
    corners = [[0.0, 0.0], [length, 0.0], [length, height], [0.0, height]]
    loop = Interface.polyline(np.array(corners), closed=True)
    floor = Interface.polyline(np.array(corners[:2]))
    measure = Currents(width, tolerance=0.1)
    exact = (line_product(length, 0.0, width) / width**2 + 2) * height**2  # long walls, and each short one with itself
    assert measure.inner(loop, loop) == pytest.approx(exact, rel=0.01)
    cross = line_product(length, 0.0, width) * -math.expm1(-0.5 * (height / width) ** 2)
    assert abs(measure(floor, loop) - line_product(length, 0.0, width) + 2 * cross - exact) < 0.1 * exact


@pytest.mark.parametrize("ratio", [0.125, 1.0, 4.5, 6.0])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
def test_gauss_order_keeps_its_bound_without_waste(ratio, tolerance):
    """Worst case of the bound's integrand: the kernel itself along the piece, its peak anywhere."""

    def error(order):
        nodes, weights = np.polynomial.legendre.leggauss(order)
        s = 0.5 * ratio * nodes[:, None] - np.linspace(-ratio, ratio, 101)
        edge = (0.5 * ratio + np.linspace(-ratio, ratio, 101)) / math.sqrt(2)
        edges = special.erf(edge) - special.erf(edge - ratio / math.sqrt(2))
        return np.abs(0.5 * weights @ np.exp(-0.5 * s**2) - math.sqrt(np.pi / 2) * edges / ratio).max()

    order = kernel_integrals.gauss_order(ratio, tolerance)
    assert error(order) <= tolerance
    assert order <= 2 or error(max(order // 2, 1)) > tolerance


def test_gauss_order_refuses_what_it_cannot_reach():
    with pytest.raises(NumericsError, match="larger tolerance"):
        kernel_integrals.gauss_order(500.0, 1e-12)


def test_blocks_do_not_change_the_result(monkeypatch):
    observed, simulated = Interface.polyline(ARC), Interface.polyline(ARC + 0.004)

    def products():
        refined = kernel_integrals.refined_product(simulated, observed, 0.011, tolerance=1e-8)
        return refined, kernel_integrals.centre_product(simulated, observed, 0.011)

    whole = products()
    monkeypatch.setattr(kernel_integrals, "BLOCK", 50)
    monkeypatch.setattr(kernel_sums, "BLOCK", 50)
    assert products() == pytest.approx(whole, rel=1e-13)


def test_what_is_kept_of_an_observation_follows_its_content():
    points = ARC.copy()
    observed, simulated = Interface.polyline(points), Interface.polyline(ARC + 0.01)
    measure = Currents(0.02)
    before = measure(simulated, observed)
    observed.points[:] += 0.01
    assert before > 0
    assert measure(simulated, observed) == 0.0


def test_a_copy_of_an_observation_is_recognised():
    observed, moved = Interface.polyline(ARC), Interface.polyline(ARC + 1e-12)
    assert Snapshot.of(observed) == Snapshot.of(Interface.polyline(ARC.copy()))
    assert hash(Snapshot.of(observed)) == hash(Snapshot.of(Interface.polyline(ARC.copy())))
    assert Snapshot.of(observed) != Snapshot.of(moved)


def test_flipped_interface_is_refused_and_can_be_turned():
    observed, simulated = Interface.polyline(ARC), Interface.polyline(ARC + 0.01)
    measure = Currents(0.02)
    with pytest.raises(InvalidInterface, match="oriented_like"):
        measure(simulated, observed.reversed())
    turned, flipped = oriented_like(observed.reversed(), simulated)
    assert flipped
    assert measure(simulated, turned) == pytest.approx(measure(simulated, observed), rel=1e-9)


def test_flipped_circle_is_refused():
    with pytest.raises(InvalidInterface, match="against"):
        Currents(0.1)(circle(1.0, 20), circle(1.1, 20).reversed())


def test_a_surface_cannot_be_compared_with_a_polyline():
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    surface = Interface(corners, np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInterface, match="coordinates"):
        Currents(0.1)(surface, Interface.polyline(ARC))
    with pytest.raises(InvalidInterface, match="coordinates"):
        Currents(0.1).inner(Interface.polyline(ARC), surface)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"width": 0.0}, "width"),
        ({"width": -1.0}, "width"),
        ({"width": math.nan}, "width"),
        ({"width": 1.0, "quadrature": "simpson"}, "quadrature"),
        ({"width": 1.0, "tolerance": 0.0}, "tolerance"),
        ({"width": 1.0, "tolerance": 1.0}, "tolerance"),
    ],
)
def test_invalid_options(options, names):
    with pytest.raises(InvalidInput, match=names):
        Currents(**options)


def test_states_unit_and_that_it_is_no_sum_of_independent_distances():
    assert Currents(0.1).unit == "mm²"
    assert Currents(0.1).terms(Interface.polyline(ARC)) is None


@pytest.mark.parametrize("variance", [1e-5, 1e-4, 5e-4])
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
    seen = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.1], [2.0, 0.0]]))
    assert Currents(0.1, tolerance=0.01).tolerating(1e-12, seen).tolerance == 0.01
    assert Currents(0.1, quadrature="centre").tolerating(1.0, seen) == Currents(0.1, quadrature="centre")


def test_noise_variance_of_independent_points() -> None:
    """A slow change of the offsets e moves d² = ∬ e e' q by as much as white noise of density s²h does: s²h ∫q."""
    angle = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    ring = Interface.polyline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)
    spacing = float(ring.lengths.mean())
    for width, sd in ((0.1, 0.01), (0.2, 0.03)):
        expected = sd**2 * spacing * math.sqrt(2 * math.pi) / width
        assert Currents(width).noise_variance(PointErrors(sd), ring) == pytest.approx(expected, rel=1e-3)
    assert Currents(0.5 * spacing).noise_variance(PointErrors(0.01), ring) is None
