"""Errors of an edge from several frames of one state: how far the edge differs from frame to frame.

The edge is found in each frame, along the normals on which it was found in their mean. What differs between n frames
has 1/√n of its standard deviation in their mean, and the same correlation length. An error that all frames share, such
as speckle of a body at rest, an offset or the place of the picture, shows in none of them.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Bool, Int

from strandline.discrepancy import errors_from_repeats
from strandline.foundations import named
from strandline.imaging.edges.edge import Edge
from strandline.imaging.edges.edge_checks import require_edge
from strandline.imaging.edges.strip import grey_values
from strandline.imaging.picture import Picture
from strandline.interface import Interface, PointErrors

MOST = 30
"""Most frames in which the edge is found."""


@dataclass(frozen=True)
class FrameErrors:
    """Errors of the edge in the mean of several frames, lengths in the unit of the pixel size, rotation in degrees.

    Args:
        frames: Number of frames whose mean was taken.
        compared: Number of frames in which the edge was found.
        one: Errors in one frame, from the differences between frames.
        picture_sd: Standard deviation of a point as the mean picture alone shows it.
        picture_length: Correlation length as the mean picture alone shows it.
        notes: Sentences on what makes these numbers doubtful.
    """

    frames: int
    compared: int
    one: PointErrors
    picture_sd: float
    picture_length: float
    notes: tuple[str, ...] = ()

    @property
    def mean(self) -> PointErrors:
        """Errors in the mean of the frames, without those that all of them share."""
        names = ("sd", "shift", "rotation", "scale", "offset")
        return replace(self.one, **{name: getattr(self.one, name) / math.sqrt(self.frames) for name in names})

    @property
    def larger(self) -> bool:
        """Whether the frames show more noise at low frequencies, s²ℓ, than the mean picture alone."""
        return self.mean.sd**2 * self.mean.length > self.picture_sd**2 * self.picture_length

    def put_into(self, edge: Edge) -> Edge:
        """Return the edge with the errors of the larger s²ℓ, and with the offset of the mean in its offset."""
        found, mean = edge.errors, self.mean
        sd, length = (mean.sd, mean.length) if self.larger else (found.sd, found.length)
        return replace(edge, errors=replace(found, sd=sd, length=length, offset=math.hypot(found.offset, mean.offset)))


def errors_from_frames(
    frames: Iterable[Picture], edge: Edge, *, number: int, exclude: Sequence[np.ndarray] = ()
) -> FrameErrors:
    """Return the errors of an edge in the mean of several frames.

    Args:
        frames: The frames.
        edge: Edge in their mean.
        number: Number of frames; of more than 30, at most 30 are compared, evenly spread.
        exclude: Polygons in pixel coordinates that are left out.

    Raises:
        InvalidInput: Fewer than two frames, one that says too little of the edge by itself, or frames whose edges
            cannot be compared, for instance because they are identical.
    """
    piece = _longest(edge.kept, closed=edge.strip.course.closed)
    chosen = islice(enumerate(frames, 1), 0, None, -(-number // MOST))
    found = [_in_frame(frame, k, edge, exclude, piece) for k, frame in chosen]
    repeats, own = errors_from_repeats(found), edge.errors
    notes = [note.replace("pictures", "frames") for note in repeats.notes if "did the outline change" in note]
    return FrameErrors(number, len(found), repeats.errors, own.sd, own.length, tuple(notes))


def _in_frame(
    frame: Picture, number: int, edge: Edge, exclude: Sequence[np.ndarray], piece: Int[np.ndarray, " normal"]
) -> Interface:
    """Return the edge in one frame along the normals of a piece."""
    picture = grey_values(frame.values, pixel=frame.pixel, exclude=exclude)
    with named(f"frame {number} by itself", "Give means of several frames each."):
        located = edge.method.locate(picture, edge.strip.course, edge.kept)
        kept = located.found & edge.kept
        points, limit = int(kept.sum()), int((located.at_limit & kept).sum())
        share, blur = limit / max(points, 1), located.blur * picture.unit
        shown = replace(edge.errors, contrast_to_noise=located.contrast_to_noise, limit_share=share, blur=blur)
        require_edge(points, shown, unit=picture.unit)
    return Interface.polyline(picture.unit * located.points[piece[located.found[piece]]], closed=edge.closed)


def _longest(kept: Bool[np.ndarray, " normal"], *, closed: bool) -> Int[np.ndarray, " kept"]:
    """Return the numbers of the normals of the longest piece without a gap."""
    if kept.all():
        return np.arange(len(kept))
    start = int(np.argmin(kept)) if closed else 0
    order = np.roll(np.arange(len(kept)), -start)
    steps = np.diff(np.concatenate([[False], kept[order], [False]]).astype(int))
    begins, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    longest = int(np.argmax(ends - begins))
    return order[begins[longest] : ends[longest]]
