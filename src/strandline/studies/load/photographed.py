"""Pictures of a study: the edge in each, in the model's coordinates, with the errors that the picture itself shows.

Last the undeformed outline of the flow cell from a picture, and what its errors add to those of the observation.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import imaging
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.studies.keys.observation import ConditionFile, ImageFile, ObservationFile
from strandline.studies.keys.parse import checked, made, refused_at

UNDEFORMED = "undeformed"  # name, in files and results, of the picture that gives the model its outline


def frame_note(frame: imaging.Frame | imaging.StackFrame, options: object, origin: str = "the study") -> str:
    """Return a sentence on where the model lies in a picture; what `options`, the key `frame`, lack is a default."""
    given = options if isinstance(options, Mapping) else {}
    at = ", ".join(f"{value:.6g}" for value in frame.origin)
    none = ", ".join("0" for _ in frame.origin)
    what = "pixel" if isinstance(frame, imaging.Frame) else "voxel"
    axes = [name for name in ("x", "y", "z") if hasattr(frame, name)]
    stated = [name for name in axes if given.get(name) is not None]
    shown = [f"{name} {getattr(frame, name)}{'' if name in stated else ' (default)'}" for name in axes]
    turned = f", turned by {frame.rotation:.4g}°" if isinstance(frame, imaging.Frame) and frame.rotation else ""
    return f"the model's ({none}) at {what} ({at}) from {origin}; its axes point {', '.join(shown)}{turned}"


PLACE = "observation.image"
SAME_PLACE = 0.5  # distance in pixels up to which a marked origin is the stated one
IGNORED = ", not the marked "
MODEL = "model"  # the path of a picture whose first path is the model's own outline


@dataclass(frozen=True, eq=False)
class Photographed:
    """A picture, the edge in it, and where it lies in the model's coordinates.

    `path`, from which the search began, and `edge` are in pixels, the edge's errors and arc lengths in mm, as is the
    `interface` in the model's coordinates. `registration` says where the set-up is, if that was found from another
    picture of it. `repeated` are the errors that frames show whose mean the picture is; `doubts` say why they show
    none. `placed` says in a sentence where the model lies, and who said so. `trim` is the share left out at either end.
    """

    picture: imaging.Picture
    frame: imaging.Frame
    path: Float[np.ndarray, "click 2"]
    edge: imaging.Edge
    interface: Interface
    registration: imaging.Registration | None = None
    repeated: imaging.FrameErrors | None = None
    doubts: tuple[str, ...] = ()
    placed: str = ""
    trim: float = 0.0

    @property
    def name(self) -> str:
        return self.picture.name

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences that say what was taken from where, and what is in doubt."""
        placed = (self.placed,) if self.placed else ()
        repeated = () if self.repeated is None else self.repeated.notes
        cut = (f"{100 * self.trim:.3g} % of the edge left out at either end (`trim`)",) if self.trim else ()
        return (*self.picture.notes, *placed, *cut, *self.doubts, *repeated)

    @property
    def ignored(self) -> list[str]:
        """Those that say what was marked and does not count, because the study states something else."""
        return [note for note in self.notes if IGNORED in note]

    @property
    def errors(self) -> PointErrors:
        """Errors of the interface's points that the picture shows: local ones, a common offset, and of its place."""
        found, place = self.edge.errors, self.registration
        if place is None:
            return PointErrors(found.sd, found.length, offset=found.offset)
        turned = np.array([place.centre])  # what is registered is turned about its own middle
        lever = np.linalg.norm(self.frame.to_mm(place(turned))[0] - self.interface.points.mean(axis=0))
        shift = math.hypot(min(self.picture.pixel) * place.shift_sd, np.deg2rad(place.rotation_sd) * float(lever))
        return PointErrors(found.sd, found.length, offset=found.offset, shift=shift, rotation=place.rotation_sd)


def photographed(folder: Path, given: ImageFile, undeformed: Interface | None) -> Photographed:
    """Return the edge in a picture of a study."""
    with refused_at():
        clicks = clicked(folder, given)
        paths, how = [folder / name for name in given.files], _reading(given, clicks)
        picture = imaging.read_picture(paths, how)
        size = picture.values.shape[1], picture.values.shape[0]
        if clicks is not None:
            clicks.require_picture(picture.sha256, size)
        frame, registration, placed = _placed(folder, given, clicks, picture)
        path, closed = _path(folder, given, clicks, frame, undeformed, size)
        exclude = [np.array(corners, float) for corners in given.exclude]
        exclude += clicks.exclude if clicks is not None else ()
        edge = imaging.find_edge(
            picture.values,
            path,
            method=imaging.edge_method(given.edge, f"{PLACE}.edge"),
            solid=given.solid,
            closed=closed,
            exclude=exclude,
            pixel=picture.pixel,
            trim=given.trim,
        )
        repeated: imaging.FrameErrors | None = None
        doubts: tuple[str, ...] = ()
        if picture.frames > 1:
            frames = imaging.read_frames(paths, how)
            try:
                repeated = imaging.errors_from_frames(frames, edge, number=picture.frames, exclude=exclude)
            except InvalidInput as error:
                doubts = (f"no errors from the frames, for {error.what}: {error.value}",)
        edge = edge if repeated is None else repeated.put_into(edge)
        points = frame.to_mm(edge.points)
        interface = Interface.polyline(points if frame.mirrors else points[::-1], closed=edge.closed)
    trim = 0.0 if edge.closed else given.trim
    return Photographed(picture, frame, path, edge, interface, registration, repeated, doubts, placed, trim)


def picture_reading(options: Mapping[str, Any], place: str = PLACE) -> imaging.PictureReading:
    """Return how to read a picture, from the options in the study file."""
    size = None if options.get("pixel") is None else made(imaging.StatedSize, options["pixel"], f"{place}.pixel").in_mm
    rest = {name: value for name, value in options.items() if name != "pixel"}
    return made(imaging.PictureReading, rest, place, pixel=size)


def clicked(folder: Path, given: ImageFile) -> imaging.Clicks | None:
    """Return the clicks that the study names, if its path is a file of clicks."""
    if isinstance(given.path, str) and imaging.is_of_clicks(folder / given.path):
        return imaging.read_clicks(folder / given.path)
    return None


def picture_of(source: ObservationFile | list[ConditionFile], condition: str | None) -> ImageFile:
    """Return the section of the picture of a condition; None for the only one."""
    sections = source if isinstance(source, list) else [source]
    found = {getattr(one, "condition", ""): one.image for one in sections if one.image is not None}
    if condition is None and len(found) == 1:
        return next(iter(found.values()))
    if condition is None or condition not in found:
        raise InvalidStudy(
            "observation with a picture" if condition is None else "--condition",
            value=condition if condition is not None else f"{len(found)} pictures",
            expected=f"one of {', '.join(found)}" if any(found) else "`observation: {image: {file: …}}`",
            remedy="Give its condition, `--condition NAME`." if any(found) else "Correct study.yaml.",
        )
    return found[condition]


def reference_of(given: ImageFile) -> ImageFile:
    """Return the section of the picture to which a picture is registered, its marks as the path."""
    how = given.registration
    if how is None:
        value, expected = f"{', '.join(given.files)}, without `registration`", "a picture that is registered to another"
        remedy = "Leave --reference out, or add `registration: {to: FILE, marks: FILE.path.json}`."
        raise InvalidStudy("--reference", value=value, expected=expected, remedy=remedy)
    marks = how.marks or f"{Path(how.files[0]).stem}.path.json"
    return given.model_copy(update={"file": how.to, "path": marks, "registration": None})


def read_only_picture(folder: Path, given: ImageFile) -> tuple[imaging.Picture, bool]:
    """Return the picture alone, and whether study or header state the size of its pixels; else it is 1 mm."""
    paths = [folder / name for name in given.files]
    how = picture_reading(given.reading)
    try:
        with refused_at():
            return imaging.read_picture(paths, how), True
    except InvalidStudy:
        if how.pixel is not None:
            raise
        with refused_at():
            unknown = replace(how, pixel=imaging.PixelSize(1.0, 1.0, source="nothing yet"))
            return imaging.read_picture(paths, unknown), False


def _reading(given: ImageFile, clicks: imaging.Clicks | None, name: str | None = None) -> imaging.PictureReading:
    """Return how to read the picture, with the size of a pixel from a scale bar if the study states none.

    A bar shows the size along itself only. The note says if pixels are taken as square, and if the bar does not count.
    """
    how = picture_reading(given.reading)
    size = None if clicks is None else clicks.pixel_mm
    if size is None:
        return how
    bar = f"the scale bar in {given.path if name is None else name}"
    if how.pixel is None:
        return replace(how, pixel=imaging.PixelSize(size, size, source=f"{bar}, as if pixels were square"))
    if all(abs(stated / size - 1) <= imaging.SAME for stated in (how.pixel.x, how.pixel.y)):
        return how
    return replace(how, pixel=replace(how.pixel, source=f"{how.pixel.source}{IGNORED}{1e3 * size:.4g} µm of {bar}"))


def _placed(
    folder: Path, given: ImageFile, clicks: imaging.Clicks | None, picture: imaging.Picture
) -> tuple[imaging.Frame, imaging.Registration | None, str]:
    how = given.registration
    if how is None:
        frame, origin = _frame(given, clicks, picture, str(given.path))
        return frame, None, frame_note(frame, given.frame, origin)
    marks = None if how.marks is None else imaging.read_clicks(folder / how.marks)
    other = imaging.read_picture([folder / name for name in how.files], _reading(given, marks, how.marks))
    if marks is not None:
        marks.require_picture(other.sha256, (other.values.shape[1], other.values.shape[0]))
    regions = [*(np.array(one, float) for one in how.fixed), *(marks.fixed if marks is not None else ())]
    if not regions:
        value = f"{how.marks}, without a fixed region" if how.marks else "neither marks nor fixed"
        expected = "a region that does not move with the specimen"
        remedy = "Mark one: `strandline image STUDY --edit --reference`, or give `fixed`."
        raise InvalidStudy(f"{PLACE}.registration", value=value, expected=expected, remedy=remedy)
    speckle = isinstance(imaging.edge_method(given.edge, f"{PLACE}.edge"), imaging.MarkovPath)
    found = imaging.registered(other.values, picture.values, regions, pixel=picture.pixel, speckle=speckle)
    frame, origin = _frame(given, marks, other, str(how.marks))
    return frame.moved(found), found, f"in {other.name}, {frame_note(frame, given.frame, origin)}"


def _frame(
    given: ImageFile, clicks: imaging.Clicks | None, picture: imaging.Picture, marks: str
) -> tuple[imaging.Frame, str]:
    """Return where the model lies in the picture, and what gives the origin: the marks if the study states none."""
    options: Mapping[str, Any] | Any = {} if given.frame is None else given.frame
    marked = None if clicks is None or clicks.origin is None else list(clicks.origin)
    if isinstance(options, Mapping) and "origin" not in options and marked is not None:
        frame = made(imaging.Frame, {**options, "origin": marked}, f"{PLACE}.frame", pixel=picture.pixel)
        return frame, f"the marks in {marks}"
    frame, source = made(imaging.Frame, options, f"{PLACE}.frame", pixel=picture.pixel), "the study"
    if marked is not None and math.dist(frame.origin, marked) > SAME_PLACE:
        source += f"{IGNORED}({marked[0]:.6g}, {marked[1]:.6g}) of {marks}"
    return frame, source


def _path(
    folder: Path,
    given: ImageFile,
    clicks: imaging.Clicks | None,
    frame: imaging.Frame,
    undeformed: Interface | None,
    size: tuple[int, int],
) -> tuple[Float[np.ndarray, "click 2"], bool]:
    if clicks is not None:
        if not len(clicks.path):
            expected, remedy = "at least 3 points along the interface", "Click them: `strandline image STUDY --edit`."
            raise InvalidStudy(f"{PLACE}.path", value=f"{given.path}, without a path", expected=expected, remedy=remedy)
        return clicks.path, clicks.closed or given.closed
    if given.path == MODEL:
        if undeformed is None or undeformed.dim != 2:
            expected = "a model with an undeformed outline in the plane"
            remedy = "Click the path: `strandline image STUDY --edit`."
            raise InvalidStudy(f"{PLACE}.path", value=MODEL, expected=expected, remedy=remedy)
        return frame.to_pixels(undeformed.points), undeformed.closed
    if isinstance(given.path, str):
        found = imaging.read_path(folder / given.path, size=size)
    else:
        found = imaging.typed_path(given.path, closed=given.closed, size=size, what=f"{PLACE}.path")
    return found.points, found.closed or given.closed


IMAGE = "image"  # option of an outline that names a picture instead of points


@dataclass(frozen=True, eq=False)
class Undeformed:
    """The smooth outline through the edge in a picture, and the noise of the conditions without its errors."""

    picture: Photographed
    outline: imaging.Outlined
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
        return Undeformed(picture, imaging.outline_of(points, path, sd=found.sd, length=found.length))


def with_errors_of(
    undeformed: Undeformed | None, noise: Noise | PointErrors | UnknownErrors, seen: Interface, *, conditions: int
) -> Noise | PointErrors | UnknownErrors:
    """Return the noise of an observation together with the errors of the undeformed outline in a picture.

    An error of the undeformed outline moves the simulated interface by nearly as much: variances add, and so do the
    integrals s²ℓ of the covariances. The outline is the same in all conditions; since each is compared on its own, its
    variances count as many times as there are conditions, so that these make it no better known. Other noise stays.
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
