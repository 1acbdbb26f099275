"""Recognise an observed interface, or a measure, by its content, to reuse what was computed for it."""

from dataclasses import dataclass, field
from typing import Any

from strandline.interface import Interface

__all__ = ["MeasureKey", "Snapshot"]


@dataclass(frozen=True)
class Snapshot:
    """An interface that equals another with the same points and cells: a key for `functools.lru_cache`.

    A copy in another process is recognised as the same interface; an array that was modified is not.
    """

    content: bytes
    interface: Interface = field(compare=False)

    @classmethod
    def of(cls, interface: Interface) -> "Snapshot":
        """Return the key of `interface` as it is now."""
        return cls(interface.points.tobytes() + interface.cells.tobytes(), interface)


@dataclass(frozen=True)
class MeasureKey:
    """A measure that equals another of the same type that prints the same: a key for `functools.lru_cache`."""

    text: str
    measure: Any = field(compare=False)

    @classmethod
    def of(cls, measure: Any) -> "MeasureKey":
        """Return the key of a measure; one that prints its address equals only itself."""
        return cls(f"{type(measure).__module__}.{measure!r}", measure)
