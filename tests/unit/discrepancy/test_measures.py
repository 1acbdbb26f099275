"""What every measure shares: protocol, registry, properties of any pair; sizes, units, noise and registered sums."""

import math

import numpy as np
import pytest
from tests.unit.discrepancy.curves import graph, level, line, ring
from tests.unit.discrepancy.surfaces import sheet

from strandline.discrepancy import (
    DISCREPANCIES,
    ClosestPoint,
    Currents,
    Discrepancy,
    JointErrors,
    MeasurementLines,
    TrackedPoints,
    apart,
    count_of_distances,
    extent,
    extent_ratio,
    independent_terms,
    joint_errors,
    noise_units,
    oriented_like_runs,
    sums_of,
    unit_mistake,
    unit_of,
)
from strandline.discrepancy.normal_offset import weighted_sums
from strandline.foundations import InvalidInput, InvalidInterface
from strandline.interface import Interface, Observation, PointErrors

LINE = level(0.0, 3, length=2.0)


@pytest.mark.parametrize("name", DISCREPANCIES)
def test_every_measure_satisfies_the_protocol_and_knows_surfaces(name):
    measure = DISCREPANCIES[name](**({"width": 0.2} if name == "currents" else {}))
    assert isinstance(measure, Discrepancy)
    assert unit_of(measure) == unit_of(measure, LINE) == "mm²"
    assert independent_terms(measure, LINE) is None or independent_terms(measure, LINE) > 0
    assert isinstance(measure(LINE, LINE), float)
    simulated, observed = sheet(4, height=0.1), sheet(4)
    if isinstance(measure, MeasurementLines):
        with pytest.raises(InvalidInterface, match="plane"):
            measure(simulated, observed)
        return
    assert measure(simulated, observed) > 0
    assert measure(observed, observed) == pytest.approx(0.0, abs=1e-12)
    assert unit_of(measure, observed) == ("mm⁴" if isinstance(measure, Currents) else "mm²")


def test_options_that_cannot_be():
    for kind, options, said in (
        (ClosestPoint, {"direction": "sideways"}, "direction"),
        (Currents, {"width": 0.0}, "width"),
        (Currents, {"width": 1.0, "quadrature": "simpson"}, "quadrature"),
        (Currents, {"width": 1.0, "tolerance": 1.0}, "tolerance"),
        (MeasurementLines, {"lines": 0}, "measurement lines"),
        (MeasurementLines, {"lines": ((0.0, 0.0, 0.0, 0.0),)}, "measurement lines"),
        (MeasurementLines, {"reach": math.inf}, "reach"),
        (MeasurementLines, {"trim": 0.5}, "trim"),
    ):
        with pytest.raises(InvalidInput, match=said):
            kind(**options)


CURRENTS = [Currents(0.02), Currents(0.3, tolerance=1e-9), Currents(0.1, quadrature="centre")]
MEASURES = [TrackedPoints(), MeasurementLines(7), ClosestPoint(direction="symmetric", weighting="length"), *CURRENTS]


def test_measures_are_not_negative_zero_at_home_and_unchanged_by_moving_both():
    random, x = np.random.default_rng(1), np.linspace(0.0, 1.0, 6)
    for _ in range(20):
        simulated, observed = (graph(x, random.uniform(-0.2, 0.2, 6)) for _ in range(2))
        angle, shift = random.uniform(-math.pi, math.pi), random.uniform(-10.0, 10.0, 2)
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        for measure in MEASURES:
            before = measure(simulated, observed)
            assert 0.0 <= before < math.inf
            assert measure(simulated, simulated) <= 1e-25
            after = measure(*(Interface.polyline(one.points @ turn + shift) for one in (simulated, observed)))
            assert after == pytest.approx(before, rel=1e-7, abs=1e-11)


def test_the_unit_that_was_mistaken_is_guessed_from_the_ratio_of_sizes():
    """An observation in µm that is read in mm appears a thousand times as large as the model's."""
    for ratio, observed, read_in, factor in ((800.0, "µm", "mm", "1000"), (1e-3, "mm", "µm", "1000")):
        said = unit_mistake(ratio)
        assert f"the observation is in {observed} and was read in {read_in}" in said
        assert f"differ by a factor of {factor})" in said
    assert unit_mistake(1.0) == unit_mistake(9.0) == unit_mistake(1 / 9) == ""
    low, high = line((1, 2), (1.2, 2.1)), line((1, 2), (1.3, 2.8))
    assert (extent(high), extent_ratio(high, low)) == pytest.approx((0.8, 4.0))


def test_a_sum_of_distances_counts_by_their_root_mean_square_and_what_is_no_sum_as_a_whole():
    """Eleven nodes are 0.3 mm off, under noise of 0.1 mm."""
    simulated, observed, measure = level(0.3), level(0.0, nodes=5), ClosestPoint()
    count = count_of_distances(measure, simulated, observed)
    assert count == 11
    assert noise_units(measure(simulated, observed), 0.1**2, count) == pytest.approx(3.0)
    assert count_of_distances(Currents(0.1), simulated, observed) is None
    assert noise_units(0.09, 0.01, None) == pytest.approx(3.0)


def test_the_worse_direction_tells_how_far_interfaces_are_apart():
    """The end of the longer one is (0.3, 0.4) mm from that of the shorter one, whose nodes are all 0.3 mm from it."""
    short, long = level(0.0), line((0, 0.3), (1, 0.3), (1.4, 0.3))
    for one, other in ((short, long), (long, short)):
        assert apart(one, other) == pytest.approx((np.sqrt((0.3**2 + 0.3**2 + 0.5**2) / 3), 0.5))


def test_global_errors_are_estimated_from_some_points_and_the_sums_taken_over_all(monkeypatch):
    """Residuals of a line that is 0.3 too high, with a shift of sd 1 along each axis, and with none."""
    seen, above, asked = level(0.0), level(0.3), []
    number = len(seen.points)

    def recorded(*arguments, rough, longer):
        asked.append(rough)
        return weighted_sums(*arguments, rough=rough, longer=longer)

    monkeypatch.setattr(joint_errors, "weighted_sums", recorded)
    for shift, rough in ((1.0, [True, True, False]), (0.0, [False])):
        errors = PointErrors(0.5, shift=shift)
        joint = JointErrors((Observation(seen, errors),), (errors,))
        squares, products = sums_of(joint, {"": above.points[None]}, {"": above})
        np.testing.assert_allclose(squares, number * 0.3**2 / 0.5**2)
        expected = [[0.0, -number * 0.3 / 0.5**2]] if shift else np.empty((1, 0))
        np.testing.assert_allclose(products, expected, atol=1e-12)
        assert asked == rough
        asked.clear()


def leaning(height: float) -> Interface:
    s = np.linspace(0.0, 1.0, 41)
    return graph(s, height * s * (1 - s) * (1 + s))


RUNS = [leaning(height) for height in np.linspace(0.1, 3.0, 30)]


@pytest.mark.parametrize("reverse", [False, True])
def test_an_observation_is_run_through_as_most_of_the_nearest_runs(reverse):
    """An arch; a ring; arcs of a closed outline with hollows, in which an arc bends the other way."""
    angle = np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
    radius = 1 + 0.4 * np.cos(3 * angle)
    whole = graph(radius * np.cos(angle), radius * np.sin(angle), closed=True)
    arcs = [Interface.polyline(whole.points[first : first + 14] * 1.01) for first in (0, 12, 25, 40)]
    others = [(leaning(0.8).resampled(17), RUNS), (ring(40), [ring(40), ring(40, 1.1)])]
    for seen, runs in [*others, *((arc, [whole]) for arc in arcs)]:
        found = oriented_like_runs(seen.reversed() if reverse else seen, runs)
        assert found.flipped == reverse
        np.testing.assert_array_equal(found.interface.points, seen.points)


def test_runs_far_away_of_another_kind_or_alone_do_not_vote():
    """They come first, and some are more."""
    far = [leaning(height).reversed() for height in np.linspace(5.0, 6.0, 40)]
    huge, flipped = Interface.polyline(1e160 * RUNS[0].points).reversed(), leaning(0.8).reversed()
    for others in (far, [huge], [flipped]):
        assert not oriented_like_runs(leaning(0.8), [*others, *RUNS]).flipped
    assert oriented_like_runs(leaning(5.5), [*RUNS, *far]).flipped
    assert not oriented_like_runs(ring(40), [RUNS[0].reversed()]).flipped
    here, there = (Interface(ring(9).points + np.array([middle, 0.0]), ring(9).cells) for middle in (1.0, 9.0))
    assert not oriented_like_runs(here, [*[there.reversed()] * 9, *[here] * 5]).flipped
