"""Recognise an observed interface by its content, to reuse what was computed for it in every simulation."""

from dataclasses import dataclass, field

from strandline.interface import Interface

__all__ = ["Snapshot"]


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
