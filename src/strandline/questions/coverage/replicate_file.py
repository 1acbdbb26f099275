"""coverage.jsonl: the replicates of an experiment one by one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from strandline.calibration.coverage import Replicate
from strandline.questions.line_file import LineFile

__all__ = ["ReplicateFile"]

ARRAYS = ("truth", "ranks", "mean", "sd", "limit")
NUMBERS = ("fit_rank", "effective")


@dataclass(frozen=True)
class ReplicateFile:
    """A file of replicates, one a line, each with the digest of all that it depends on; others are left alone.

    Args:
        lines: The file.
        key: Digest of what the replicates to read and to write depend on, apart from their numbers.
    """

    lines: LineFile
    key: str

    def read(self) -> dict[int, Replicate]:
        """Return the replicates by number."""
        return {int(one["number"]): _replicate(one) for one in self.lines.entries() if one.get("of") == self.key}

    def append(self, one: Replicate) -> None:
        """Add a replicate."""
        arrays = {name: getattr(one, name).tolist() for name in ARRAYS}
        numbers = {name: getattr(one, name) for name in NUMBERS}
        self.lines.append({"of": self.key, "number": one.number, **arrays, **numbers, "by": one.by})


def _replicate(entry: Mapping[str, Any]) -> Replicate:
    arrays: dict[str, Any] = {name: np.array(entry[name], float) for name in ARRAYS}
    numbers: dict[str, Any] = {name: float(entry[name]) for name in NUMBERS}
    return Replicate(number=int(entry["number"]), by=entry["by"], **arrays, **numbers)
