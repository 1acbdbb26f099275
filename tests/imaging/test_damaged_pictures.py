"""Files that cannot be used: one line each, before memory is taken."""

import io
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from PIL import Image

from strandline.errors import InvalidInput
from strandline.imaging.files import contents, tiff_pages
from strandline.imaging.files.contents import PictureFile
from strandline.imaging.read import read_picture
from strandline.imaging.reading import PictureReading

HUGE = 200_000
"""Rows and columns of a picture of 40 gigapixels."""
RNG = np.random.default_rng(2)
NOISE = RNG.integers(0, 65536, (64, 80)).astype(np.uint16)


def refusal(path: Path, **options: Any) -> str:
    """Return the message with which the picture is refused, and require that it is one line."""
    how = PictureReading.from_options({"pixel": {"size": 2.0, "unit": "um"}, **options}, "image")
    with pytest.raises(InvalidInput) as caught:
        read_picture(path, how)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    assert len(message) < 700
    return message


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width: int, height: int, content: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(content)) + chunk(b"IEND", b"")


def huge_tiff() -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, np.zeros((4, 4), np.uint8), metadata=None)
    file.seek(0)
    with tifffile.TiffFile(file) as tif:
        places = [tif.pages[0].tags[name].valueoffset for name in ("ImageWidth", "ImageLength")]
        kinds = [tif.pages[0].tags[name].dtype for name in ("ImageWidth", "ImageLength")]
    data = bytearray(file.getvalue())
    for place, kind in zip(places, kinds, strict=True):
        assert kind == 4  # LONG
        data[place : place + 4] = struct.pack("<I", HUGE)
    return bytes(data)


def huge_npy() -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (HUGE, HUGE)})
    return file.getvalue() + bytes(64)


def huge_oct() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        entry = f'<DataFile SizeZ="{HUGE}" SizeX="{HUGE}">data\\Intensity.data</DataFile>'
        archive.writestr("Header.xml", f"<Ocity><DataFiles>{entry}</DataFiles></Ocity>")
        archive.writestr("data\\Intensity.data", bytes(64))
    return file.getvalue()


def huge_jpeg() -> bytes:
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "JPEG")
    data = bytearray(file.getvalue())
    place = data.index(b"\xff\xc0") + 5
    data[place : place + 4] = struct.pack(">HH", 65000, 65000)
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.png", png(HUGE, HUGE, b"")),
        ("a.tif", huge_tiff()),
        ("a.npy", huge_npy()),
        ("a.oct", huge_oct()),
        ("a.jpg", huge_jpeg()),
    ],
    ids=["png", "tif", "npy", "oct", "jpg"],
)
def test_a_huge_header_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    message = refusal(tmp_path / name, scale="intensity")
    assert ("from 1 to 400 million pixels" in message) or (name == "a.npy" and "mmap length" in message)


def test_a_huge_dataset_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (HUGE, HUGE), "u1", chunks=(64, 64))[:2, :2] = 1
    assert "from 1 to 400 million pixels" in refusal(tmp_path / "a.h5")


def test_the_bound_is_that_of_this_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    Image.fromarray(NOISE).save(tmp_path / "a.png")
    how = PictureReading.from_options({"pixel": {"size": 1, "unit": "um"}}, "image")
    assert read_picture(tmp_path / "a.png", how).values.shape == NOISE.shape
    monkeypatch.setattr(contents, "MOST_PIXELS", NOISE.size - 1)
    assert "64 × 80" in refusal(tmp_path / "a.png")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.02, 0.3, 0.6, 0.9, 0.99])
@pytest.mark.parametrize("kind", ["png", "jpg", "tif", "strips.tif", "tiles.tif", "stack.tif", "h5", "npy", "oct"])
def test_a_file_that_is_cut_off_is_refused(tmp_path: Path, kind: str, share: float) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "png":
        Image.fromarray(NOISE).save(path)
    elif kind == "jpg":
        Image.fromarray((NOISE // 256).astype(np.uint8)).save(path, quality=95)
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file["a"] = NOISE
    elif kind == "npy":
        np.save(path, NOISE)
    elif kind == "oct":
        with zipfile.ZipFile(path, "w") as archive:
            entry = '<DataFile SizeZ="64" SizeX="80">data\\Intensity.data</DataFile>'
            archive.writestr("Header.xml", f"<Ocity><DataFiles>{entry}</DataFiles></Ocity>")
            archive.writestr("data\\Intensity.data", NOISE.astype("<f4").tobytes())
    else:
        options: dict[str, dict[str, Any]] = {
            "strips.tif": {"rowsperstrip": 8, "compression": "zlib"},
            "tiles.tif": {"tile": (16, 16)},
            "stack.tif": {"metadata": None},
        }
        stack = np.stack([NOISE, NOISE, NOISE])
        values = stack if kind == "stack.tif" else NOISE
        tifffile.imwrite(path, values, photometric="minisblack", **options.get(kind, {}))
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refusal(path, scale="intensity")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.oct", "a.h5", "a.mat", "a.npy"])
@pytest.mark.parametrize("content", [b"", b"x", b"II*\0" + bytes(200), b"PK\3\4" + bytes(100), bytes(5000)])
def test_garbage_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    refusal(tmp_path / name, scale="intensity")


def test_a_picture_with_another_suffix_is_refused(tmp_path: Path) -> None:
    Image.fromarray(NOISE).save(tmp_path / "a.png")
    for name in ("b.tif", "b.jpg", "b.oct", "b.h5", "b.npy"):
        (tmp_path / name).write_bytes((tmp_path / "a.png").read_bytes())
        refusal(tmp_path / name, scale="intensity")


def test_a_flipped_bit_in_compressed_numbers_is_refused(tmp_path: Path) -> None:
    for name in ("a.png", "a.tif"):
        if name == "a.png":
            Image.fromarray(NOISE).save(tmp_path / name)
        else:
            tifffile.imwrite(tmp_path / name, NOISE, compression="zlib")
        content = bytearray((tmp_path / name).read_bytes())
        content[len(content) // 2] ^= 0xFF
        (tmp_path / name).write_bytes(bytes(content))
        refusal(tmp_path / name)


def test_an_archive_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.oct", "w", zipfile.ZIP_DEFLATED) as archive:
        entry = '<DataFile SizeZ="10" SizeX="10">data\\Intensity.data</DataFile>'
        archive.writestr("Header.xml", f"<Ocity><DataFiles>{entry}</DataFiles></Ocity>")
        archive.writestr("data\\Intensity.data", bytes(50_000_000))
    assert "an intensity of another length: got 50000000" in refusal(tmp_path / "a.oct", scale="dB")


def test_a_tiff_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff_pages, "MOST_UNPACKED", 1 << 20)
    packed = zlib.compress(bytes(1 << 24), 9)
    tifffile.imwrite(tmp_path / "a.tif", NOISE, compression="zlib", metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        places = [tif.pages[0].tags[name].valueoffset for name in ("StripOffsets", "StripByteCounts")]
    content = bytearray((tmp_path / "a.tif").read_bytes())
    for place, number in zip(places, (len(content), len(packed)), strict=True):
        content[place : place + 4] = struct.pack("<I", number)
    (tmp_path / "a.tif").write_bytes(bytes(content) + packed)
    assert "unpack to more than its pixels" in refusal(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "b.tif", np.tile(NOISE, (20, 20)), compression="zlib")
    how = PictureReading.from_options({"pixel": {"size": 2.0, "unit": "um"}}, "image")
    np.testing.assert_array_equal(read_picture(tmp_path / "b.tif", how).values, np.tile(NOISE, (20, 20)))


def test_a_tiff_without_all_its_tiles_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", NOISE, tile=(16, 16), metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        height = tif.pages[0].tags["ImageLength"].valueoffset
        counts = tif.pages[0].tags["TileByteCounts"].valueoffset
    content = (tmp_path / "a.tif").read_bytes()
    for place, number, missing in ((height, 64000, "19980 of its 20000"), (counts + 4, 0, "1 of its 20")):
        changed = bytearray(content)
        form = "<I" if place == height else "<H"
        changed[place : place + struct.calcsize(form)] = struct.pack(form, number)
        (tmp_path / "a.tif").write_bytes(bytes(changed))
        assert f"{missing} strips or tiles are missing" in refusal(tmp_path / "a.tif")


def test_a_header_that_grows_without_end_is_refused(tmp_path: Path) -> None:
    entities = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(9))
    bomb = f'<!DOCTYPE x [<!ENTITY a0 "0123456789">{entities}]><Ocity>&a9;</Ocity>'
    for header in (bomb, "<Ocity>" + " " * (1 << 24) + "</Ocity>"):
        with zipfile.ZipFile(tmp_path / "a.oct", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("Header.xml", header)
            archive.writestr("data\\Intensity.data", bytes(400))
        assert "has a header that cannot be read" in refusal(tmp_path / "a.oct", scale="dB")


@pytest.mark.parametrize("size", ["", "0", "-4", "4.5", "1e3", "99999999999"])
def test_a_scan_of_an_odd_size_is_refused(tmp_path: Path, size: str) -> None:
    with zipfile.ZipFile(tmp_path / "a.oct", "w") as archive:
        entry = f'<DataFile SizeZ="{size}" SizeX="10">data\\Intensity.data</DataFile>'
        archive.writestr("Header.xml", f"<Ocity><DataFiles>{entry}</DataFiles></Ocity>")
        archive.writestr("data\\Intensity.data", bytes(400))
    assert "SizeZ in its header" in refusal(tmp_path / "a.oct", scale="dB")


def test_pages_in_a_circle_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", NOISE, metadata=None)
    content = bytearray((tmp_path / "a.tif").read_bytes())
    entries = struct.unpack("<H", content[8:10])[0]
    content[10 + 12 * entries : 14 + 12 * entries] = struct.pack("<I", 8)
    (tmp_path / "a.tif").write_bytes(bytes(content))
    assert "pages lie in a circle" in refusal(tmp_path / "a.tif")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_are_refused(tmp_path: Path, bad: float) -> None:
    values = NOISE.astype(np.float32)
    values[3, 4:7] = bad
    tifffile.imwrite(tmp_path / "a.tif", values)
    assert "not finite: got 3 of 5120" in refusal(tmp_path / "a.tif")


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (0, 5, 5), (7,), ()])
def test_an_array_without_pixels_is_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "a.npy", np.zeros(shape))
    refusal(tmp_path / "a.npy")


def test_numbers_that_are_not_real_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", NOISE + 1j)
    assert "complex128" in refusal(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", np.array([[{}, {}]], dtype=object), allow_pickle=True)
    refusal(tmp_path / "b.npy")
    np.save(tmp_path / "c.npy", np.array([["a", "b"]]))
    refusal(tmp_path / "c.npy")


def test_unusual_colours_are_refused(tmp_path: Path) -> None:
    Image.new("CMYK", (8, 8)).save(tmp_path / "a.jpg")
    assert "CMYK" in refusal(tmp_path / "a.jpg")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((8, 8), np.uint8), colormap=np.zeros((3, 256), np.uint16))
    assert "PALETTE" in refusal(tmp_path / "a.tif")


def test_missing_files_folders_and_unknown_formats(tmp_path: Path) -> None:
    assert "is missing" in refusal(tmp_path / "a.png")
    (tmp_path / "b.png").mkdir()
    assert "folder b.png: got no picture in it" in refusal(tmp_path / "b.png")
    (tmp_path / "c.bmp").write_bytes(b"BM")
    assert "unknown format: got .bmp; expected .png" in refusal(tmp_path / "c.bmp")


def test_an_old_matlab_file_names_the_option_that_saves_a_new_one(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(500))
    assert "'-v7.3'" in refusal(tmp_path / "a.mat")


def test_an_array_that_was_never_written_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (10, 10), "u1")
    assert "was never written" in refusal(tmp_path / "a.h5")


def test_arrays_in_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "raw").write_bytes(bytes(100))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", (10, 10), "u1", external=[("raw", 0, 100)])
    assert "refers to other files" in refusal(tmp_path / "a.h5")


def test_a_missing_tifffile_names_its_install_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tifffile.imwrite(tmp_path / "a.tif", NOISE)
    monkeypatch.setitem(sys.modules, "tifffile", None)
    assert 'pip install "strandline[image]"' in refusal(tmp_path / "a.tif")


def test_a_compression_that_cannot_be_unpacked_names_what_can(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "imagecodecs", None)
        Image.fromarray((NOISE // 256).astype(np.uint8)).save(tmp_path / "a.tif", compression="tiff_lzw")
        assert "pip install imagecodecs" in refusal(tmp_path / "a.tif")


def test_a_damaged_tiff_prints_nothing_else(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", NOISE, rowsperstrip=8, metadata=None)
    with tifffile.TiffFile(tmp_path / "a.tif") as tif:
        place = tif.pages[0].tags["ImageLength"].valueoffset
    content = bytearray((tmp_path / "a.tif").read_bytes())
    content[place : place + 4] = struct.pack("<I", 6400)
    (tmp_path / "a.tif").write_bytes(bytes(content))
    program = (
        "import sys, pathlib\nfrom strandline.imaging.read import read_picture\n"
        "from strandline.imaging.reading import PictureReading\n"
        "try:\n    read_picture(pathlib.Path(sys.argv[1]), PictureReading())\n"
        "except Exception as error:\n    print(type(error).__name__)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "a.tif"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("Unreadable\n", "")


def test_a_reader_of_the_users_own(tmp_path: Path) -> None:
    (tmp_path / "a.raw").write_bytes(NOISE.tobytes())
    how = {"pixel": {"size": 1, "unit": "um"}, "reader": f"{__name__}:read_raw"}
    found = read_picture(tmp_path / "a.raw", PictureReading.from_options(how, "image"))
    np.testing.assert_array_equal(found.values, NOISE)


def read_raw(path: Path, how: PictureReading, name: str) -> PictureFile:
    values = np.fromfile(path, np.uint16).reshape(NOISE.shape)
    return PictureFile(NOISE.shape, lambda frame: values)
