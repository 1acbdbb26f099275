"""Picture files written by the description of their format, and how tests read them."""

import io
import struct
import zipfile
import zlib

import numpy as np
import pytest
import tifffile

from strandline.foundations import InvalidInput
from strandline.imaging.read import read_picture
from strandline.studies.load.photographed import picture_reading

SQUARE = {"size": 2.0, "unit": "um"}


def reading(**options):
    return picture_reading(options)


def read(path, **options):
    return read_picture(path, reading(**{"pixel": SQUARE, **options}))


def refusal(path, **options):
    """Return the message with which the picture is refused, and require that it is one line."""
    with pytest.raises(InvalidInput) as caught:
        read(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    assert len(message) < 700
    return message


def png(width, height, pixels):
    """Return a grey PNG file of rows of pixels, each after the byte of its filter."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n"
    for kind, data in ((b"IHDR", header), (b"IDAT", zlib.compress(pixels)), (b"IEND", b"")):
        content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return content


def oct_file(header, pixels):
    """Return a Thorlabs scan, which is an archive of a header and numbers."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Header.xml", header)
        archive.writestr("data\\Intensity.data", pixels)
    return file.getvalue()


def of_size(rows, columns, more=""):
    """Return the header of a scan, which has a picture of the sample, too."""
    return (
        '<?xml version="1.0"?><Ocity><Acquisition><RefractiveIndex>1.000000</RefractiveIndex></Acquisition><DataFiles>'
        '<DataFile SizeZ="4" SizeX="4">data\\VideoImage.data</DataFile>'
        f'<DataFile SizeZ="{rows}" SizeX="{columns}" {more}>data\\Intensity.data</DataFile></DataFiles></Ocity>'
    )


def scan(path, values, header):
    """Write a Thorlabs scan of frames (y, z, x)."""
    path.write_bytes(oct_file(header, np.ascontiguousarray(values.transpose(0, 2, 1)).astype("<f4").tobytes()))


def with_tag(content, tag, value, *, form="<I", at=0):
    """Return a TIFF file with another number in a tag of its first page, or in its list of numbers."""
    with tifffile.TiffFile(io.BytesIO(content)) as tif:
        place = tif.pages[0].tags[tag].valueoffset + at
    return content[:place] + struct.pack(form, value) + content[place + struct.calcsize(form) :]


def tiff(values, **how):
    file = io.BytesIO()
    tifffile.imwrite(file, values, **{"photometric": "minisblack", "metadata": None, **how})
    return file.getvalue()
