"""Recognise an observed interface by its content, so that what was computed for it once serves every simulation."""

from dataclasses import dataclass, field

from strandline.interface import Interface

__all__ = ["Snapshot"]


@dataclass(frozen=True)
class Snapshot:
    """An interface that equals another with the same points and cells: a key for `functools.lru_cache`.

    Neither a copy in another process nor an array written to afterwards is taken for what it is not.
    """

    content: bytes
    interface: Interface = field(compare=False)

    @classmethod
    def of(cls, interface: Interface) -> "Snapshot":
        """Return the key of `interface` as it is now."""
        return cls(interface.points.tobytes() + interface.cells.tobytes(), interface)
