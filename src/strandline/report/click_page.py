"""The page on which a person marks a picture: one HTML file that needs no server and loads nothing."""

import base64
from importlib.resources import files
from pathlib import Path, PurePath

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from strandline.imaging.clicks import Clicks, as_json
from strandline.report.click_picture import MOST_PIXELS, shown
from strandline.report.inline import embedded, script_hash
from strandline.report.page import template

__all__ = ["click_page", "write_click_page"]

SCRIPTS = ("marks.js", "view.js", "changes.js", "pointer.js", "keyboard.js", "panel.js", "files.js")
TOOLS = (
    ("move", "Move the picture", False),
    ("scale", "Scale bar", True),
    ("origin", "Origin", True),
    ("path", "Path", True),
    ("exclude", "Leave out", True),
    ("fixed", "Fixed region", True),
)
"""Value, label, and whether the page shows what has been marked with it."""
SHORTCUTS = (
    (("1 – 6",), "choose what to mark"),
    (("Wheel", "+", "−", "0"), "zoom; whole picture"),
    (("Space",), "hold and drag to move the picture"),
    (("Arrows",), "move the selected point by a pixel of the screen (Shift: 10), or the picture"),
    (("A",), "add a point at the pointer"),
    (("Enter",), "finish a region"),
    (("Delete",), "delete the selected point"),
    (("Esc",), "select nothing"),
    (("Ctrl Z", "Ctrl Y"), "undo, redo"),
    (("Ctrl S",), "save"),
)


def click_page(
    values: Float[np.ndarray, "row column"],
    *,
    name: str,
    sha256: str,
    clicks: Clicks | None = None,
    pixel_mm: tuple[float, float] | None = None,
    most_pixels: int = MOST_PIXELS,
) -> str:
    """Return the page for one picture, as HTML.

    The page saves a file that `strandline.imaging.clicks.read_clicks` reads, and nothing that it would refuse.

    Args:
        values: Grey values of the picture.
        name: File name of the picture.
        sha256: SHA-256 checksum of the picture's file, in hexadecimal.
        clicks: What was marked before.
        pixel_mm: Width and height of a pixel if they are known, in mm; the page shows the picture in its true shape.
        most_pixels: Largest picture that the page shows as it is, in pixels.

    Raises:
        InvalidInput: `clicks` belong to another picture, or the picture has no finite value.
    """
    height, width = values.shape
    if clicks is not None:
        clicks.require_picture(sha256, (width, height))
    png, factor = shown(values, most_pixels=most_pixels)
    given = {
        "name": name,
        "sha256": sha256.lower(),
        "size": [width, height],
        "factor": factor,
        "pixel_mm": pixel_mm,
        "file": file_name(name),
        "clicks": None if clicks is None else as_json(clicks),
        "picture": f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}",
    }
    script = _script()
    return str(
        template("clicks.html.j2").render(
            name=name,
            file=given["file"],
            width=width,
            height=height,
            factor=factor,
            tools=TOOLS,
            shortcuts=SHORTCUTS,
            given=embedded(given),
            script=Markup(script),
            script_hash=Markup(script_hash(script)),
        )
    )


def write_click_page(
    values: Float[np.ndarray, "row column"],
    target: Path,
    *,
    name: str,
    sha256: str,
    clicks: Clicks | None = None,
    pixel_mm: tuple[float, float] | None = None,
) -> Path:
    """Write the page for one picture, whole or not at all, and return its path.

    Args:
        values: Grey values of the picture.
        target: Path of the page, ``….html``.
        name: File name of the picture.
        sha256: SHA-256 checksum of the picture's file, in hexadecimal.
        clicks: What was marked before.
        pixel_mm: Width and height of a pixel if they are known, in mm.

    Raises:
        InvalidInput: As `click_page` does.
    """
    page = click_page(values, name=name, sha256=sha256, clicks=clicks, pixel_mm=pixel_mm)
    unfinished = target.with_name(f".{target.name}.partial")
    unfinished.write_text(page, encoding="utf-8")
    return unfinished.replace(target)


def file_name(picture: str) -> str:
    """Return the name of the file that the page saves: ``scan.path.json`` for the picture ``scan.tif``."""
    return f"{PurePath(picture).stem}.path.json"


def _script() -> str:
    folder = files("strandline.report") / "templates" / "clicks"
    parts = ((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    return '\n"use strict";\n' + "\n".join(parts)
