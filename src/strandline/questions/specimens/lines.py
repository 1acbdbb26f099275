"""specimens.jsonl: the posteriors of specimens, one a line, each as soon as it is known."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np

from strandline.parameters import ParameterSpace
from strandline.population import Certified, SpecimenPosterior
from strandline.questions.line_file import LineFile
from strandline.studies.folder import SPECIMENS_LINES
from strandline.studies.study import Study

__all__ = ["SpecimenLines", "lines_of"]

ARRAYS = ("mean", "covariance", "quantiles", "draws")


@dataclass(frozen=True)
class SpecimenLines:
    """A file of posteriors, one a line, each with the digest of all that it depends on.

    Args:
        lines: The file.
        space: All inputs of the study.
    """

    lines: LineFile
    space: ParameterSpace

    def held(self) -> AbstractContextManager[None]:
        """Keep other commands from writing to the file.

        Raises:
            InvalidStudy: Another command holds the file, or its folder cannot be written to.
        """
        return self.lines.held("strandline specimens", "posteriors")

    def read(self) -> dict[str, SpecimenPosterior]:
        """Return the posteriors by digest."""
        return {str(one["of"]): self._posterior(one) for one in self.lines.entries() if self._ours(one)}

    def append(self, one: SpecimenPosterior, of: str) -> None:
        """Add a posterior.

        Args:
            one: The posterior.
            of: Digest of all that it depends on.
        """
        entry = {
            "of": of,
            "specimen": one.name,
            "given": dict(one.given),
            "inputs": list(one.space.names),
            **{name: getattr(one, name).tolist() for name in ARRAYS},
            "effective": one.effective,
            "by": one.by,
            "shift": one.certified.shift,
            "surprise": one.certified.surprise,
        }
        self.lines.append(entry)

    def _ours(self, entry: Mapping[str, Any]) -> bool:
        names = entry.get("inputs")
        return "of" in entry and isinstance(names, list) and set(names) <= set(self.space.names)

    def _posterior(self, entry: Mapping[str, Any]) -> SpecimenPosterior:
        arrays: dict[str, Any] = {name: np.array(entry[name], float) for name in ARRAYS}
        return SpecimenPosterior(
            name=entry["specimen"],
            given=entry["given"],
            space=ParameterSpace(tuple(self.space[name] for name in entry["inputs"])),
            effective=entry["effective"],
            by=entry["by"],
            certified=Certified(entry["shift"], entry["surprise"]),
            **arrays,
        )


def lines_of(study: Study) -> SpecimenLines:
    """Return the file of a study's specimens."""
    return SpecimenLines(LineFile(study.folder / SPECIMENS_LINES), study.space)
