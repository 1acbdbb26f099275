"""Every format at every depth of bits: what is read is what was written."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from jaxtyping import Shaped
from PIL import Image
from tests.unit.imaging.files import png, read, scan

from strandline.errors import InvalidInput
from strandline.imaging.files.opening import FORMATS

ROWS, COLUMNS = 23, 31
RNG = np.random.default_rng(1)
BYTES = RNG.integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
WORDS = RNG.integers(0, 65536, (ROWS, COLUMNS)).astype(np.uint16)
REALS = RNG.normal(size=(ROWS, COLUMNS)).astype(np.float32)
COLOURS = RNG.integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)
LUMA = np.array([0.2126, 0.7152, 0.0722])


def saved_png(path: Path, values: Shaped[np.ndarray, "..."]) -> None:
    Image.fromarray(values).save(path)


def saved_hdf5(path: Path, values: Shaped[np.ndarray, "..."]) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("scan/values", data=values, compression="gzip")


def test_numbers_come_back(tmp_path: Path) -> None:
    tif = tifffile.imwrite
    for number, (name, save, values) in enumerate(
        (
            ("a.png", saved_png, BYTES),
            ("a.png", saved_png, WORDS),
            ("a.PNG", saved_png, BYTES > 99),
            ("a.tif", tif, BYTES),
            ("a.TIFF", tif, WORDS),
            ("a.tif", tif, REALS),
            ("a.tif", tif, REALS.astype(np.float64)),
            ("a.tif", tif, REALS.astype(np.float16)),
            ("a.tif", tif, WORDS.astype(np.uint32)),
            ("a.tif", tif, WORDS.astype(np.int32) - 999),
            ("a.tif", tif, WORDS.astype(">u2")),
            ("a.h5", saved_hdf5, WORDS),
            ("a.hdf5", saved_hdf5, REALS),
            ("a.npy", np.save, BYTES),
            ("a.npy", np.save, REALS.astype(">f8")),
            ("a.npy", np.save, np.asfortranarray(REALS)),
        )
    ):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        save(path, values)
        found = read(path)
        np.testing.assert_array_equal(found.values, values.astype(np.float64))
        assert found.values.dtype == np.float64
        assert found.pixel == (0.002, 0.002)
        assert found.name == name
    assert set(FORMATS) == {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".oct", ".h5", ".hdf5", ".mat", ".npy"}


def test_every_layout_of_a_tiff(tmp_path: Path) -> None:
    for how in (
        {"compression": "zlib"},
        {"compression": "zlib", "predictor": True},
        {"tile": (16, 16)},
        {"rowsperstrip": 5, "compression": "zlib"},
        {"bigtiff": True},
        {"byteorder": ">"},
    ):
        tifffile.imwrite(tmp_path / "a.tif", WORDS, **how)
        np.testing.assert_array_equal(read(tmp_path / "a.tif").values, WORDS)
    for compression in (None, "packbits", "tiff_adobe_deflate"):
        Image.fromarray(BYTES).save(tmp_path / "b.tif", compression=compression)
        np.testing.assert_array_equal(read(tmp_path / "b.tif").values, BYTES)


def test_colours_become_grey_or_one_channel(tmp_path: Path) -> None:
    saved_png(tmp_path / "a.png", COLOURS)
    np.save(tmp_path / "a.npy", COLOURS)
    tifffile.imwrite(tmp_path / "a.tif", COLOURS, photometric="rgb")
    planes = np.moveaxis(COLOURS, -1, 0)
    tifffile.imwrite(tmp_path / "planes.tif", planes, photometric="rgb", planarconfig="separate")
    for name in ("a.png", "a.tif", "planes.tif", "a.npy"):
        for options in ({}, {"channel": "grey"}):
            found = read(tmp_path / name, **options)
            np.testing.assert_allclose(found.values, COLOURS @ LUMA, rtol=1e-14)
            assert any("RGB converted to grey by Rec. 709 luma" in note for note in found.notes)
        for which, channel in enumerate(("red", "green", "blue")):
            found = read(tmp_path / name, channel=channel)
            np.testing.assert_array_equal(found.values, COLOURS[..., which])
            assert any(f"the {channel} channel" in note for note in found.notes)


def test_alpha_is_left_out_and_a_palette_becomes_its_colours(tmp_path: Path) -> None:
    Image.fromarray(np.dstack([COLOURS, BYTES])).save(tmp_path / "a.png")
    Image.fromarray(np.dstack([BYTES, BYTES]), "LA").save(tmp_path / "b.png")
    for name, expected in (("a.png", COLOURS @ LUMA), ("b.png", BYTES)):
        found = read(tmp_path / name)
        np.testing.assert_allclose(found.values, expected, rtol=1e-14)
        assert "the alpha channel is left out" in found.notes
    image = Image.fromarray(np.array([[0, 1], [2, 1]], np.uint8), "P")
    image.putpalette([10, 10, 10, 20, 20, 20, 0, 255, 0])
    image.save(tmp_path / "c.png")
    found = read(tmp_path / "c.png")
    np.testing.assert_allclose(found.values, [[10, 20], [255 * 0.7152, 20]], rtol=1e-12)
    assert "palette replaced by its colours" in found.notes


def test_a_jpeg_is_read_to_its_own_accuracy_and_turned_as_viewers_show_it(tmp_path: Path) -> None:
    smooth = np.add.outer(np.arange(40.0), 2 * np.arange(60.0)).astype(np.uint8)
    for name in ("a.jpg", "a.JPEG"):
        Image.fromarray(smooth).save(tmp_path / name, quality=95)
        found = read(tmp_path / name)
        assert found.values.shape == (40, 60)
        assert abs(found.values - smooth).max() <= 3
    exif, wide = Image.Exif(), np.zeros((16, 48), np.uint8)
    exif[0x0112] = 6
    wide[:, :24] = 200
    Image.fromarray(wide).save(tmp_path / "b.jpg", exif=exif, quality=95)
    found = read(tmp_path / "b.jpg", pixel={"x": 3.0, "y": 5.0, "unit": "um"})
    assert found.values.shape == (48, 16)
    assert found.values[:20].min() > 190
    assert found.values[28:].max() < 10
    assert found.pixel == (0.003, 0.005)
    assert any("EXIF orientation 6" in note for note in found.notes)


def test_16_bit_colours_of_a_png_lose_half_of_them_and_white_as_0_is_turned(tmp_path: Path) -> None:
    pixels = RNG.integers(0, 65536, (4, 5, 3)).astype(">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    (tmp_path / "a.png").write_bytes(png(5, 4, rows, bits=16, colour=2))
    found = read(tmp_path / "a.png", channel="red")
    np.testing.assert_allclose(found.values, pixels[..., 0] / 257.0, atol=1.0)
    assert "16-bit colours read with 8 bits each; a TIFF keeps them all" in found.notes
    tifffile.imwrite(tmp_path / "a.tif", BYTES, photometric="miniswhite")
    found = read(tmp_path / "a.tif")
    np.testing.assert_array_equal(found.values, 255 - BYTES.astype(float))
    assert any("0 is white" in note for note in found.notes)


def test_the_dataset_is_named_or_the_only_one(tmp_path: Path) -> None:
    """MATLAB's arrays are turned back."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["one/first"], file["one/second"], file["line"] = BYTES, WORDS, np.arange(3)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", dataset="/one/second").values, WORDS)
    with pytest.raises(InvalidInput, match="holds several arrays: got one/first, one/second"):
        read(tmp_path / "a.h5")
    with pytest.raises(InvalidInput, match="Did you mean one/second"):
        read(tmp_path / "a.h5", dataset="one/secnd")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        stored = file.create_dataset("scan", data=np.stack([WORDS.T, WORDS.T + 1]))
        stored.attrs["MATLAB_class"] = np.bytes_("uint16")
    found = read(tmp_path / "a.mat", page=1)
    np.testing.assert_array_equal(found.values, WORDS.astype(float) + 1)
    assert any("MATLAB" in note for note in found.notes)


def test_a_scan_and_its_pixel_size(tmp_path: Path) -> None:
    decibels = RNG.uniform(20, 60, (4, ROWS, COLUMNS)).astype(np.float32)
    linear = 10 ** (decibels.astype(float) / 10)
    scan(tmp_path / "a.oct", decibels)
    how: dict[str, Any] = {"pixel": None, "scale": "dB"}
    found = read(tmp_path / "a.oct", **how, page=2, index=1.333)
    np.testing.assert_allclose(found.values, linear[2], rtol=1e-12)
    assert found.pixel == pytest.approx((3.1 / COLUMNS, 1.5 / ROWS / 1.333), rel=1e-12)
    assert "index 1.333 divides y" in found.notes
    assert any("from the header of the scan" in note for note in found.notes)
    assert any(note.startswith("frame 2 of 4") and note.endswith("from the study") for note in found.notes)
    np.testing.assert_allclose(read(tmp_path / "a.oct", **how, average=True).values, linear.mean(0), rtol=1e-12)
    with pytest.raises(InvalidInput, match=r"needs `scale`.*Add `scale: dB`"):
        read(tmp_path / "a.oct")
    header = (
        "<Ocity><Image><SizePixel><SizeZ>5</SizeZ><SizeX>6</SizeX></SizePixel><SizeReal><SizeZ>1</SizeZ><SizeX>3"
        "</SizeX></SizeReal></Image><Acquisition><RefractiveIndex>1.33</RefractiveIndex></Acquisition></Ocity>"
    )
    scan(tmp_path / "b.oct", np.ones((1, 5, 6)), header=header)
    with pytest.raises(InvalidInput, match=r"states a refractive index: got 1\.33.*Add `index: 1\.33`"):
        read(tmp_path / "b.oct", **how)
    assert read(tmp_path / "b.oct", **how, index=1.0).pixel == pytest.approx((0.5, 0.2))
