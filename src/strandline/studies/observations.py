"""The observed interface of each condition, from a file of points, a picture or a stack of them."""

from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidStudy
from strandline.interface import Interface, PointErrors
from strandline.models.offers import undeformed_interface
from strandline.models.protocol import ForwardModel, declared_conditions
from strandline.studies.keys.observation import ConditionFile, ObservationFile
from strandline.studies.observed import read_points, read_sds, require_plausible
from strandline.studies.pictures.photographed import Photographed, photographed
from strandline.studies.pictures.scanned import Scanned, scanned

__all__ = ["Found", "read_observation", "read_observations"]


@dataclass(frozen=True, eq=False)
class Found:
    """An observed interface and what is known of its errors.

    Args:
        interface: The interface, mm.
        turned: Whether its points were reversed.
        sds: Standard deviation of each point, mm, if the file holds them.
        picture: The picture in which it was found, if it was.
        stack: The stack of pictures in which it was found, if it was.
    """

    interface: Interface
    turned: bool = False
    sds: Float[np.ndarray, " point"] | None = None
    picture: Photographed | None = None
    stack: Scanned | None = None

    @property
    def errors(self) -> PointErrors | None:
        """Errors of the points that the picture or the stack shows; None without one."""
        shown = self.picture or self.stack
        return None if shown is None else shown.errors


def read_observations(
    folder: Path, source: ObservationFile | list[ConditionFile], model: ForwardModel
) -> dict[str, Found]:
    """Return the observed interfaces by condition."""
    files = {item.condition: item for item in source} if isinstance(source, list) else {"": source}
    known = declared_conditions(model)
    for condition in files:
        if condition not in known:
            raise _unknown_condition(condition, known)
    return {condition: read_observation(folder, item, model) for condition, item in files.items()}


def _unknown_condition(condition: str, known: tuple[str, ...]) -> InvalidStudy:
    if not any(known):
        return InvalidStudy(
            "observation: the model has a single condition without a name",
            value=condition,
            expected="one mapping, observation: {file: …, unit: …}",
            remedy="Remove the list and `condition`, or let the model declare its `conditions`.",
        )
    close = get_close_matches(condition, known, n=1)
    return InvalidStudy(
        "observation: the model has no such condition" if condition else "observation: the condition is not named",
        value=condition or "no name",
        expected=f"some of {', '.join(known)}",
        remedy=f"Did you mean {close[0]}?" if close else "Give a list, - {condition: NAME, file: …, unit: …}.",
    )


def read_observation(folder: Path, source: ObservationFile, model: ForwardModel) -> Found:
    """Return an observed interface in the same direction as the model's.

    Args:
        folder: Folder of the study.
        source: The file and how to read it.
        model: The simulator.
    """
    undeformed = undeformed_interface(model)
    if source.image is not None:
        picture = photographed(folder, source.image, undeformed)
        found, name, unit = Found(picture.interface, picture=picture), f"edge in {picture.name}", ""
    elif source.stack is not None:
        stack = scanned(folder, source.stack)
        found, name, unit = Found(stack.interface, stack=stack), f"surface in {stack.name}", ""
    else:
        path, name, unit = folder / str(source.file), f"observation {source.file}", str(source.unit)
        sds = read_sds(path, unit, options=source.reading)
        found = Found(read_points(path, unit, options=source.reading), sds=sds)
    if undeformed is None:
        return found
    require_plausible(name, found.interface, undeformed, unit=unit)
    if not found.interface.runs_against(undeformed):
        return found
    sds = None if found.sds is None else found.sds[::-1]
    return replace(found, interface=found.interface.reversed(), turned=True, sds=sds)
