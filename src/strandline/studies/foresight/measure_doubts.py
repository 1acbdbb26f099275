"""Doubts about measures and nodes of a study, from the observed interface and one run."""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from strandline.discrepancy import BEYOND as BEYOND_END
from strandline.discrepancy import ClosestPoint, Discrepancy, MeasurementLines, NormalOffset, closest_points, path_of
from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
from strandline.likelihood import adapted
from strandline.runs import RunRecord
from strandline.studies.foresight.first_run import observations_of
from strandline.studies.load.study import Study

MOST_SCATTER = 10.0  # scatter of the measurement lines' directions, degrees, above which it is worth a warning
STEADY = 3.0  # scatter that the suggested option leaves, degrees
PIECE = 4.0  # shortest piece of outline that is suggested, in spacings of the observed points
GAP = 5.0  # longest distance of neighbouring points, in their median, that is no gap
ALONE, FEWEST = 8.0, 20
"""Distance of one observed point from all others, in the next largest such distance, that shows a mistake.
For 20 or more points at random places on a line, it was at most 7.4 in 3,000 draws."""
TO_POINTS = "to_simulated", "sum"  # direction and weighting of closest_point with which only the observed points count
BEYOND = 3.0  # spacings by which the simulated interface may reach beyond the observed one
LONG = 0.1  # correlation length, as a share of the observed interface, from which the noise is overstated
LEAST_SHARE = {"scale": 1.0, "rotation": 0.3}
"""Share of the motion by a wrong scale or angle that the stated shift must allow; sizes are known less than angles."""
TO_UM = 1e3
_END = 0.1  # share of the observed points that show in which direction an end points


def measure_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield a warning for lines that turn with the noise, and for a measure that charges what was not observed."""
    yield from (f"warning: {one}" for one in contradictions(study))
    for condition, seen in observations_of(study).items():
        observation = Observation(seen, study.noise_of(condition), condition)
        run, of = record.interfaces[condition], f" ({condition})" if condition else ""
        if seen.dim != 2 or run.dim != 2:
            continue
        yield from _alone(seen, of)
        yield from _long(observation, of)
        if condition in study.pictures:
            yield from _held(observation, of)
        for chosen in study.discrepancies.values():
            measure = adapted(chosen, observation)
            yield from _gap(measure, seen, of)
            if isinstance(measure, MeasurementLines):
                yield from _turning(measure, seen, of)
            elif isinstance(measure, ClosestPoint):
                yield from _unseen(measure, seen, run, of)
            elif isinstance(measure, NormalOffset):
                yield from _past_the_end(seen, run, of)


def contradictions(study: Study) -> Iterator[str]:
    """Yield the errors of outlines in pictures that contradict each other: too small a shift beside scale or rotation.

    Scale and rotation about the origin of the frame, a click, also move the middle of the observed points.
    """
    for condition in study.pictures:
        errors, of = study.noise_of(condition), f" ({condition})" if condition else ""
        if not isinstance(errors, PointErrors | UnknownErrors):
            continue
        away = float(np.hypot(*study.observed[condition].points.mean(axis=0)))
        moved = {"scale": errors.scale * away, "rotation": math.radians(errors.rotation) * away}
        name = max(moved, key=lambda one: LEAST_SHARE[one] * moved[one])
        if errors.shift < LEAST_SHARE[name] * moved[name]:
            yield (
                f"the errors of the outline{of} contradict each other: an error of {name} about the origin of the "
                f"picture's frame moves its middle, {away:.3g} mm away, by {TO_UM * moved[name]:.3g} µm, but "
                f"shift allows {TO_UM * errors.shift:.3g} µm; the posterior becomes too narrow. State a shift of at "
                f"least {TO_UM * moved[name]:.3g} µm"
            )


def _held(observation: Observation, of: str) -> Iterator[str]:
    errors = observation.noise
    held = isinstance(errors, PointErrors | UnknownErrors) and not (errors.shift or errors.rotation or errors.scale)
    if held:
        yield (
            f"warning{of}: no error of place and size is stated. A picture cannot show how far its origin, angle and "
            "pixel size are off: state `unknown: {shift: …, rotation: …, scale: …}` in `noise`"
        )


def _alone(seen: Interface, of: str) -> Iterator[str]:
    if len(seen.points) < FEWEST:
        return
    nearest = cKDTree(seen.points).query(seen.points, k=2)[0][:, 1]
    usual, far = np.sort(nearest)[-2:]
    if far > ALONE * usual:
        at = ", ".join(f"{one:.4g}" for one in seen.points[np.argmax(nearest)])
        yield (
            f"warning{of}: the observed point at ({at}) mm lies {far:.3g} mm from all others, which have a neighbour "
            f"within {usual:.3g} mm; leave it out if it is a mistake"
        )


def _long(observation: Observation, of: str) -> Iterator[str]:
    noise, whole = observation.noise, float(observation.interface.lengths.sum())
    if isinstance(noise, PointErrors) and noise.length > LONG * whole:
        yield (
            f"warning{of}: errors of the points are correlated over {noise.length:.3g} mm, "
            f"{100 * noise.length / whole:.0f} % of the observed interface; above {100 * LONG:.0f} % the posterior "
            "comes out too wide; state what all points share as a shift, rotation, scale or offset under noise.unknown"
        )


def _gap(measure: Discrepancy, seen: Interface, of: str) -> Iterator[str]:
    points_only = isinstance(measure, NormalOffset)
    points_only |= isinstance(measure, ClosestPoint) and (measure.direction, measure.weighting) == TO_POINTS
    longest = float(seen.lengths.max())
    if not points_only and len(seen.lengths) > 2 and longest > GAP * float(np.median(seen.lengths)):
        yield (
            f"warning{of}: neighbouring observed points are up to {longest:.3g} mm apart, {GAP:g} times the usual "
            "distance or more, and the measure takes such a gap for a straight piece of the interface; if nothing was "
            "seen there, take the measure normal_offset"
        )


def _turning(measure: MeasurementLines, seen: Interface, of: str) -> Iterator[str]:
    scatter = measure.scatter(seen)
    if scatter > MOST_SCATTER:
        yield (
            f"warning{of}: the directions of the measurement lines scatter by {scatter:.0f}°, because they turn with "
            "the noise of single points; take them from longer pieces of the interface, "
            f"`smooth: {_steady_piece(measure, seen, scatter)}` (mm), or take the measure normal_offset"
        )


def _steady_piece(measure: MeasurementLines, seen: Interface, scatter: float) -> str:
    """Return a length w, mm, rounded up, over which points as noisy (sd s) as these turn a chord by 3°: by √2 s/w."""
    spacing = float(np.median(seen.lengths))
    present = max(measure.smooth or 0.0, spacing)
    length = max(PIECE * spacing, present * scatter / STEADY)
    digit = 10.0 ** (math.floor(math.log10(length)) - 1)
    return f"{math.ceil(length / digit - 1e-6) * digit:.2g}"  # 1e-6: rounding is no reason to go up


def _unseen(measure: ClosestPoint, seen: Interface, run: Interface, of: str) -> Iterator[str]:
    if measure.direction == "to_simulated" or seen.closed or run.closed:
        return
    spacing = max(float(np.median(one.lengths)) for one in (seen, run))
    beyond = _overhang(run, seen)
    if beyond > BEYOND * spacing:
        yield (
            f"warning{of}: the simulated interface reaches {beyond:.3g} mm beyond an end of the observed one, and "
            "closest_point charges its nodes there; if only a part was observed, take `direction: to_simulated` or "
            "the measure normal_offset"
        )


def _past_the_end(seen: Interface, run: Interface, of: str) -> Iterator[str]:
    if seen.closed or run.closed:
        return
    past = _overhang(seen, run)
    if past > BEYOND_END * float(run.lengths.sum()):
        yield (
            f"warning{of}: the observed interface reaches {past:.3g} mm past an end of the simulated one; points that "
            "far out are compared with its end, so leave them out, or let the model return more of the interface"
        )


def _overhang(one: Interface, other: Interface) -> float:
    """Return how far one open interface reaches past the ends of another, mm."""
    tips, path = path_of(one), path_of(other)
    return max(_beyond(path, other, tips[-1]), _beyond(path[::-1], other, tips[0]))


def _beyond(path: Float[np.ndarray, "point 2"], seen: Interface, tip: Float[np.ndarray, "2"]) -> float:
    """Return how far a tip lies beyond the last point of the observed path, along it, mm; 0 if it lies beside it."""
    end = path[-1]
    along = end - path[-1 - max(1, round(_END * (len(path) - 1)))]
    if not np.allclose(closest_points(tip[None], seen).points[0], end, rtol=0.0, atol=1e-9 * float(np.ptp(path))):
        return 0.0
    return max(float((tip - end) @ along) / float(np.linalg.norm(along)), 0.0)


SHARE = 4 / 45  # mean square of a parabola about its mean, in squares of its height
MOST = 1.0  # change of d² from which the nodes are too few
CORNER = 0.3  # turn of the polyline, radians, from which it counts as a corner of the shape itself


def node_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield a warning for each condition whose simulated polyline has too few nodes for the errors of the points.

    Nothing is said where the model itself makes the observation, or for measures other than signed distances.
    """
    if study.truth is not None or not isinstance(study.measure, NormalOffset):
        return
    for seen in study.observations(observations_of(study)):
        condition = seen.condition
        errors, one = seen.errors, record.interfaces[condition]
        if errors is None or one.dim != 2:
            continue
        local, sagittas = errors.model(seen.interface).local, _sagittas(one)
        change = 2 * SHARE * float(np.mean(sagittas**2)) * float((1 / local).sum())
        if change > MOST:
            of = f" ({condition})" if condition else ""
            times = int(np.ceil(change**0.25 * 10)) / 10
            yield (
                f"warning{of}: between its nodes the simulated polyline is up to {1e3 * sagittas.max():.2g} µm off "
                f"the smooth curve, too far for {len(seen.interface.points)} points with this noise; let the simulator "
                f"return at least {times:g} times as many nodes"
            )


def _sagittas(polyline: Interface) -> Float[np.ndarray, " segment"]:
    """Return the height of the arc over each segment, mm, from the mean of the angles by which its ends turn."""
    step = polyline.ends - polyline.starts
    after = np.roll(step, -1, axis=0)
    turn = np.abs(np.arctan2(step[:, 0] * after[:, 1] - step[:, 1] * after[:, 0], (step * after).sum(axis=1)))
    turn = np.where(turn < CORNER, turn, 0.0)
    before = np.roll(turn, 1)
    if not polyline.closed:
        turn[-1], before[0] = before[-1], turn[0]
    return np.asarray(polyline.lengths * 0.5 * (turn + before) / 8)
