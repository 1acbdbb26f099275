"""Pages of a TIFF file: whether all of them are there, which tifffile only logs, and what they unpack to."""

import math
import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

__all__ = ["require_parts", "require_whole_chain"]

MOST_PAGES = 1_000_000
CLASSIC, BIG = 42, 43
FORMS = {CLASSIC: ("I", "H", 12), BIG: ("Q", "Q", 20)}
"""Kind of TIFF → formats of an offset and of the number of entries, bytes of an entry."""
DEFLATE = (8, 32946)
"""TIFF's numbers of the compression by zlib, the only one that unpacks without a bound of its own."""
MOST_UNPACKED = 1 << 28
"""Bytes; what cannot unpack to more, at zlib's largest ratio, is not looked at before."""
LARGEST_RATIO = 1032
PIECE = 1 << 20


def require_whole_chain(path: Path) -> None:
    """Refuse a file one of whose pages lies beyond its end, so that the file is cut off.

    Raises:
        EOFError: It is cut off.
        ValueError: It is no TIFF file, or its pages lie in a circle.
    """
    with path.open("rb") as file:
        start = file.read(4)
        order = {b"II": "<", b"MM": ">"}.get(start[:2])
        kind = struct.unpack(f"{order}H", start[2:])[0] if order and len(start) == 4 else 0
        if kind not in FORMS:
            raise ValueError("not a TIFF file")
        offset_format, count_format, entry = (FORMS[kind][0], FORMS[kind][1], FORMS[kind][2])
        file.seek(4 if kind == CLASSIC else 8)
        offset, seen = _number(file, f"{order}{offset_format}"), set[int]()
        while offset:
            if offset in seen or len(seen) == MOST_PAGES:
                raise ValueError("its pages lie in a circle")
            seen.add(offset)
            file.seek(offset)
            count = _number(file, f"{order}{count_format}")
            file.seek(count * entry, 1)
            offset = _number(file, f"{order}{offset_format}")


def _number(file: BinaryIO, form: str) -> int:
    """Return the number at the present place of the file."""
    content = file.read(struct.calcsize(form))
    if len(content) < struct.calcsize(form):
        raise EOFError("the file is cut off, or a page lies beyond its end")
    return int(struct.unpack(form, content)[0])


def require_parts(path: Path, page: Any, *, most: int = MOST_UNPACKED) -> None:
    """Refuse a page that lacks strips or tiles, which tifffile fills with 0, or that unpacks to much more than it is.

    Args:
        path: Path of the file.
        page: Page that tifffile read.
        most: Bytes to which each may unpack, if the page is not larger.

    Raises:
        EOFError: A strip or a tile is missing.
        ValueError: One unpacks to more than the pixels of the page.
    """
    expected = math.prod(page.keyframe.chunked)
    found = sum(offset > 0 and count > 0 for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True))
    if found < expected:
        raise EOFError(f"{expected - found} of its {expected} strips or tiles are missing")
    if int(page.compression) not in DEFLATE:
        return
    bound = max(most, 2 * page.nbytes)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count * LARGEST_RATIO <= bound:
            continue
        with path.open("rb") as file:
            file.seek(offset)
            packed = file.read(count)
        if not _unpacks_within(packed, bound):
            raise ValueError(f"its {count} compressed bytes unpack to more than its pixels")


def _unpacks_within(packed: bytes, bound: int) -> bool:
    """Return whether bytes compressed by zlib unpack to `bound` bytes at most, a piece at a time."""
    unpacker, total = zlib.decompressobj(), 0
    for start in range(0, len(packed), PIECE):
        rest = packed[start : start + PIECE]
        while rest:
            total += len(unpacker.decompress(rest, PIECE))
            if total > bound:
                return False
            rest = unpacker.unconsumed_tail
    return True
