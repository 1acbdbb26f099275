"""specimens.jsonl: the posteriors of specimens, one a line, each as soon as it is known."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from strandline.parameters import ParameterSpace
from strandline.population import Certified, SpecimenPosterior

__all__ = ["SpecimenLines"]

ARRAYS = ("mean", "covariance", "quantiles", "draws")


@dataclass(frozen=True)
class SpecimenLines:
    """A file of posteriors, one a line, each with the digest of all that it depends on.

    Args:
        path: The file; it need not exist.
        space: All inputs of the study.
    """

    path: Path
    space: ParameterSpace

    def read(self) -> dict[str, SpecimenPosterior]:
        """Return the posteriors by digest; remove a last line that was not written to its end."""
        if not self.path.is_file():
            return {}
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            with self.path.open("r+b") as file:
                file.truncate(len(whole))
        entries = (_parsed(line) for line in whole.splitlines())
        return {str(one["of"]): self._posterior(one) for one in entries if self._ours(one)}

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
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

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


def _parsed(line: bytes) -> dict[str, Any]:
    """Return the content of a line; empty if it is not one of ours."""
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
