"""Many interfaces at once against one after the other."""

import numpy as np
import pytest
from tests.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import (
    DISCREPANCIES,
    ClosestPoint,
    Currents,
    Discrepancy,
    MeasurementLines,
    TrackedPoints,
    squared_discrepancies,
)
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS
from strandline.discrepancy.currents import QUADRATURES
from strandline.discrepancy.products.many_currents import BLOCK
from strandline.errors import InvalidInterface
from strandline.interface import Interface

LINES = [[x, 0.0, 0.1, 1.0] for x in (0.2, 0.5, 0.8)]
EXACT: list[Discrepancy] = [
    MeasurementLines(),
    MeasurementLines(3),
    MeasurementLines(7, reach=0.05),
    MeasurementLines(LINES),
    TrackedPoints(),
    *(ClosestPoint(direction=d, weighting=w) for d in DIRECTIONS for w in WEIGHTINGS),
]
CURRENTS = [Currents(width, quadrature=quadrature) for width in (0.02, 0.1, 0.6) for quadrature in QUADRATURES]
CUT_OFF = 2e-5
"""What pairs beyond the reach and single precision take from the currents, of <T,T>."""


def runs(kind: str, number: int, *, seed: int = 1, noise: float = 0.02) -> tuple[np.ndarray, Interface, Interface]:
    """Return points of perturbed interfaces, a template and an observed interface."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, 24)
    if kind == "open":
        base = Interface.polyline(np.stack([s, 0.2 * np.sin(4 * s)], axis=1))
    elif kind == "closed":
        base = Interface.polyline(
            np.stack([np.cos(2 * np.pi * s[:-1]), 0.6 * np.sin(2 * np.pi * s[:-1])], axis=1), closed=True
        )
    else:
        base = sheet(5, bend=0.1) if kind == "sheet" else sphere(1.0, 1)
    seen = Interface(base.points + 0.5 * noise * rng.standard_normal(base.points.shape), base.cells)
    smooth = rng.normal(size=(number, 1, base.dim)) * np.sin(3 * base.points.sum(axis=1))[:, None]
    jagged = 0.2 * rng.standard_normal((number, *base.points.shape))
    return base.points + noise * (smooth + jagged), base, seen


def one_by_one(measure: Discrepancy, points: np.ndarray, template: Interface, seen: Interface) -> np.ndarray:
    return np.array([measure(Interface(row, template.cells), seen) for row in points])


@pytest.mark.parametrize("kind", ["open", "closed"])
@pytest.mark.parametrize("measure", EXACT, ids=str)
def test_distances_are_the_same(measure: Discrepancy, kind: str) -> None:
    if kind == "closed" and isinstance(measure, MeasurementLines) and not isinstance(measure.lines, int):
        measure = MeasurementLines([[0.2, 0.0, 0.1, 1.0], [-0.3, 0.1, 1.0, 0.2]])
    points, template, seen = runs(kind, 40, noise=0.03)
    found = squared_discrepancies(measure, points, template, seen)
    np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def within(measure: Discrepancy, found: np.ndarray, expected: np.ndarray, seen: Interface) -> bool:
    """Tell whether d² is right: currents to 2 % of d² and 2e-4 of <T,T> where segments are cut into pieces."""
    bound = 1e-10
    if isinstance(measure, Currents):
        square = measure.inner(seen, seen)
        bound = CUT_OFF * square if measure.quadrature == "centre" else 2e-4 * square + 0.02 * expected
    return bool((found >= 0).all() and (np.abs(found - expected) < bound).all())


@pytest.mark.parametrize("kind", ["open", "closed"])
@pytest.mark.parametrize("measure", CURRENTS, ids=str)
def test_currents_are_the_same_to_a_bound(measure: Currents, kind: str) -> None:
    points, template, seen = runs(kind, 12)
    found = squared_discrepancies(measure, points, template, seen)
    expected = one_by_one(measure, points, template, seen)
    assert within(measure, found, expected, seen)
    assert not within(measure, 1.05 * found + 4e-4 * measure.inner(seen, seen), expected, seen)


@pytest.mark.parametrize("kind", ["open", "closed"])
@pytest.mark.parametrize("width", [0.05, 0.1, 0.6])
def test_short_pieces_leave_the_cut_off_only(width: float, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of the midpoint rule, at kinks and open ends, goes with the square of a piece."""
    points, template, seen = runs(kind, 4)
    measure, errors = Currents(width), []
    expected = one_by_one(measure, points, template, seen)
    for longest in (0.4, 0.2, 0.1):
        monkeypatch.setattr("strandline.discrepancy.products.many_currents.LONGEST_PIECE", longest)
        found = squared_discrepancies(measure, points, template, seen)
        errors.append(float(np.abs(found - expected).max()) / measure.inner(seen, seen))
    assert errors[2] < 5e-5
    assert errors[2] < 0.5 * errors[0] + CUT_OFF


@pytest.mark.parametrize("kind", ["sheet", "sphere"])
@pytest.mark.parametrize(
    "measure",
    [TrackedPoints(), ClosestPoint(), ClosestPoint(direction="symmetric", weighting="length"), Currents(0.5)],
    ids=str,
)
def test_surfaces_are_the_same(measure: Discrepancy, kind: str) -> None:
    points, template, seen = runs(kind, 3)
    found = squared_discrepancies(measure, points, template, seen)
    np.testing.assert_allclose(found, one_by_one(measure, points, template, seen), rtol=1e-11, atol=1e-14)


def test_every_registered_measure_is_looked_at() -> None:
    looked_at = {type(measure) for measure in EXACT} | {type(measure) for measure in CURRENTS}
    assert looked_at == set(DISCREPANCIES.values())


@pytest.mark.parametrize("number", [0, 1, BLOCK, 2 * BLOCK + 3])
def test_blocks_come_back_in_their_order(number: int) -> None:
    """They are sorted by place inside."""
    points, template, seen = runs("open", number, noise=0.01)
    for measure in (Currents(0.1, quadrature="centre"), Currents(0.1), ClosestPoint()):
        found = squared_discrepancies(measure, points, template, seen)
        assert found.shape == (number,)
        some = np.arange(0, number, 37)
        expected = one_by_one(measure, points[some], template, seen)
        assert within(measure, found[some], expected, seen)


def test_a_pair_out_of_reach_in_one_run_only_is_not_left_out() -> None:
    """Planted: a batch where one run lies beside the observed interface and all others far from it."""
    points, template, seen = runs("open", 60)
    points[1:] += 10.0
    measure = Currents(0.05)
    found = squared_discrepancies(measure, points, template, seen)
    expected = one_by_one(measure, points, template, seen)
    assert within(measure, found, expected, seen)
    assert found[0] < 0.5 * found[1:].min()


def test_interfaces_need_not_have_the_nodes_of_the_observed_one() -> None:
    points, template, seen = runs("open", 10)
    coarse = seen.resampled(9)
    for measure in (MeasurementLines(4), ClosestPoint(), Currents(0.1)):
        found = squared_discrepancies(measure, points, template, coarse)
        expected = one_by_one(measure, points, template, coarse)
        assert within(measure, found, expected, coarse)
    with pytest.raises(InvalidInterface, match="do not correspond"):
        squared_discrepancies(TrackedPoints(), points, template, coarse)


def test_a_plain_function_will_do() -> None:
    points, template, seen = runs("open", 5)

    def largest(simulated: Interface, observed: Interface) -> float:
        return float(np.max((simulated.points - observed.points) ** 2))

    expected = np.max((points - seen.points) ** 2, axis=(1, 2))
    np.testing.assert_array_equal(squared_discrepancies(largest, points, template, seen), expected)
