"""Pictures given instead of the points of an interface."""

from pathlib import Path

from strandline.readers.problems import refused

__all__ = ["require_no_picture"]

_BEGINNINGS = {
    b"\x89PNG\r\n\x1a\n": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"II*\x00": "TIFF",
    b"MM\x00*": "TIFF",
    b"II+\x00": "TIFF",
    b"MM\x00+": "TIFF",
    b"GIF87a": "GIF",
    b"GIF89a": "GIF",
}
"""The first bytes of a file → the picture format that begins with them."""


def require_no_picture(path: Path, name: str) -> None:
    """Refuse a file that is a picture, whatever its suffix.

    Args:
        path: The file, which exists.
        name: Name of the file in messages.

    Raises:
        Unreadable: The file begins as a PNG, JPEG, TIFF or GIF picture does.
    """
    try:
        with path.open("rb") as file:
            begin = file.read(max(map(len, _BEGINNINGS)))
    except OSError:
        return  # the reader reports why
    for beginning, kind in _BEGINNINGS.items():
        if begin.startswith(beginning):
            raise refused(
                f"{name} is a picture",
                f"a {kind} image",
                "the points of a contour, two columns x, y in their order along the interface",
                "To find the interface in it, write `observation: {image: {file: …}}`; see the guide on pictures.",
            )
