"""The undeformed outline of the flow cell from a picture, and what its errors add to those of the observation."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from strandline.imaging import Outlined, outline_of
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.studies.keys.observation import ImageFile
from strandline.studies.keys.parse import checked, refused_at
from strandline.studies.pictures.photographed import Photographed, photographed

IMAGE = "image"
"""Option of an outline that names a picture instead of points."""


@dataclass(frozen=True, eq=False)
class Undeformed:
    """The smooth outline through the edge in a picture, and the noise of the conditions without its errors."""

    picture: Photographed
    outline: Outlined
    noises: Mapping[str, Noise | PointErrors | UnknownErrors] = field(default_factory=dict)

    def options(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options `given` of an outline with its points instead of the picture."""
        rest = {key: value for key, value in given.items() if key != IMAGE}
        return {**rest, "points": self.outline.points.tolist(), "spline": False}

    @property
    def errors(self) -> PointErrors:
        """Errors of the outline: local ones, and a common offset."""
        return PointErrors(self.outline.sd, self.outline.length, offset=self.picture.edge.errors.offset)


def undeformed_picture(choice: Mapping[str, Mapping[str, Any] | None]) -> ImageFile | None:
    """Return the section of the picture that gives the model its outline, if one does."""
    (name, options) = next(iter(choice.items()))
    outline = (options or {}).get("outline")
    if not isinstance(outline, Mapping) or IMAGE not in outline:
        return None
    return checked(ImageFile, outline[IMAGE], f"model.{name}.outline.{IMAGE}")


def undeformed_in(choice: Mapping[str, Mapping[str, Any] | None], folder: Path) -> Undeformed | None:
    """Return the outline in a picture that the model is to have, if the study names one."""
    given = undeformed_picture(choice)
    if given is None:
        return None
    picture = photographed(folder, given, None)
    path = picture.frame.to_mm(picture.path)
    path = path if path[0, 0] < path[-1, 0] else path[::-1]
    points = picture.interface.points
    points = points if points[0, 0] < points[-1, 0] else points[::-1]
    found = picture.edge.errors
    with refused_at():
        return Undeformed(picture, outline_of(points, path, sd=found.sd, length=found.length))


def with_errors_of(
    undeformed: Undeformed | None, noise: Noise | PointErrors | UnknownErrors, seen: Interface, *, conditions: int
) -> Noise | PointErrors | UnknownErrors:
    """Return the noise of an observation together with the errors of the undeformed outline in a picture.

    An error of the undeformed outline moves the simulated interface by nearly as much: variances add, and so do the
    integrals s²ℓ of the covariances. The outline is the same in all conditions; since each is compared on its own, its
    variances count as many times as there are conditions, so that no number of them can make it better known. A noise
    of the measure stays as it is.
    """
    if undeformed is None or not isinstance(noise, PointErrors | UnknownErrors):
        return noise
    own = undeformed.errors
    offset = math.hypot(noise.offset, math.sqrt(conditions) * own.offset)
    if not isinstance(noise.sd, float) or not isinstance(noise.length, float):
        return replace(noise, offset=offset)
    added = conditions * own.sd**2
    spacing = float(np.median(seen.lengths))
    length = max(noise.length, 0.5 * spacing)
    sd = math.sqrt(noise.sd**2 + added)
    length = (noise.sd**2 * length + added * own.length) / sd**2
    if isinstance(noise, UnknownErrors):
        return replace(noise, sd=sd, length=length, offset=offset)
    shares = tuple(math.sqrt((share * noise.sd) ** 2 + added) / sd for share in noise.shares)
    return replace(noise, sd=sd, length=length, offset=offset, shares=shares)
