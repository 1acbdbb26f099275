"""Files that cannot be used: one line each, before memory is taken."""

import io
import struct
import sys
import zlib
from contextlib import suppress

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from tests.unit.imaging.files import oct_file, of_size, png, read, reading, refusal, tiff, with_tag

from strandline.foundations import InvalidInput
from strandline.imaging.formats import require_parts
from strandline.imaging.picture import PictureFile, require_pixels
from strandline.imaging.read import read_stack

HUGE = 200_000
"""Rows and columns of a picture of 40 gigapixels."""
NOISE = np.random.default_rng(2).integers(0, 65536, (64, 80)).astype(np.uint16)


BYTES = Image.fromarray((NOISE // 256).astype(np.uint8))


def saved(write):
    """Return what a function writes to a file."""
    file = io.BytesIO()
    write(file)
    return file.getvalue()


def hdf5(file):
    with h5py.File(file, "w") as archive:
        archive["a"] = NOISE


WHOLE = {
    "a.png": saved(lambda file: Image.fromarray(NOISE).save(file, "PNG")),
    "a.jpg": saved(lambda file: BYTES.save(file, "JPEG", quality=95)),
    "a.tif": tiff(NOISE),
    "strips.tif": tiff(NOISE, rowsperstrip=8, compression="zlib"),
    "tiles.tif": tiff(NOISE, tile=(16, 16)),
    "stack.tif": tiff(np.stack([NOISE, NOISE, NOISE])),
    "a.h5": saved(hdf5),
    "a.npy": saved(lambda file: np.save(file, NOISE)),
    "a.oct": oct_file(of_size(64, 80), NOISE.astype("<f4").tobytes()),
}


@pytest.mark.parametrize("name", WHOLE)
@settings(max_examples=10)
@given(share=st.floats(0.0, 0.99), flipped=st.lists(st.floats(0.0, 0.999), max_size=3))
def test_a_damaged_file_is_refused_in_one_line_or_read(tmp_path_factory, name, share, flipped):
    """A file that is cut off is always refused. Bits of HDF5 are not flipped: its library is not safe against it."""
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(WHOLE[name][: int(share * len(WHOLE[name]))])
    refusal(path, scale="intensity")
    content = bytearray(WHOLE[name])
    for place in flipped if name != "a.h5" else ():
        content[int(place * len(content))] ^= 0xFF
    path.write_bytes(bytes(content))
    with suppress(InvalidInput):
        assert np.isfinite(read(path, scale="intensity").values).all()
        return
    refusal(path, scale="intensity")


def test_a_huge_header_is_refused(tmp_path):
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("a", (5, 10_000, 10_000), "u1", chunks=(1, 64, 64))[..., :2, :2] = 1
    with pytest.raises(InvalidInput, match=r"b\.h5 has no size that can be read: got 5 × 10000 × 10000"):
        read_stack(tmp_path / "b.h5", reading(pixel={"size": 2.0, "z": 7.0, "unit": "um"}))
    header, small = {"descr": "<f8", "fortran_order": False, "shape": (HUGE, HUGE)}, tiff(np.zeros((4, 4), np.uint8))
    array, jpeg = saved(lambda file: np.lib.format.write_array_header_1_0(file, header)), WHOLE["a.jpg"]
    place = jpeg.index(b"\xff\xc0") + 5
    for name, content, said in (
        ("a.png", png(HUGE, HUGE, b""), "from 1 to 400 million pixels"),
        ("a.tif", with_tag(with_tag(small, "ImageWidth", HUGE), "ImageLength", HUGE), "from 1 to 400 million pixels"),
        ("a.npy", array + bytes(64), "mmap length"),
        ("a.oct", oct_file(of_size(HUGE, HUGE), bytes(64)), "from 1 to 400 million pixels"),
        ("a.jpg", jpeg[:place] + struct.pack(">HH", 65000, 65000) + jpeg[place + 4 :], "from 1 to 400 million pixels"),
    ):
        (tmp_path / name).write_bytes(content)
        assert said in refusal(tmp_path / name, scale="intensity")


def test_the_bound_on_pixels_is_that_of_this_package(tmp_path, monkeypatch):
    require_pixels("a", 20_000, 20_000)
    for rows, columns in ((20_000, 20_001), (0, 5), (-2, -2)):
        with pytest.raises(InvalidInput, match=f"got {rows} × {columns}"):
            require_pixels("a", rows, columns)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    (tmp_path / "a.png").write_bytes(WHOLE["a.png"])
    assert read(tmp_path / "a.png").values.shape == NOISE.shape


def test_files_that_unpack_without_end_are_refused(tmp_path):
    """An archive with more numbers than pixels, a TIFF file with a strip of 16 MB, headers that grow."""
    (tmp_path / "a.oct").write_bytes(oct_file(of_size(10, 10), bytes(5_000_000)))
    assert "an intensity of another length: got 5000000" in refusal(tmp_path / "a.oct", scale="dB")
    entities = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))
    bomb = f'<!DOCTYPE x [<!ENTITY a0 "0123456789">{entities}]><Ocity>&a9;</Ocity>'
    (tmp_path / "a.oct").write_bytes(oct_file(bomb, bytes(400)))
    assert "has a header that cannot be read" in refusal(tmp_path / "a.oct", scale="dB")
    content, packed = tiff(NOISE, compression="zlib"), zlib.compress(bytes(1 << 24), 9)
    content = with_tag(with_tag(content, "StripOffsets", len(content)), "StripByteCounts", len(packed))
    (tmp_path / "a.tif").write_bytes(content + packed)
    with (
        tifffile.TiffFile(tmp_path / "a.tif") as bad,
        pytest.raises(ValueError, match="unpack to more than its pixels"),
    ):
        require_parts(tmp_path / "a.tif", bad.pages[0], most=1 << 20)


def test_what_a_header_states_must_be_there(tmp_path):
    tiles, circle = tiff(NOISE, tile=(16, 16)), bytearray(WHOLE["a.tif"])
    end = 10 + 12 * struct.unpack("<H", WHOLE["a.tif"][8:10])[0]
    circle[end : end + 4] = struct.pack("<I", 8)
    for content, said in (
        (with_tag(tiles, "ImageLength", 64000), "19980 of its 20000 strips or tiles are missing"),
        (with_tag(tiles, "TileByteCounts", 0, form="<H", at=4), "1 of its 20 strips or tiles are missing"),
        (bytes(circle), "pages lie in a circle"),
    ):
        (tmp_path / "a.tif").write_bytes(content)
        assert said in refusal(tmp_path / "a.tif")
    (tmp_path / "a.oct").write_bytes(oct_file(of_size("-4", 10), bytes(400)))
    assert "SizeZ in its header" in refusal(tmp_path / "a.oct", scale="dB")


def test_numbers_that_are_no_finite_pixels_are_refused(tmp_path):
    values = NOISE.astype(np.float32)
    values[3, 4:7] = np.nan, np.inf, -np.inf
    (tmp_path / "a.tif").write_bytes(tiff(values))
    assert "not finite: got 3 of 5120" in refusal(tmp_path / "a.tif")
    np.save(tmp_path / "a.npy", NOISE + 1j)
    assert "complex128" in refusal(tmp_path / "a.npy")


def test_colours_formats_and_arrays_that_are_not_read_say_why(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(500))
    Image.new("CMYK", (8, 8)).save(tmp_path / "a.jpg")
    colours = {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)}
    (tmp_path / "a.tif").write_bytes(tiff(np.zeros((8, 8), np.uint8), **colours))
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("a", (10, 10), "u1", external=[("raw", 0, 100)])
    for name, said in (
        ("a.png", "is missing"),
        ("a.mat", "'-v7.3'"),
        ("a.jpg", "CMYK"),
        ("a.tif", "PALETTE"),
        ("b.h5", "refers to other files"),
    ):
        assert said in refusal(tmp_path / name)


def test_a_missing_package_names_its_install_command(tmp_path, monkeypatch):
    (tmp_path / "a.tif").write_bytes(saved(lambda file: BYTES.save(file, "TIFF", compression="tiff_lzw")))
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    assert "pip install imagecodecs" in refusal(tmp_path / "a.tif")


def read_raw(path, how, name):
    return PictureFile(NOISE.shape, lambda frame: np.fromfile(path, np.uint16).reshape(NOISE.shape))


def test_a_reader_of_the_users_own(tmp_path):
    (tmp_path / "a.raw").write_bytes(NOISE.tobytes())
    np.testing.assert_array_equal(read(tmp_path / "a.raw", reader=f"{__name__}:read_raw").values, NOISE)
