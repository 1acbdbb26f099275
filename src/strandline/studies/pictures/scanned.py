"""Stacks of a study: the surface in each, in the model's coordinates, with the errors that the stack itself shows."""

from dataclasses import dataclass
from pathlib import Path

from strandline.foundations import InvalidStudy
from strandline.imaging import (
    PictureReading,
    Stack,
    StackFrame,
    StatedRegion,
    StatedSize,
    Surface,
    find_surface,
    read_stack,
)
from strandline.interface import Interface, PointErrors
from strandline.studies.keys.observation import StackFile
from strandline.studies.keys.parse import made, refused_at
from strandline.studies.pictures.photographed import frame_note, picture_reading

PLACE = "observation.stack"


@dataclass(frozen=True, eq=False)
class Scanned:
    """A stack, the surface in it, and where it lies in the model's coordinates.

    The surface is in voxels, its errors in mm, as is the `interface`. `placed` says in a sentence where the model lies
    in the stack, and who said so.
    """

    stack: Stack
    frame: StackFrame
    surface: Surface
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
        stack = read_stack([folder / name for name in given.files], _reading(given))
        frame = made(StackFrame, given.frame or {}, f"{PLACE}.frame", voxel=stack.voxel)
        exclude = [
            made(StatedRegion, one, f"{PLACE}.exclude[{k}]").within(frame) for k, one in enumerate(given.exclude)
        ]
        surface = find_surface(
            stack, solid=given.solid, triangles=given.triangles, smooth=given.smooth, exclude=exclude
        )
        return Scanned(stack, frame, surface, frame.interface(surface.mesh), frame_note(frame, given.frame))


def _reading(given: StackFile) -> PictureReading:
    how = picture_reading(given.reading, PLACE)
    if given.voxel is None:
        return how
    if isinstance(given.voxel, dict) and given.voxel.get("size") is not None:
        raise InvalidStudy(
            f"{PLACE}.voxel", value=given.voxel, expected="x, y and z", remedy="Write {x: 6, y: 6, z: 10, unit: um}."
        )
    return PictureReading(**how.given, pixel=made(StatedSize, given.voxel, f"{PLACE}.voxel").in_mm)
