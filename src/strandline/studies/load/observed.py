"""The observed interface of each condition: from a file of points, a picture, a stack, or synthetic; and its noise."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import imaging
from strandline.discrepancy import Discrepancy, NormalOffset, require_plausible
from strandline.foundations import InvalidInput, InvalidStudy, require, suggestion
from strandline.interface import GaussianNoise, Interface, Noise, PointErrors, UnknownErrors
from strandline.likelihood import require_inferable_noise
from strandline.models import ForwardModel, declared_conditions, undeformed_interface
from strandline.readers import TO_MM, Reading, read_interface, read_point_sds
from strandline.studies.keys import observation as keys
from strandline.studies.keys.parse import entry, made, refused_at
from strandline.studies.load.photographed import Photographed, frame_note, photographed, picture_reading

PLACE = "observation.stack"


@dataclass(frozen=True, eq=False)
class Scanned:
    """A stack, the surface in it, and where it lies in the model's coordinates.

    The surface is in voxels, its errors and the `interface` in mm. `placed` says where the model lies, and who said so.
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


def scanned(folder: Path, given: keys.StackFile) -> Scanned:
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


def _reading(given: keys.StackFile) -> imaging.PictureReading:
    how = picture_reading(given.reading, PLACE)
    if given.voxel is None:
        return how
    one_size = isinstance(given.voxel, dict) and given.voxel.get("size") is not None
    words = "x, y and z", "Write {x: 6, y: 6, z: 10, unit: um}."
    require(not one_size, f"{PLACE}.voxel", given.voxel, *words, InvalidStudy)
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
    folder: Path, source: keys.ObservationFile | list[keys.ConditionFile], model: ForwardModel
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


def read_observation(folder: Path, source: keys.ObservationFile, model: ForwardModel) -> Found:
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
        sds = None
        if "sd" in source.reading:
            reading = made(Reading, {**source.reading, "file": path.name, "unit": unit}, "observation")
            with refused_at():
                sds = read_point_sds(path, reading, name=f"observation {path.name}")
        found = Found(read_points(path, unit, options=source.reading), sds=sds)
    if undeformed is None:
        return found
    with refused_at():
        require_plausible(name, found.interface, undeformed, unit=unit)
    if not found.interface.runs_against(undeformed):
        return found
    sds = None if found.sds is None else found.sds[::-1]
    return replace(found, interface=found.interface.reversed(), turned=True, sds=sds)


Stated = float | str | tuple[float, float] | None


def build_noise(
    given: keys.ConditionNoise, names: Sequence[str], found: Found | None = None
) -> Noise | PointErrors | UnknownErrors:
    """Return the noise that a section states, lengths in mm."""
    if given.unit is None:
        return GaussianNoise(given.squared)
    mm, unknown = TO_MM[given.unit], given.unknown or keys.Unknown()
    common: dict[str, Any] = {"shift": mm * unknown.shift, "rotation": unknown.rotation, "scale": unknown.scale}
    common["offset"] = mm * unknown.offset
    if found is not None and found.picture is not None:
        place = found.picture.errors
        if unknown.shared and (place.shift or place.rotation):
            expected = "pictures without a registration, each of which has an error of its own"
            raise InvalidStudy("noise.unknown.shared", value=True, expected=expected, remedy="Leave shared out.")
        common |= {name: math.hypot(common[name], getattr(place, name)) for name in ("shift", "rotation")}
    sd, length = _in_mm(given.sd, mm), _in_mm(given.length or 0.0, mm)
    sds = None if found is None else found.sds
    if given.sd == keys.COLUMN and sds is None:
        expected = "a table with the standard deviation of each point"
        remedy = "Name its column, `observation: {file: …, sd: COLUMN}`, or state one sd for all points."
        raise InvalidStudy("noise.sd", value=keys.COLUMN, expected=expected, remedy=remedy)
    for name in given.spread:
        entry(dict.fromkeys(names), name, "noise.spread")
    spread = tuple(names.index(name) for name in given.spread)
    if given.sd == keys.IMAGE:
        seen = _shown(given, found)
        sd, length, common["offset"] = seen.sd, seen.length, common["offset"] or seen.offset
    with refused_at():
        if given.sd == keys.COLUMN:
            known = isinstance(length, float)
            value = f"{keys.COLUMN}, with {'a model error or a spread' if known else 'an unknown length'}"
            remedy = "Remove model_error and spread." if known else "State the length, or write `sd: unknown`."
            right = known and not given.model_error and not given.spread
            require(right, "noise.sd", value, "a known length and no model error", remedy)
            assert sds is not None
            return PointErrors.of_each(sds, length=length, **common, shared=unknown.shared)
        if isinstance(sd, float) and isinstance(length, float) and not (given.model_error or spread):
            return PointErrors(sd, length, **common, shared=unknown.shared)
        if unknown.shared:
            expected = "a known sd and length, no model_error and no spread"
            raise InvalidInput("noise.unknown.shared", value=True, expected=expected, remedy="Leave shared out.")
        return UnknownErrors(sd, length, **common, model_error=given.model_error, spread=spread)


def _shown(given: keys.ConditionNoise, found: Found | None) -> PointErrors:
    seen = None if found is None else found.errors
    if seen is None:
        expected = "an observation that comes from a picture or a stack of them"
        remedy = "State the sd of the points, or write `observation: {image: …}` or `{stack: …}`."
        raise InvalidStudy("noise.sd", value=keys.IMAGE, expected=expected, remedy=remedy)
    if given.length is not None:
        expected = "the length that the picture shows"
        remedy = "Leave it out, or state sd and length as numbers, as `strandline image` prints them."
        raise InvalidStudy("noise.sd", value=f"{keys.IMAGE}, with a length", expected=expected, remedy=remedy)
    return seen


def require_offset(given: keys.ConditionNoise) -> None:
    """Refuse an edge in a picture whose offset along the normals is known exactly: no threshold is."""
    stated = given.unknown is not None and "offset" in given.unknown.model_fields_set
    if given.of_points and not (given.unknown and given.unknown.offset) and (stated or given.sd != keys.IMAGE):
        expected = "above 0 for an edge in a picture, which is always found a little too far in or out"
        remedy = f"Write `sd: {keys.IMAGE}`, which estimates it, or about 0.1 pixels for a camera, 0.4 for OCT."
        raise InvalidStudy("noise.unknown.offset", value=0, expected=expected, remedy=remedy)


def require_unit(given: keys.ConditionNoise, measures: Iterable[Discrepancy]) -> None:
    """Refuse an sd of observed points without a unit: the measure normal_offset has no other noise."""
    if given.sd is not None and not given.of_points and any(isinstance(one, NormalOffset) for one in measures):
        what = "noise.sd, of an observed point"
        expected = "`unit: um` or `unit: mm` beside it, for the measure normal_offset"
        remedy = f"Write `{{sd: {given.sd:g}, unit: um}}` if that is what you mean."
        raise InvalidStudy(what, value=f"{given.sd:g} without a unit", expected=expected, remedy=remedy)


def _in_mm(given: Stated, mm: float) -> tuple[float, float] | float | None:
    if isinstance(given, tuple):
        return mm * given[0], mm * given[1]
    return mm * given if isinstance(given, float) else None


def require_fits(noise: Noise | PointErrors | UnknownErrors, seen: Interface) -> None:
    """Refuse errors whose correlation is longer than half the observed interface."""
    if isinstance(noise, PointErrors | UnknownErrors):
        with refused_at("noise"):
            noise.require_fits(seen)


def require_inferable(noises: Sequence[object], measure: Discrepancy, *, by_field: bool) -> None:
    """Refuse unknown noise where nothing can infer it."""
    if len(noises) < 2 and any(isinstance(noise, UnknownErrors) and noise.spread for noise in noises):
        expected, remedy = "several, whose inputs may differ", "Remove spread."
        raise InvalidStudy("noise.spread", value="one condition", expected=expected, remedy=remedy)
    with refused_at():
        require_inferable_noise(noises, measure, by_field=by_field)


def require_shared(noises: Mapping[str, object]) -> None:
    """Refuse errors shared by the conditions if not all conditions share them, or state different ones."""
    stated = {
        name: (one.shift, one.rotation, one.scale) if isinstance(one, PointErrors) and one.shared else None
        for name, one in noises.items()
    }
    first = next((name for name, one in stated.items() if one is not None), None)
    other = next((name for name, one in stated.items() if first is not None and one != stated[first]), None)
    if other is not None:
        what, own = f"noise.unknown.shared of condition {first}", stated[other] is None
        value = f"condition {other} with {'its own errors' if own else 'another shift, rotation or scale'}"
        expected = "the same shift, rotation and scale, shared by all conditions"
        remedy = f"State the same shift, rotation and scale for {other}, with `shared: true`, or leave shared out."
        raise InvalidStudy(what, value=value, expected=expected, remedy=remedy)


def require_stated(noises: Iterable[object], command: str) -> None:
    """Refuse unknown noise where the true model's log-likelihood is needed, which then depends on all runs."""
    found = next((noise for noise in noises if isinstance(noise, UnknownErrors)), None)
    if found is not None:
        expected = "a known sd and length, and no model error"
        remedy = "State what the study found, in summary.json under likelihood.inferred_noise."
        raise InvalidStudy(f"`{command}` needs a known noise", value=found.inferred, expected=expected, remedy=remedy)
