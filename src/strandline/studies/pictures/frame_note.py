"""Where a model lies in a picture or a stack, in words."""

from collections.abc import Mapping

from strandline.imaging import Frame
from strandline.imaging.surfaces import StackFrame

__all__ = ["UNDEFORMED", "frame_note"]

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
