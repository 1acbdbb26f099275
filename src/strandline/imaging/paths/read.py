"""A file with a path in it → the path, whatever program wrote it."""

from collections.abc import Callable
from pathlib import Path

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath, require_inside
from strandline.registry import lookup

__all__ = ["PATHS", "PathReader", "is_of_clicks", "read_path"]

PathReader = Callable[[bytes], FirstPath]
"""Contents of a file → the path in it."""

PATHS: dict[str, str] = {
    "fiji_roi": "strandline.imaging.paths.fiji_roi:path_of_roi",
    "fiji_xy": "strandline.imaging.paths.fiji_xy:path_of_xy",
    "outlines": "strandline.imaging.paths.outlines:path_of_outline",
    "napari": "strandline.imaging.paths.napari:path_of_shapes",
}
"""Formats of paths → ``module:name`` of the function that reads them."""

LARGEST = 1 << 23
"""Bytes of a file that is read."""


def read_path(path: Path, *, size: tuple[int, int] | None = None, form: str | None = None) -> FirstPath:
    """Return the path in a file that another program exported.

    Files of clicks are read by `read_clicks`, which knows the picture that they belong to.

    Args:
        path: The file.
        size: Width and height of the picture in pixels, if the path must lie in it.
        form: Format of the file, a key of `PATHS` or ``module:name`` of a `PathReader`; by default the contents of the
            file determine it.

    Raises:
        InvalidInput: A file that cannot be read or holds no usable path. The message begins with its name.
    """
    try:
        content = _content(path)
        reader: PathReader = lookup(PATHS, form or _form(content), "format of the path")
        found = reader(content)
        if size is not None:
            require_inside(found.points, size, "the path")
    except InvalidInput as error:
        raise InvalidInput(
            f"{path.name}: {error.what}", value=error.value, expected=error.expected, remedy=error.remedy
        ) from None
    return found


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise _refused("cannot be read", error.strerror or str(error)) from None
    if len(content) > LARGEST:
        raise _refused("size of the file", f"more than {LARGEST} bytes")
    return content


def _form(content: bytes) -> str:
    """Return the format that the first bytes show."""
    if content.startswith(b"Iout"):
        return "fiji_roi"
    if content.startswith(b"PK"):
        raise _refused(
            "is an archive of several selections", "a .zip file", "Unpack it, or save the one selection that is meant."
        )
    begin = content[:200].decode("utf-8-sig", "replace").lstrip().lower()
    if begin.startswith("{"):
        if _is_drawn(content):
            return "outlines"
        raise _refused("is JSON, but is not used as a file of clicks", "{ …", "Name it NAME.path.json.")
    first = begin.partition("\n")[0]
    if "axis-" in first and "vertex-index" in first:
        return "napari"
    return "outlines" if first.count(",") > 4 else "fiji_xy"  # a line of Cellpose holds a whole cell


def is_of_clicks(path: Path) -> bool:
    """Return whether a file is one of clicks by its name, and holds no outline that another program drew."""
    return path.suffix == ".json" and not (path.is_file() and _is_drawn(_content(path)))


def _is_drawn(content: bytes) -> bool:
    """Return whether JSON has what labelme or GeoJSON calls an outline."""
    return b'"shapes"' in content or b'"coordinates"' in content


def _refused(what: str, value: object, remedy: str = "Correct the file, or its name.") -> InvalidInput:
    expected = "a path saved by Fiji (.roi, XY coordinates), napari (.csv), labelme, QuPath or Cellpose"
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
