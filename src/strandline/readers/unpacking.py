"""Compressed data, unpacked up to a limit: a file of a few megabytes can unpack to as many gigabytes."""

import lzma
import zlib
from collections.abc import Callable

__all__ = ["COMPRESSORS", "Allowance"]

ALWAYS_BYTES = 64 * 10**6
PER_BYTE = 20
"""Meshes and their data shrink by a factor of 2 to 10."""


class Allowance:
    """Number of bytes that the data of one file may still take.

    Args:
        packed: Size of the file.
    """

    def __init__(self, packed: int) -> None:
        self._packed = packed
        self._limit = self._left = ALWAYS_BYTES + PER_BYTE * packed

    def take(self, number: int) -> None:
        """Use up `number` bytes.

        Raises:
            ValueError: fewer are left.
        """
        self._left -= number
        if self._left < 0:
            raise ValueError(
                f"its data unpack to more than {self._limit / 1e6:.0f} MB, from {self._packed / 1e6:.2g} MB; "
                "write them uncompressed"
            )

    def unzlib(self, data: bytes) -> bytes:
        """Return data that zlib compressed, unpacked."""
        unpacker = zlib.decompressobj()
        return self._whole(unpacker.decompress(data, self._left + 1), lambda: unpacker.eof)

    def unlzma(self, data: bytes) -> bytes:
        """Return data that lzma compressed, unpacked."""
        unpacker = lzma.LZMADecompressor(memlimit=4 * ALWAYS_BYTES)
        return self._whole(unpacker.decompress(data, self._left + 1), lambda: unpacker.eof)

    def _whole(self, found: bytes, at_end: Callable[[], bool]) -> bytes:
        self.take(len(found))
        if not at_end():
            raise ValueError("its compressed data are cut off")
        return found


COMPRESSORS: dict[str, Callable[[Allowance, bytes], bytes]] = {
    "vtkZLibDataCompressor": Allowance.unzlib,
    "vtkLZMADataCompressor": Allowance.unlzma,
}
"""Names in VTK's files → functions that decompress."""
