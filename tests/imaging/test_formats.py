"""Every format at every depth of bits: what is read is what was written."""

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from jaxtyping import Shaped
from PIL import Image

from strandline.errors import InvalidInput
from strandline.imaging.files.opening import FORMATS
from strandline.imaging.picture import Picture
from strandline.imaging.read import read_picture
from strandline.imaging.reading import PictureReading

ROWS, COLUMNS = 23, 31
RNG = np.random.default_rng(1)
BYTES = RNG.integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
WORDS = RNG.integers(0, 65536, (ROWS, COLUMNS)).astype(np.uint16)
REALS = RNG.normal(size=(ROWS, COLUMNS)).astype(np.float32)
COLOURS = RNG.integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)
SQUARE = {"size": 2.0, "unit": "um"}
LUMA = np.array([0.2126, 0.7152, 0.0722])


def read(path: Path, **options: Any) -> Picture:
    return read_picture(path, PictureReading.from_options({"pixel": SQUARE, **options}, "observation.image"))


def saved_png(path: Path, values: Shaped[np.ndarray, "..."]) -> None:
    Image.fromarray(values).save(path)


def saved_tiff(path: Path, values: Shaped[np.ndarray, "..."]) -> None:
    tifffile.imwrite(path, values)


def saved_hdf5(path: Path, values: Shaped[np.ndarray, "..."]) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("scan/values", data=values, compression="gzip")


@pytest.mark.parametrize(
    ("name", "save", "values"),
    [
        ("a.png", saved_png, BYTES),
        ("a.png", saved_png, WORDS),
        ("a.PNG", saved_png, BYTES > 99),
        ("a.tif", saved_tiff, BYTES),
        ("a.TIFF", saved_tiff, WORDS),
        ("a.tif", saved_tiff, REALS),
        ("a.tif", saved_tiff, REALS.astype(np.float64)),
        ("a.tif", saved_tiff, REALS.astype(np.float16)),
        ("a.tif", saved_tiff, WORDS.astype(np.uint32)),
        ("a.tif", saved_tiff, WORDS.astype(np.int32) - 999),
        ("a.tif", saved_tiff, WORDS.astype(">u2")),
        ("a.h5", saved_hdf5, WORDS),
        ("a.hdf5", saved_hdf5, REALS),
        ("a.npy", np.save, BYTES),
        ("a.npy", np.save, REALS.astype(">f8")),
        ("a.npy", np.save, np.asfortranarray(REALS)),
    ],
    ids=lambda value: getattr(value, "__name__", None) or str(getattr(value, "dtype", value)),
)
def test_numbers_come_back(tmp_path: Path, name: str, save: Any, values: Shaped[np.ndarray, "..."]) -> None:
    save(tmp_path / name, values)
    found = read(tmp_path / name)
    np.testing.assert_array_equal(found.values, values.astype(np.float64))
    assert found.values.dtype == np.float64
    assert found.pixel == (0.002, 0.002)
    assert found.name == name


@pytest.mark.parametrize(
    "how",
    [
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"tile": (16, 16)},
        {"rowsperstrip": 5, "compression": "zlib"},
        {"bigtiff": True},
        {"byteorder": ">"},
    ],
    ids=str,
)
def test_every_layout_of_a_tiff(tmp_path: Path, how: dict[str, Any]) -> None:
    tifffile.imwrite(tmp_path / "a.tif", WORDS, **how)
    np.testing.assert_array_equal(read(tmp_path / "a.tif").values, WORDS)


@pytest.mark.parametrize("compression", [None, "packbits", "tiff_adobe_deflate"])
def test_tiffs_of_another_program(tmp_path: Path, compression: str | None) -> None:
    Image.fromarray(BYTES).save(tmp_path / "a.tif", compression=compression)
    np.testing.assert_array_equal(read(tmp_path / "a.tif").values, BYTES)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "planes.tif", "a.npy"])
@pytest.mark.parametrize("channel", [None, "grey", "red", "green", "blue"])
def test_colours_become_grey_or_one_channel(tmp_path: Path, name: str, channel: str | None) -> None:
    path = tmp_path / name
    if name == "a.png":
        saved_png(path, COLOURS)
    elif name == "a.npy":
        np.save(path, COLOURS)
    elif name == "planes.tif":
        tifffile.imwrite(path, np.moveaxis(COLOURS, -1, 0), photometric="rgb", planarconfig="separate")
    else:
        tifffile.imwrite(path, COLOURS, photometric="rgb")
    found = read(path, **({} if channel is None else {"channel": channel}))
    which = ["red", "green", "blue"].index(channel) if channel in ("red", "green", "blue") else None
    expected = COLOURS @ LUMA if which is None else COLOURS[..., which]
    np.testing.assert_allclose(found.values, expected, rtol=1e-14)
    said = "RGB converted to grey by Rec. 709 luma" if which is None else f"the {channel} channel"
    assert any(said in note for note in found.notes)


def test_alpha_is_left_out_and_said(tmp_path: Path) -> None:
    Image.fromarray(np.dstack([COLOURS, BYTES])).save(tmp_path / "a.png")
    Image.fromarray(np.dstack([BYTES, BYTES]), "LA").save(tmp_path / "b.png")
    for name, expected in (("a.png", COLOURS @ LUMA), ("b.png", BYTES)):
        found = read(tmp_path / name)
        np.testing.assert_allclose(found.values, expected, rtol=1e-14)
        assert "the alpha channel is left out" in found.notes


def test_a_jpeg_is_read_to_its_own_accuracy(tmp_path: Path) -> None:
    smooth = np.add.outer(np.arange(40.0), 2 * np.arange(60.0)).astype(np.uint8)
    for name in ("a.jpg", "a.JPEG"):
        Image.fromarray(smooth).save(tmp_path / name, quality=95)
        found = read(tmp_path / name)
        assert found.values.shape == (40, 60)
        assert abs(found.values - smooth).max() <= 3


def test_a_picture_is_turned_as_viewers_show_it(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    wide = np.zeros((16, 48), np.uint8)
    wide[:, :24] = 200
    Image.fromarray(wide).save(tmp_path / "a.jpg", exif=exif, quality=95)
    found = read(tmp_path / "a.jpg", pixel={"x": 3.0, "y": 5.0, "unit": "um"})
    assert found.values.shape == (48, 16)
    assert found.values[:20].min() > 190
    assert found.values[28:].max() < 10
    assert found.pixel == (0.003, 0.005)
    assert any("EXIF orientation 6" in note for note in found.notes)


def test_a_palette_becomes_its_colours(tmp_path: Path) -> None:
    image = Image.fromarray(np.array([[0, 1], [2, 1]], np.uint8), "P")
    image.putpalette([10, 10, 10, 20, 20, 20, 0, 255, 0])
    image.save(tmp_path / "a.png")
    found = read(tmp_path / "a.png")
    np.testing.assert_allclose(found.values, [[10, 20], [255 * 0.7152, 20]], rtol=1e-12)
    assert "palette replaced by its colours" in found.notes


def test_16_bit_colours_of_a_png_lose_half_of_them_and_say_so(tmp_path: Path) -> None:
    pixels = RNG.integers(0, 65536, (4, 5, 3)).astype(">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    content = b"\x89PNG\r\n\x1a\n"
    header = struct.pack(">IIBBBBB", 5, 4, 16, 2, 0, 0, 0)
    for kind, data in ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")):
        content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    (tmp_path / "a.png").write_bytes(content)
    found = read(tmp_path / "a.png", channel="red")
    np.testing.assert_allclose(found.values, pixels[..., 0] / 257.0, atol=1.0)
    assert "16-bit colours read with 8 bits each; a TIFF keeps them all" in found.notes


def test_white_as_0_is_turned(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", BYTES, photometric="miniswhite")
    found = read(tmp_path / "a.tif")
    np.testing.assert_array_equal(found.values, 255 - BYTES.astype(float))
    assert any("0 is white" in note for note in found.notes)


def test_a_matlab_array_is_turned_back(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        stored = file.create_dataset("scan", data=np.stack([WORDS.T, WORDS.T + 1]))
        stored.attrs["MATLAB_class"] = np.bytes_("uint16")
    found = read(tmp_path / "a.mat", page=1)
    np.testing.assert_array_equal(found.values, WORDS.astype(float) + 1)
    assert any("MATLAB" in note for note in found.notes)


def test_the_dataset_is_named_or_the_only_one(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["one/first"], file["one/second"], file["line"] = BYTES, WORDS, np.arange(3)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", dataset="/one/second").values, WORDS)
    with pytest.raises(InvalidInput, match="holds several arrays: got one/first, one/second"):
        read(tmp_path / "a.h5")
    with pytest.raises(InvalidInput, match="Did you mean one/second"):
        read(tmp_path / "a.h5", dataset="one/secnd")


def scan(path: Path, values: Shaped[np.ndarray, "..."], *, header: str = "", cut: int | None = None) -> None:
    """Write a Thorlabs scan whose frames (y, z, x) measure 1.5 mm in depth, 3.1 mm in x and 0.4 mm in y."""
    frames, rows, columns = values.shape
    content = np.ascontiguousarray(values.transpose(0, 2, 1)).astype("<f4").tobytes()
    header = header or (
        '<?xml version="1.0"?><Ocity><Acquisition><RefractiveIndex>1.000000</RefractiveIndex></Acquisition><DataFiles>'
        '<DataFile Type="Colored" SizeZ="4" SizeX="4">data\\VideoImage.data</DataFile>'
        f'<DataFile Type="Real" SizeZ="{rows}" SizeX="{columns}" SizeY="{frames}" RangeZ="1.5" RangeX="3.1" '
        'RangeY="0.4" BytesPerPixel="4">data\\Intensity.data</DataFile></DataFiles></Ocity>'
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Header.xml", header)
        archive.writestr("data\\Intensity.data", content[:cut])


def test_a_scan_and_its_pixel_size(tmp_path: Path) -> None:
    decibels = RNG.uniform(20, 60, (4, ROWS, COLUMNS)).astype(np.float32)
    scan(tmp_path / "a.oct", decibels)
    found = read(tmp_path / "a.oct", pixel=None, scale="dB", page=2, index=1.333)
    np.testing.assert_allclose(found.values, 10 ** (decibels[2].astype(float) / 10), rtol=1e-12)
    assert found.pixel == pytest.approx((3.1 / COLUMNS, 1.5 / ROWS / 1.333), rel=1e-12)
    assert "index 1.333 divides y" in found.notes
    assert any("from the header of the scan" in note for note in found.notes)
    assert any(note.startswith("frame 2 of 4") and note.endswith("from the study") for note in found.notes)
    mean = read(tmp_path / "a.oct", pixel=None, scale="dB", average=True)
    np.testing.assert_allclose(mean.values, (10 ** (decibels.astype(float) / 10)).mean(0), rtol=1e-12)


def test_a_scan_needs_its_scale_and_the_meaning_of_its_index(tmp_path: Path) -> None:
    scan(tmp_path / "a.oct", np.ones((1, 5, 6)))
    with pytest.raises(InvalidInput, match=r"needs `scale`.*Add `scale: dB`"):
        read(tmp_path / "a.oct")
    header = (
        "<Ocity><Image><SizePixel><SizeZ>5</SizeZ><SizeX>6</SizeX></SizePixel><SizeReal><SizeZ>1</SizeZ><SizeX>3"
        "</SizeX></SizeReal></Image><Acquisition><RefractiveIndex>1.33</RefractiveIndex></Acquisition></Ocity>"
    )
    scan(tmp_path / "b.oct", np.ones((1, 5, 6)), header=header)
    with pytest.raises(InvalidInput, match=r"states a refractive index: got 1\.33.*Add `index: 1\.33`"):
        read(tmp_path / "b.oct", pixel=None, scale="dB")
    found = read(tmp_path / "b.oct", pixel=None, scale="dB", index=1.0)
    assert found.pixel == pytest.approx((0.5, 0.2))


def test_the_tests_cover_all_formats() -> None:
    assert set(FORMATS) == {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".oct", ".h5", ".hdf5", ".mat", ".npy"}
