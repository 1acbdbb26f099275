"""The observed interface of each condition: from a file of points, a picture, a stack, or synthetic with noise."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import imaging
from strandline.discrepancy import extent, extent_ratio, unit_mistake
from strandline.foundations import InvalidInput, InvalidStudy, suggestion
from strandline.interface import Interface, PointErrors
from strandline.models import ForwardModel, declared_conditions, undeformed_interface
from strandline.readers import Reading, read_interface, read_point_sds
from strandline.studies.keys.observation import ConditionFile, ObservationFile, StackFile
from strandline.studies.keys.parse import made, refused_at
from strandline.studies.load.photographed import Photographed, frame_note, photographed, picture_reading

PLACE = "observation.stack"


@dataclass(frozen=True, eq=False)
class Scanned:
    """A stack, the surface in it, and where it lies in the model's coordinates.

    The surface is in voxels, its errors in mm, as is the `interface`. `placed` says where the model lies in it, and who
    said so.
    """

    stack: imaging.Stack
    frame: imaging.StackFrame
    surface: imaging.Surface
    interface: Interface
    placed: str = ""

    @property
    def name(self) -> str:
        return self.stack.name

    @property
    def errors(self) -> PointErrors:
        """Errors of the interface's points that the stack shows: local ones and a common offset."""
        found = self.surface.errors
        return PointErrors(found.sd, found.length, offset=found.offset)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences that say what was taken from where, and what of the solid the stack shows."""
        found, notes = self.surface.errors, [*self.stack.notes, *([self.placed] if self.placed else [])]
        if found.open_share > 0:
            notes.append(f"the surface is open: the faces of the stack cut off {100 * found.open_share:.2g} % of it")
        if found.area_share < 0.999:
            notes.append(f"the largest of several surfaces, {100 * found.area_share:.3g} % of their area")
        if self.surface.left_out:
            left = f"{self.surface.left_out} triangles in excluded regions left out"
            notes.append(f"{left}: `closest_point` does not compare there, but currents compare whole surfaces")
        return tuple(notes)


def scanned(folder: Path, given: StackFile) -> Scanned:
    """Return the surface in a stack of a study."""
    with refused_at():
        stack = imaging.read_stack([folder / name for name in given.files], _reading(given))
        frame = made(imaging.StackFrame, given.frame or {}, f"{PLACE}.frame", voxel=stack.voxel)
        exclude = [
            made(imaging.StatedRegion, one, f"{PLACE}.exclude[{k}]").within(frame)
            for k, one in enumerate(given.exclude)
        ]
        surface = imaging.find_surface(
            stack, solid=given.solid, triangles=given.triangles, smooth=given.smooth, exclude=exclude
        )
        return Scanned(stack, frame, surface, frame.interface(surface.mesh), frame_note(frame, given.frame))


def _reading(given: StackFile) -> imaging.PictureReading:
    how = picture_reading(given.reading, PLACE)
    if given.voxel is None:
        return how
    if isinstance(given.voxel, dict) and given.voxel.get("size") is not None:
        raise InvalidStudy(
            f"{PLACE}.voxel", value=given.voxel, expected="x, y and z", remedy="Write {x: 6, y: 6, z: 10, unit: um}."
        )
    return imaging.PictureReading(**how.given, pixel=made(imaging.StatedSize, given.voxel, f"{PLACE}.voxel").in_mm)


@dataclass(frozen=True)
class SyntheticNoise:
    """Independent Gaussian noise on every node coordinate of a synthetic observation: its sd, mm, and its seed."""

    sd: float
    seed: int


def noisy(interfaces: Mapping[str, Interface], noise: SyntheticNoise | None) -> dict[str, Interface]:
    """Return synthetic observations by condition, Y = M + σ ε with ε ~ N(0, I) (Willmann et al. 2022, Eq. 16).

    The random numbers of a condition depend on its name and the seed alone. Without `noise` nothing changes.
    """
    if noise is None:
        return dict(interfaces)
    return {condition: _disturbed(interface, condition, noise) for condition, interface in interfaces.items()}


def _disturbed(interface: Interface, condition: str, noise: SyntheticNoise) -> Interface:
    random = np.random.default_rng([noise.seed, *condition.encode()])
    moved = replace(interface, points=interface.points + noise.sd * random.standard_normal(interface.points.shape))
    try:
        moved.require_simple()
    except InvalidInput as error:
        what = f"observation.noise: with it, {error.what}"
        expected = f"noise well below the distance of the nodes, {float(np.median(interface.lengths)):.2g} mm"
        remedy = "Lower observation.noise.sd, which is in mm."
        raise InvalidStudy(what, value=f"sd: {noise.sd:g}", expected=expected, remedy=remedy) from None
    return moved


def read_points(
    path: Path, unit: str, *, what: str = "observation", options: Mapping[str, Any] | None = None
) -> Interface:
    """Return the interface in a file, in mm; for a text file without `options`, the open polyline of its points.

    Each line of such a file holds x and y, separated by a comma, a semicolon or blanks; a first line of column names
    and lines that begin with # are skipped. The points are in order along the interface. The options are those of
    `strandline.readers.Reading`; `what` names the points in messages.
    """
    with refused_at():
        reading = made(Reading, {**(options or {}), "file": path.name, "unit": unit}, what)
        return read_interface(path, reading, name=f"{what} {path.name}")


def read_sds(path: Path, unit: str, *, options: Mapping[str, Any]) -> Float[np.ndarray, " point"] | None:
    """Return the standard deviations of observed points, mm; None if `options` name no column with them."""
    if options.get("sd") is None:
        return None
    reading = made(Reading, {**options, "file": path.name, "unit": unit}, "observation")
    with refused_at():
        return read_point_sds(path, reading, name=f"observation {path.name}")


def require_plausible(name: str, observed: Interface, simulated: Interface, *, unit: str = "") -> None:
    """Refuse an interface ten times larger or smaller than the model's, deformed or not: a wrong unit."""
    ratio = extent_ratio(observed, simulated)
    mistake = unit_mistake(ratio)
    if mistake:
        raise InvalidStudy(
            f"size of the {name}{f', read in {unit}' if unit else ''}",
            value=f"{extent(observed):.4g} mm across, {ratio:.3g} times the model's interface",
            expected=f"about {extent(simulated):.4g} mm, the size of the model's interface",
            remedy=f"P{mistake[1:]}. Correct the unit of the observation or of its pixels, the file or the model.",
        )


@dataclass(frozen=True, eq=False)
class Found:
    """An observed interface, mm, whether its points were reversed, and what is known of their errors.

    `sds` are the standard deviations of the points, mm, if the file holds them. It may come from a picture or a stack.
    """

    interface: Interface
    turned: bool = False
    sds: Float[np.ndarray, " point"] | None = None
    picture: Photographed | None = None
    stack: Scanned | None = None

    @property
    def errors(self) -> PointErrors | None:
        shown = self.picture or self.stack
        return None if shown is None else shown.errors


def read_observations(
    folder: Path, source: ObservationFile | list[ConditionFile], model: ForwardModel
) -> dict[str, Found]:
    """Return the observed interfaces by condition."""
    files = {item.condition: item for item in source} if isinstance(source, list) else {"": source}
    for condition in files:
        require_condition(condition, declared_conditions(model), "observation")
    return {condition: read_observation(folder, item, model) for condition, item in files.items()}


def require_condition(name: str, known: Collection[str], place: str) -> None:
    """Refuse a condition that the model does not have; a model with a single one has no name for it."""
    if name not in known:
        what = f"{place}: the model has no such condition"
        expected = f"some of {', '.join(known)}" if any(known) else "no name, since the model has a single condition"
        remedy = suggestion(name, known, "Correct the name, or give one." if any(known) else "Remove it.")
        raise InvalidStudy(what, value=name or "no name", expected=expected, remedy=remedy)


def read_observation(folder: Path, source: ObservationFile, model: ForwardModel) -> Found:
    """Return an observed interface in the same direction as the model's."""
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
