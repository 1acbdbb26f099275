"""Euclidean distance along measurement lines, Eq. (6) of the study."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.discrepancy.many_distances import motion, similar
from strandline.discrepancy.protocol import ManyPoints, Snapshot, Values, require_polylines
from strandline.foundations import require
from strandline.interface import Interface, PointErrors, normals_at, steady_lengths

Places = Float[np.ndarray, "*place"]
REACH = 0.25  # default reach of a measurement line, as a share of the length of the observed interface

_BLOCK = 256  # interfaces that `many` processes together
_STEADY = 0.2  # noise, in lengths of the piece of outline whose direction a line takes, up to which the line is steady
_ROUGH = 0.3
"""Difference between the errors of neighbouring points, in their spacing, up to which segments keep their length."""
_PIECE = 20.0
"""Length of the piece of outline whose direction a line takes, in sds of the points, where these are stated."""
_FEWEST_BENDS = 8  # number of bends between neighbouring segments from which they show the noise of the points
_TRIMMED = 0.05  # share of the interface at each end that gets no line where the errors of the points are stated
MOST_TRIMMED = 0.4  # largest such share
MOST_LINES = 100_000  # largest number of lines in a measure; each costs memory and time in every comparison
Bases = Float[np.ndarray, "line 4"]
Cells = Int[np.ndarray, "cell 2"]


@dataclass(frozen=True, eq=False)
class LineReadings:
    """Readings of the measurement lines on one simulated interface, and which `missed` it within their reach.

    `distances` are signed, from the observed to the simulated interface, mm; positive in the line's direction, the
    reach if the line misses.
    """

    distances: Float[np.ndarray, " line"]
    missed: Bool[np.ndarray, " line"]


@dataclass(frozen=True)
class MeasurementLines:
    """d² = Σ over the lines of (distance along the line between simulated and observed interface)², mm²; Eq. (6).

    Args:
        lines: Number of lines, or the lines themselves as rows (x, y, dx, dy) in mm: a point and a direction of any
            length; a line extends to both sides. A number n places them on the observed interface at the fractions
            (i + ½)/n, i = 0 … n-1, of its arc length, so each line represents an equal share of it and none lies at an
            end; the direction is the normal of the segment there, or with `smooth` that of a longer piece.
        reach: Largest distance along a line that is considered, mm; by default a quarter of the observed length.
        smooth: Length of the piece of the observed interface around a line's point whose chord sets the direction, mm,
            at most 0.4 of the whole; by default that of the single segment. With points of sd s the directions are off
            by √2 s over this length. Only for a number of lines.
        trim: Share of an open observed interface at each end that gets no line, from 0 to 0.4; by default 0, or 0.05 if
            the errors of the points are stated: a line near an end may miss an interface that is shifted by a little.
            Only for a number of lines.

    For observed points with sd s and correlation length ℓ, and lines Δ mm apart, the noise variance σ_N² is about
    s² max(1, 2ℓ/Δ); a study with ``noise: {sd: s, length: ℓ, unit: mm}`` takes it, and pieces of 20 s for ``smooth``.

    A line that does not meet the simulated interface within its reach contributes reach²: the measure is bounded
    by n · reach² and stays continuous when a crossing moves out of reach. If there are several crossings, the one
    nearest the observed point counts. A given line starts at its crossing with the observed interface nearest (x, y).

    Raises:
        InvalidInput: fewer than one line, a line without direction, a reach or piece that is not above 0, a piece for
            given lines; on evaluation, a given line that misses the observed interface.
    """

    lines: int | Sequence[Sequence[float | int]] | Float[np.ndarray, "line 4"] = 10
    reach: float | None = field(default=None, kw_only=True)
    smooth: float | None = field(default=None, kw_only=True)
    trim: float | None = field(default=None, kw_only=True)
    unit: ClassVar[str] = "mm²"

    def __post_init__(self) -> None:
        if not isinstance(self.lines, int):
            object.__setattr__(self, "lines", _checked_lines(self.lines))
        else:
            _require_lines(1 <= self.lines <= MOST_LINES, f"{self.lines} lines")
        given = "" if isinstance(self.lines, int) else " with given lines"
        remedy = "Correct it, or leave it out for a quarter of the observed length."
        require(_is_length(self.reach), "reach of the measurement lines", self.reach, "a length in mm above 0", remedy)
        right = self.smooth is None or (not given and _is_length(self.smooth))
        remedy = "Correct it; leave it out for given lines, which have their own directions."
        expected = "a length in mm above 0, for a number of lines"
        require(right, "smooth of the measurement lines", f"{self.smooth}{given}", expected, remedy)
        right = self.trim is None or (not given and 0 <= self.trim <= MOST_TRIMMED)
        expected = f"a share from 0 to {MOST_TRIMMED:g}, for a number of lines"
        remedy = "Correct it; leave it out for given lines."
        require(right, "trim of the measurement lines", f"{self.trim}{given}", expected, remedy)

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d², mm²."""
        return float(np.sum(self.read(simulated, observed).distances ** 2))

    def read(self, simulated: Interface, observed: Interface) -> LineReadings:
        """Return the signed distance of each line and whether it missed."""
        require_polylines(simulated, observed)
        reach = self.reach_on(observed)
        found = _nearest_crossings(simulated.points, simulated.cells, _placed(self, Snapshot.of(observed)))
        missed = ~(np.abs(found) <= reach)
        return LineReadings(np.where(missed, reach, found), missed)

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values:
        """Return d² of polylines with the same segments, mm²."""
        require_polylines(template, observed)
        reach, lines = self.reach_on(observed), _placed(self, Snapshot.of(observed))
        out = np.empty(len(points))
        for rows in similar(points, _BLOCK):
            distances = _least_distances(points[rows], template.cells, lines, reach)
            out[rows] = np.sum(distances**2, axis=1)
        return out

    def reach_on(self, observed: Interface) -> float:
        """Return the reach in use on `observed`, mm."""
        return REACH * float(observed.lengths.sum()) if self.reach is None else self.reach

    def place(self, observed: Interface) -> Float[np.ndarray, "line 4"]:
        """Return the lines on `observed`: the observed point and the unit direction, (line, 4)."""
        require_polylines(observed)
        return _placed(self, Snapshot.of(observed)).copy()

    def noise_variance(self, errors: PointErrors, observed: Interface) -> float | None:
        """Return σ_N² = s² max((2 + ρ)/3, 2ℓ/Δ), mm², for lines Δ mm apart.

        ρ = exp(-h/ℓ) is the correlation of points h apart: a line crosses the outline somewhere between two of them,
        where the error has (2 + ρ)/3 of their variance in the mean. None if the noise lengthens the segments, so that
        most lines meet those with large errors, or turns the lines by more than some degrees. Given lines do not turn.
        """
        if isinstance(self.lines, int) and errors.sd > _STEADY * self._piece(observed):
            return None
        lengths = steady_lengths(observed)
        apart = (1 - 2 * self._trimmed(observed)) * float(lengths.sum()) / self.terms(observed)
        spacing = float(lengths.mean())
        alike = math.exp(-spacing / errors.length) if errors.length > 0 else 0.0
        if errors.sd * math.sqrt(2 * (1 - alike)) > _ROUGH * spacing:
            return None
        between = (2 + alike) / 3
        return errors.sd**2 * max(between, 2 * errors.length / apart)

    def adapted(self, errors: PointErrors | None) -> "MeasurementLines":
        """Return lines that points with these errors turn by 4° at most, away from the ends."""
        if errors is None or not isinstance(self.lines, int):
            return self
        smooth = _PIECE * errors.sd if self.smooth is None else self.smooth
        return replace(self, smooth=smooth, trim=_TRIMMED if self.trim is None else self.trim)

    def scatter(self, observed: Interface) -> float:
        """Return the standard deviation of the lines' directions that noise of the observed points causes, degrees.

        Second differences of the directions of neighbouring segments show it: independent errors of the points make
        them √10 times as large as those of a direction. Their median is taken, so that a few corners do not count.
        0 for given lines.
        """
        require_polylines(observed)
        steps = observed.ends - observed.starts
        bends = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])), 2)
        if not isinstance(self.lines, int) or len(bends) < _FEWEST_BENDS:
            return 0.0
        of_segment = 1.4826 * float(np.median(np.abs(bends))) / math.sqrt(10)
        return math.degrees(of_segment) * float(np.median(observed.lengths)) / self._piece(observed)

    def terms(self, observed: Interface) -> int:
        """Return the number of independent distances: one per line."""
        return self.lines if isinstance(self.lines, int) else len(self.lines)

    def _trimmed(self, observed: Interface) -> float:
        """Return the share of the interface at each end that gets no line; a closed one has no end."""
        return 0.0 if observed.closed else self.trim or 0.0

    def _piece(self, observed: Interface) -> float:
        """Return the length of the piece whose direction a line takes, mm: at least that of a segment."""
        return max(self.smooth or 0.0, float(np.median(observed.lengths)))


@lru_cache(maxsize=64)
def _placed(measure: MeasurementLines, snapshot: Snapshot) -> Bases:
    observed = snapshot.interface
    if isinstance(measure.lines, int):
        return _equally_spaced(observed, measure.lines, measure.smooth, measure._trimmed(observed))
    lines = np.array(measure.lines, float)
    lines[:, 2:] /= np.hypot(lines[:, 2], lines[:, 3])[:, None]
    offsets = _nearest_crossings(observed.points, observed.cells, lines)
    where, expected = int(np.argmin(np.isfinite(offsets))), "a line (x, y, dx, dy) that crosses it"
    remedy = "Move the line or leave it out."
    what = f"measurement line {where} misses the observed interface"
    require(np.isfinite(offsets).all(), what, lines[where].tolist(), expected, remedy)
    lines[:, :2] += offsets[:, None] * lines[:, 2:]
    return lines


def _equally_spaced(observed: Interface, number: int, smooth: float | None, trim: float) -> Bases:
    ends = np.cumsum(observed.lengths)
    wanted = (trim + (1 - 2 * trim) * (np.arange(number) + 0.5) / number) * ends[-1]
    segment = np.minimum(np.searchsorted(ends, wanted), len(ends) - 1)
    back = (ends[segment] - wanted) / observed.lengths[segment]
    points = observed.ends[segment] + back[:, None] * (observed.starts - observed.ends)[segment]
    if smooth is not None:
        return np.hstack([points, normals_at(observed, wanted, 0.5 * smooth)])
    return np.hstack([points, (observed.normals / observed.lengths[:, None])[segment]])


def _nearest_crossings(points: Float[np.ndarray, "point 2"], cells: Cells, lines: Bases) -> Float[np.ndarray, " line"]:
    """Return the signed distance from each line's point to its nearest crossing with a polyline; inf if none."""
    along, side = _components(points, lines[:, None])
    i, j = cells.T
    place = _crossings(along[:, i], along[:, j], side[:, i], side[:, j])
    nearest = np.argmin(np.abs(place), axis=-1)
    return np.asarray(np.take_along_axis(place, nearest[..., None], axis=-1)[..., 0])


def _least_distances(points: ManyPoints, cells: Cells, lines: Bases, reach: float) -> Float[np.ndarray, "run line"]:
    """Return the distance from each line's point to its nearest crossing with each polyline; at most `reach`. Only
    segments that may cross the line within its reach in some run are considered.
    """
    line, cell = np.nonzero(_may_cross(points, cells, lines, reach))
    out = np.full((len(points), len(lines)), reach)
    if len(line):
        i, j = cells[cell].T
        (along_i, side_i), (along_j, side_j) = (_components(points[:, k], lines[line]) for k in (i, j))
        first = np.flatnonzero(np.diff(line, prepend=-1))
        distances = np.abs(_crossings(along_i, along_j, side_i, side_j))
        out[:, line[first]] = np.minimum(np.minimum.reduceat(distances, first, axis=1), reach)
    return out


def _may_cross(points: ManyPoints, cells: Cells, lines: Bases, reach: float) -> Bool[np.ndarray, "line cell"]:
    middle, moved = motion(points)
    along, side = _components(middle, lines[:, None])
    moved = moved + 1e-9 * float(np.abs(middle).max() + np.abs(lines).max())  # far more than rounding
    i, j = cells.T

    def beyond(values: Float[np.ndarray, "line point"], bound: float) -> Bool[np.ndarray, "line cell"]:
        far = values - moved > bound
        return np.asarray(far[:, i] & far[:, j])

    return np.asarray(~(beyond(side, 0.0) | beyond(-side, 0.0) | beyond(along, reach) | beyond(-along, reach)))


def _components(
    points: Float[np.ndarray, "*#place 2"], lines: Float[np.ndarray, "*#line 4"]
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return how far points lie along lines, measured from the lines' points, and how far to their left."""
    x, y = np.moveaxis(points - lines[..., :2], -1, 0)
    dx, dy = np.moveaxis(lines[..., 2:], -1, 0)
    return x * dx + y * dy, dx * y - dy * x


def _crossings(along_i: Places, along_j: Places, side_i: Places, side_j: Places) -> Places:
    """Return where along a line the segment from i to j crosses it; inf if it does not."""
    span, step = side_i - side_j, along_j - along_i
    nearest = np.divide(-along_i, step, out=np.zeros_like(step), where=step != 0)  # of a segment along the line
    share = np.divide(side_i, span, out=np.clip(nearest, 0.0, 1.0), where=span != 0)
    return np.where(side_i * side_j <= 0, along_i + share * step, np.inf)


def _checked_lines(
    lines: Sequence[Sequence[float | int]] | Float[np.ndarray, "line 4"],
) -> tuple[tuple[float, ...], ...]:
    rows = tuple(tuple(float(value) for value in row) for row in lines)
    _require_lines(rows, "no line")
    for row in rows:
        _require_lines(len(row) == 4 and all(map(math.isfinite, row)) and (row[2], row[3]) != (0, 0), list(row))
    return rows


def _is_length(value: float | None) -> bool:
    return value is None or (math.isfinite(value) and value > 0)


def _require_lines(right: object, value: object) -> None:
    expected = f"a number of lines from 1 to {MOST_LINES}, or rows (x, y, dx, dy) of finite numbers, dx or dy not 0"
    require(right, "number or rows of the measurement lines", value, expected, "Correct the lines.")
