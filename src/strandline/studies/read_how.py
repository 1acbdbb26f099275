"""How the pictures and stacks of a study were read: sizes, scales, axes, and where each of them came from."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from strandline.imaging import Frame
from strandline.imaging.surfaces import StackFrame

if TYPE_CHECKING:
    from strandline.studies.study import Study

__all__ = ["UNDEFORMED", "frame_note", "read_how", "read_lines"]

UNDEFORMED = "undeformed"
"""Name, in files and results, of the picture that gives the model its outline."""


def frame_note(frame: Frame | StackFrame, options: object, origin: str = "the study") -> str:
    """Return a sentence that says where the model lies in a picture, and who said so.

    Args:
        frame: Where it lies.
        options: The key `frame` as the study gives it; what it leaves out is a default.
        origin: What gives the origin.
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


def read_how(study: "Study") -> list[dict[str, Any]]:
    """Return condition, file, checksum and notes of each picture and stack, the one of the outline first."""
    first = {} if study.undeformed is None else {UNDEFORMED: study.undeformed.picture}
    found = [(name, one.name, one.picture.sha256, one.notes) for name, one in {**first, **study.pictures}.items()]
    found += [(name, one.name, one.stack.sha256, one.notes) for name, one in study.stacks.items()]
    keys = ("condition", "file", "sha256", "notes")
    return [{**dict(zip(keys, one, strict=True)), "notes": list(one[3])} for one in found]


def read_lines(study: "Study") -> Iterator[str]:
    """Yield a line on each picture and stack."""
    for one in read_how(study):
        of = f"{one['condition']}: " if one["condition"] else ""
        yield f"{of}{one['file']}: {'; '.join(one['notes'])}; sha256 {one['sha256'][:12]}…"
