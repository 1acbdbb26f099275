"""What must hold for any pair of curves: rigid motions, symmetry, the triangle inequality, refinement."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, TrackedPoints
from strandline.interface import Interface

MEASURES = [
    TrackedPoints(),
    MeasurementLines(7),
    ClosestPoint(),
    ClosestPoint(direction="symmetric", weighting="length"),
    Currents(0.02),
    Currents(0.3, tolerance=1e-9),
    Currents(0.1, quadrature="centre"),
]
heights = st.lists(st.floats(-0.2, 0.2), min_size=6, max_size=6)
angles, shifts = st.floats(-math.pi, math.pi), st.floats(-10.0, 10.0)
thousandths = st.lists(st.integers(20, 980), min_size=1, max_size=5)
quick = settings(max_examples=25, deadline=None)


def curve(y) -> Interface:
    return Interface.polyline(np.stack([np.linspace(0.0, 1.0, len(y)), np.array(y)], axis=1))


def moved(interface: Interface, angle: float, dx: float, dy: float) -> Interface:
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return Interface.polyline(interface.points @ turn + [dx, dy])


@quick
@given(a=heights, b=heights, angle=angles, dx=shifts, dy=shifts)
def test_measures_are_not_negative_zero_at_home_and_unchanged_by_moving_both(a, b, angle, dx, dy):
    simulated, observed = curve(a), curve(b)
    for measure in MEASURES:
        before = measure(simulated, observed)
        assert math.isfinite(before)
        assert before >= 0.0
        assert measure(simulated, simulated) <= 1e-25
        after = measure(*(moved(one, angle, dx, dy) for one in (simulated, observed)))
        assert after == pytest.approx(before, rel=1e-7, abs=1e-11)


@quick
@given(a=heights, b=heights, c=heights)
def test_currents_are_a_metric(a, b, c):
    a, b, c = curve(a), curve(b), curve(c)
    for measure in (one for one in MEASURES if isinstance(one, Currents)):
        slack = 2e-6 * measure.inner(a, a)
        assert measure(a, b) == pytest.approx(measure(b, a), abs=slack)
        ab, bc, ac = (measure(*pair) for pair in ((a, b), (b, c), (a, c)))
        assert math.sqrt(max(ac - slack, 0.0)) <= math.sqrt(ab + slack) + math.sqrt(bc + slack)


@quick
@given(a=heights, b=heights, cuts=thousandths, width=st.floats(0.002, 5.0))
def test_refined_currents_do_not_see_the_nodes(a, b, cuts, width):
    """Cut every segment of one curve at the same shares."""
    shares = np.unique([0, *cuts]) / 1000
    whole = curve(a)
    points = whole.starts[:, None] + shares[:, None] * (whole.ends - whole.starts)[:, None]
    cut = Interface.polyline(np.vstack([points.reshape(-1, 2), whole.ends[-1:]]))
    measure, observed = Currents(width), curve(b)
    error = abs(measure(cut, observed) - measure(whole, observed))
    assert error <= measure.tolerance * measure.inner(observed, observed)


@quick
@given(a=heights, scale=st.floats(0.01, 100.0))
def test_currents_scale_with_the_square_of_the_length(a, scale):
    observed, simulated = curve([0.0] * 6), curve(a)
    larger = [Interface.polyline(scale * i.points) for i in (simulated, observed)]
    d2 = Currents(0.1, tolerance=1e-9)(simulated, observed)
    assert Currents(0.1 * scale, tolerance=1e-9)(*larger) == pytest.approx(scale**2 * d2, rel=1e-7, abs=1e-9 * scale**2)


@quick
@given(a=heights, b=heights, reach=st.floats(0.01, 1.0))
def test_some_measures_have_bounds(a, b, reach):
    """Closest points are never farther than tracked ones, lines reach as far as they do."""
    assert ClosestPoint()(curve(a), curve(b)) <= TrackedPoints()(curve(a), curve(b)) * (1 + 1e-12)
    assert MeasurementLines(7, reach=reach)(curve(a), curve(b)) <= 7 * reach**2 * (1 + 1e-12)
