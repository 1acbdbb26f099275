"""A course of the inflow, divided where something happens."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from strandline.models.biofilm.course import Course

__all__ = ["Piece", "pieces"]


@dataclass(frozen=True)
class Piece:
    """A stretch of time in which the inflow changes linearly, or a sudden change of it.

    Args:
        begin: Its beginning, s.
        end: Its end, s; the same for a sudden change.
        from_share: Share of the full inflow at the beginning.
        to_share: Share at the end.
    """

    begin: float
    end: float
    from_share: float
    to_share: float

    @property
    def is_sudden(self) -> bool:
        """Whether the inflow jumps."""
        return self.begin == self.end

    def share(self, time: float) -> float:
        """Return the share of the full inflow at a time between beginning and end."""
        if time >= self.end:
            return self.to_share
        return self.from_share + (self.to_share - self.from_share) * (time - self.begin) / (self.end - self.begin)


def pieces(course: Course) -> Iterator[Piece]:
    """Yield the pieces of a course until the last time observed, divided at all times observed."""
    observed = [time for _, time in course.times]
    end = observed[-1]
    for (begin, first), (until, second) in pairwise(course.inflow):
        whole = Piece(begin, until, first, second)
        if begin > end or (begin == end and not whole.is_sudden):
            return
        if whole.is_sudden:
            yield whole
            continue
        marks = [begin, *(time for time in observed if begin < time < until), until]
        for a, b in pairwise(time for time in marks if time <= end):
            yield Piece(a, b, whole.share(a), whole.share(b))
