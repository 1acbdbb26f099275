"""Pictures of a study: the edge in each, in the model's coordinates, with the errors that the picture itself shows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInput, InvalidStudy
from strandline.imaging import (
    SAME,
    Clicks,
    Edge,
    Frame,
    FrameErrors,
    MarkovPath,
    Picture,
    PictureReading,
    PixelSize,
    Registration,
    StackFrame,
    StatedSize,
    edge_method,
    errors_from_frames,
    find_edge,
    is_of_clicks,
    read_clicks,
    read_frames,
    read_path,
    read_picture,
    registered,
    typed_path,
)
from strandline.interface import Interface, PointErrors
from strandline.studies.keys.observation import ConditionFile, ImageFile, ObservationFile
from strandline.studies.keys.parse import made, refused_at

UNDEFORMED = "undeformed"
"""Name, in files and results, of the picture that gives the model its outline."""


def frame_note(frame: Frame | StackFrame, options: object, origin: str = "the study") -> str:
    """Return a sentence that says where the model lies in a picture, and what gives the origin.

    `options` is the key `frame` as the study gives it: what it leaves out is a default.
    """
    given = options if isinstance(options, Mapping) else {}
    at = ", ".join(f"{value:.6g}" for value in frame.origin)
    none = ", ".join("0" for _ in frame.origin)
    what = "pixel" if isinstance(frame, Frame) else "voxel"
    axes = [name for name in ("x", "y", "z") if hasattr(frame, name)]
    stated = [name for name in axes if given.get(name) is not None]
    shown = [f"{name} {getattr(frame, name)}{'' if name in stated else ' (default)'}" for name in axes]
    turned = f", turned by {frame.rotation:.4g}°" if isinstance(frame, Frame) and frame.rotation else ""
    return f"the model's ({none}) at {what} ({at}) from {origin}; its axes point {', '.join(shown)}{turned}"


PLACE = "observation.image"
SAME_PLACE = 0.5
"""Distance in pixels up to which a marked origin is the stated one."""
IGNORED = ", not the marked "
MODEL = "model"
"""The path of a picture whose first path is the model's own outline."""


@dataclass(frozen=True, eq=False)
class Photographed:
    """A picture, the edge in it, and where it lies in the model's coordinates.

    `path`, from which the search began, and `edge` are in pixels, the edge's errors and arc lengths in mm, as is the
    `interface` in the model's coordinates. `registration` says where the set-up is, if that was found from another
    picture of it. `repeated` are the errors that frames show whose mean the picture is; `doubts` say why they show
    none. `placed` says in a sentence where the model lies, and who said so. `trim` is the share of the edge that was
    left out at either end.
    """

    picture: Picture
    frame: Frame
    path: Float[np.ndarray, "click 2"]
    edge: Edge
    interface: Interface
    registration: Registration | None = None
    repeated: FrameErrors | None = None
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
        picture = read_picture([folder / name for name in given.files], _reading(given, clicks))
        size = picture.values.shape[1], picture.values.shape[0]
        if clicks is not None:
            clicks.require_picture(picture.sha256, size)
        frame, registration, placed = _placed(folder, given, clicks, picture)
        path, closed = _path(folder, given, clicks, frame, undeformed, size)
        exclude = [np.array(corners, float) for corners in given.exclude]
        exclude += clicks.exclude if clicks is not None else ()
        edge = find_edge(
            picture.values,
            path,
            method=edge_method(given.edge, f"{PLACE}.edge"),
            solid=given.solid,
            closed=closed,
            exclude=exclude,
            pixel=picture.pixel,
            trim=given.trim,
        )
        repeated, doubts = _repeated(folder, given, clicks, picture, edge, exclude)
        edge = edge if repeated is None else repeated.put_into(edge)
        points = frame.to_mm(edge.points)
        interface = Interface.polyline(points if frame.mirrors else points[::-1], closed=edge.closed)
    return Photographed(
        picture,
        frame,
        path,
        edge,
        interface,
        registration,
        repeated,
        doubts,
        placed,
        trim=0.0 if edge.closed else given.trim,
    )


def _repeated(
    folder: Path,
    given: ImageFile,
    clicks: Clicks | None,
    picture: Picture,
    edge: Edge,
    exclude: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[FrameErrors | None, tuple[str, ...]]:
    """Return the errors that several frames of one state show, or why they show none."""
    if picture.frames == 1:
        return None, ()
    frames = read_frames([folder / name for name in given.files], _reading(given, clicks))
    try:
        return errors_from_frames(frames, edge, number=picture.frames, exclude=exclude), ()
    except InvalidInput as error:
        return None, (f"no errors from the frames, for {error.what}: {error.value}",)


def picture_reading(options: Mapping[str, Any], place: str = PLACE) -> PictureReading:
    """Return how to read a picture, from the options in the study file."""
    size = None if options.get("pixel") is None else made(StatedSize, options["pixel"], f"{place}.pixel").in_mm
    rest = {name: value for name, value in options.items() if name != "pixel"}
    return made(PictureReading, rest, place, pixel=size)


def clicked(folder: Path, given: ImageFile) -> Clicks | None:
    """Return the clicks that the study names, if its path is a file of clicks."""
    if isinstance(given.path, str) and is_of_clicks(folder / given.path):
        return read_clicks(folder / given.path)
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
        raise InvalidStudy(
            "--reference",
            value=f"{', '.join(given.files)}, without `registration`",
            expected="a picture that is registered to another",
            remedy="Leave --reference out, or add `registration: {to: FILE, marks: FILE.path.json}`.",
        )
    marks = how.marks or f"{Path(how.files[0]).stem}.path.json"
    return given.model_copy(update={"file": how.to, "path": marks, "registration": None})


def read_only_picture(folder: Path, given: ImageFile) -> tuple[Picture, bool]:
    """Return the picture alone, and whether study or header state the size of its pixels; else it is 1 mm."""
    paths = [folder / name for name in given.files]
    how = picture_reading(given.reading)
    try:
        with refused_at():
            return read_picture(paths, how), True
    except InvalidStudy:
        if how.pixel is not None:
            raise
        with refused_at():
            return read_picture(paths, replace(how, pixel=PixelSize(1.0, 1.0, source="nothing yet"))), False


def _reading(given: ImageFile, clicks: Clicks | None, name: str | None = None) -> PictureReading:
    """Return how to read the picture, with the size of a pixel from a scale bar if the study states none.

    A bar shows the size along itself only: pixels are taken as square, and the note says so. It says too if the study
    states another size than the bar, which does not count then.
    """
    how = picture_reading(given.reading)
    size = None if clicks is None else clicks.pixel_mm
    if size is None:
        return how
    bar = f"the scale bar in {given.path if name is None else name}"
    if how.pixel is None:
        return replace(how, pixel=PixelSize(size, size, source=f"{bar}, as if pixels were square"))
    if all(abs(stated / size - 1) <= SAME for stated in (how.pixel.x, how.pixel.y)):
        return how
    return replace(how, pixel=replace(how.pixel, source=f"{how.pixel.source}{IGNORED}{1e3 * size:.4g} µm of {bar}"))


def _placed(
    folder: Path, given: ImageFile, clicks: Clicks | None, picture: Picture
) -> tuple[Frame, Registration | None, str]:
    """Return where the model lies in the picture, if need be by what does not move from another picture to it.

    The sentence says so, and where origin and axes come from.
    """
    how = given.registration
    if how is None:
        frame, origin = _frame(given, clicks, picture, str(given.path))
        return frame, None, frame_note(frame, given.frame, origin)
    marks = None if how.marks is None else read_clicks(folder / how.marks)
    other = read_picture([folder / name for name in how.files], _reading(given, marks, how.marks))
    if marks is not None:
        marks.require_picture(other.sha256, (other.values.shape[1], other.values.shape[0]))
    regions = [*(np.array(one, float) for one in how.fixed), *(marks.fixed if marks is not None else ())]
    if not regions:
        raise InvalidStudy(
            f"{PLACE}.registration",
            value=f"{how.marks}, without a fixed region" if how.marks else "neither marks nor fixed",
            expected="a region that does not move with the specimen",
            remedy="Mark one: `strandline image STUDY --edit --reference`, or give `fixed`.",
        )
    speckle = isinstance(edge_method(given.edge, f"{PLACE}.edge"), MarkovPath)
    found = registered(other.values, picture.values, regions, pixel=picture.pixel, speckle=speckle)
    frame, origin = _frame(given, marks, other, str(how.marks))
    return frame.moved(found), found, f"in {other.name}, {frame_note(frame, given.frame, origin)}"


def _frame(given: ImageFile, clicks: Clicks | None, picture: Picture, marks: str) -> tuple[Frame, str]:
    """Return where the model lies in the picture, and what gives the origin: the marks if the study states none.

    It says too if the marks have another origin than the study, which does not count then.
    """
    options: Mapping[str, Any] | Any = {} if given.frame is None else given.frame
    marked = None if clicks is None or clicks.origin is None else list(clicks.origin)
    if isinstance(options, Mapping) and "origin" not in options and marked is not None:
        frame = made(Frame, {**options, "origin": marked}, f"{PLACE}.frame", pixel=picture.pixel)
        return frame, f"the marks in {marks}"
    frame, source = made(Frame, options, f"{PLACE}.frame", pixel=picture.pixel), "the study"
    if marked is not None and math.dist(frame.origin, marked) > SAME_PLACE:
        source += f"{IGNORED}({marked[0]:.6g}, {marked[1]:.6g}) of {marks}"
    return frame, source


def _path(
    folder: Path,
    given: ImageFile,
    clicks: Clicks | None,
    frame: Frame,
    undeformed: Interface | None,
    size: tuple[int, int],
) -> tuple[Float[np.ndarray, "click 2"], bool]:
    if clicks is not None:
        if not len(clicks.path):
            raise InvalidStudy(
                f"{PLACE}.path",
                value=f"{given.path}, without a path",
                expected="at least 3 points along the interface",
                remedy="Click them: `strandline image STUDY --edit`.",
            )
        return clicks.path, clicks.closed or given.closed
    if given.path == MODEL:
        if undeformed is None or undeformed.dim != 2:
            raise InvalidStudy(
                f"{PLACE}.path",
                value=MODEL,
                expected="a model with an undeformed outline in the plane",
                remedy="Click the path: `strandline image STUDY --edit`.",
            )
        return frame.to_pixels(undeformed.points), undeformed.closed
    if isinstance(given.path, str):
        found = read_path(folder / given.path, size=size)
    else:
        found = typed_path(given.path, closed=given.closed, size=size, what=f"{PLACE}.path")
    return found.points, found.closed or given.closed
