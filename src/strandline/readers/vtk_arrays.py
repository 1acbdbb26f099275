"""Numbers in VTK's XML files: ASCII, base64 or raw, inline or appended, plain or compressed."""

import base64
import binascii
import itertools
import lzma
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Shaped

from strandline.readers.unpacking import COMPRESSORS, Allowance

__all__ = ["Encoding", "numbers", "split"]

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}


@dataclass(frozen=True)
class Encoding:
    """How a file writes its binary numbers.

    Args:
        order: Order of the bytes, ``<`` or ``>``.
        header: Type of the counts before binary data.
        decompress: Function that decompresses, up to the file's allowance; None: not compressed.
        appended: All appended data after the underscore.
        raw: Whether appended data are bytes, not base64.
    """

    order: str
    header: str
    decompress: Callable[[bytes], bytes] | None
    appended: bytes
    raw: bool

    @classmethod
    def of(cls, root: ElementTree.Element, appended: bytes, *, raw: bool, size: int) -> "Encoding":
        """Return the encoding that the root of a file of `size` bytes declares."""
        compressor = root.get("compressor", "")
        if compressor and compressor not in COMPRESSORS:
            raise ValueError(f"compressed by {compressor}, which is not read; write with zlib or without")
        order = ">" if root.get("byte_order") == "BigEndian" else "<"
        unpack = partial(COMPRESSORS[compressor], Allowance(size)) if compressor else None
        return cls(order, TYPES[root.get("header_type", "UInt32")], unpack, appended, raw)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the NumPy type of a VTK type in this file."""
        return np.dtype(self.order + TYPES[name])


def split(content: bytes) -> tuple[ElementTree.Element, Encoding]:
    """Return the root of a file and its encoding; appended data are not XML and are taken out first.

    Raises:
        ValueError: (also ElementTree.ParseError, a SyntaxError) not a file of this kind.
    """
    head, mark, rest = content.partition(b"<AppendedData")
    appended, raw = b"", False
    if mark:
        attributes, _, rest = rest.partition(b">")
        before, _, appended = rest.partition(b"_")
        end = appended.rfind(b"</AppendedData>")
        if before.strip() or end < 0:
            raise ValueError("its appended data are cut off")
        raw = b"raw" in attributes
        head, appended = head + appended[end + len(b"</AppendedData>") :], appended[:end]
    root = ElementTree.fromstring(head)
    return root, Encoding.of(root, appended, raw=raw, size=len(content))


def numbers(array: ElementTree.Element, encoding: Encoding) -> Shaped[np.ndarray, "..."]:
    """Return the numbers of a DataArray; (row, component) if it has several components.

    Raises:
        ValueError: it is damaged, or of an unknown type.
    """
    dtype, form = encoding.dtype(array.attrib["type"]), array.get("format", "ascii")
    if form == "ascii":
        flat = np.array((array.text or "").split(), dtype=dtype.newbyteorder("="))
    elif form == "binary":
        flat = np.frombuffer(_decoded((array.text or "").strip().encode(), encoding, raw=False), dtype)
    elif form == "appended":
        start = int(array.attrib["offset"])
        flat = np.frombuffer(_decoded(encoding.appended[start:], encoding, raw=encoding.raw), dtype)
    else:
        raise ValueError(f"data in the format {form}")
    components = int(array.get("NumberOfComponents", "1"))
    native = flat.astype(dtype.newbyteorder("="))
    return native.reshape(-1, components) if components > 1 else native


class _Bytes:
    """Bytes from the beginning of a stream; only as many as requested are decoded."""

    def __init__(self, stream: bytes, *, raw: bool) -> None:
        self.stream, self.raw = stream, raw

    def first(self, number: int) -> bytes:
        """Return the first `number` bytes."""
        found = self.stream[:number] if self.raw else self._unpacked(4 * -(-number // 3))[:number]
        if len(found) < number:
            raise ValueError(f"its data end after {len(found)} of {number} bytes")
        return found

    def behind(self, number: int) -> "_Bytes":
        """Return the stream after a part of `number` bytes that was encoded separately."""
        return _Bytes(self.stream[number if self.raw else 4 * -(-number // 3) :], raw=self.raw)

    def _unpacked(self, characters: int) -> bytes:
        try:
            return base64.b64decode(self.stream[:characters], validate=True)
        except binascii.Error as error:
            raise ValueError(f"its base64 data are damaged ({error})") from None


def _decoded(stream: bytes, encoding: Encoding, *, raw: bool) -> bytes:
    """Return the bytes of one array: counts first, then the data, possibly compressed in blocks."""
    count, size = np.dtype(encoding.order + encoding.header), int(encoding.header[1])
    source = _Bytes(stream, raw=raw)
    if encoding.decompress is None:
        length = int(np.frombuffer(source.first(size), count)[0])
        if not raw and b"=" in stream[: 4 * -(-size // 3)]:  # the count was encoded separately
            return source.behind(size).first(length)
        return source.first(size + length)[size:]
    blocks = int(np.frombuffer(source.first(size), count)[0])
    header = np.frombuffer(source.first(size * (3 + blocks)), count).tolist()
    ends = np.cumsum([0, *header[3:]]).tolist()
    packed = source.behind(size * (3 + blocks)).first(ends[-1])
    try:
        return b"".join(encoding.decompress(packed[low:high]) for low, high in itertools.pairwise(ends))
    except (zlib.error, lzma.LZMAError) as error:
        raise ValueError(f"its compressed data are damaged ({error})") from None
