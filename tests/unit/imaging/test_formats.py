"""Every format at every depth of bits: what is read is what was written."""

import xml.etree.ElementTree as ElementTree

import h5py
import numpy as np
import pytest
import tifffile
from PIL import Image
from tests.unit.imaging.files import of_size, read, refusal, scan

from strandline.foundations import InvalidInput
from strandline.imaging.formats import _size
from strandline.imaging.picture import require_pixels
from strandline.imaging.read import _of_decibels

ROWS, COLUMNS = 23, 31
RNG = np.random.default_rng(1)
BYTES = RNG.integers(0, 256, (ROWS, COLUMNS)).astype(np.uint8)
WORDS = RNG.integers(0, 65536, (ROWS, COLUMNS)).astype(np.uint16)
REALS = RNG.normal(size=(ROWS, COLUMNS)).astype(np.float32)
COLOURS = RNG.integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)
LUMA = np.array([0.2126, 0.7152, 0.0722])


def saved_hdf5(path, values):
    with h5py.File(path, "w") as file:
        file.create_dataset("scan/values", data=values, compression="gzip")


def noted(found, words):
    return any(words in note for note in found.notes)


def test_numbers_come_back(tmp_path):
    of_tiff = (BYTES, WORDS, WORDS.astype(">u2"), WORDS.astype(np.int32) - 999, REALS, REALS.astype(np.float16))
    for name, save, several in (
        ("a.PNG", lambda path, values: Image.fromarray(values).save(path), (BYTES, WORDS, BYTES > 99)),
        ("a.TIFF", tifffile.imwrite, of_tiff),
        ("a.hdf5", saved_hdf5, (WORDS, REALS)),
        ("a.npy", np.save, (BYTES, REALS.astype(">f8"), np.asfortranarray(REALS))),
    ):
        for values in several:
            save(tmp_path / name, values)
            found = read(tmp_path / name)
            np.testing.assert_array_equal(found.values, values.astype(np.float64))
            assert (found.values.dtype, found.pixel, found.name) == (np.float64, (0.002, 0.002), name)


def test_every_layout_of_a_tiff(tmp_path):
    packed = {"compression": "zlib"}
    for how in ({**packed, "predictor": True}, {**packed, "rowsperstrip": 5}, {"tile": (16, 16)}, {"bigtiff": True}):
        tifffile.imwrite(tmp_path / "a.tif", WORDS, **how)
        np.testing.assert_array_equal(read(tmp_path / "a.tif").values, WORDS)
    tifffile.imwrite(tmp_path / "a.tif", BYTES, photometric="miniswhite")
    found = read(tmp_path / "a.tif")
    np.testing.assert_array_equal(found.values, 255 - BYTES.astype(float))
    assert noted(found, "0 is white")


def test_colours_become_grey_or_one_channel(tmp_path):
    Image.fromarray(COLOURS).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", COLOURS)
    tifffile.imwrite(tmp_path / "a.tif", COLOURS, photometric="rgb")
    planes = np.moveaxis(COLOURS, -1, 0)
    tifffile.imwrite(tmp_path / "planes.tif", planes, photometric="rgb", planarconfig="separate")
    for path in sorted(tmp_path.iterdir()):
        found = read(path)
        np.testing.assert_allclose(found.values, COLOURS @ LUMA, rtol=1e-14)
        assert noted(found, "RGB converted to grey by Rec. 709 luma")
        for which, channel in enumerate(("red", "green", "blue")):
            np.testing.assert_array_equal(read(path, channel=channel).values, COLOURS[..., which])


def test_pngs_lose_their_alpha_and_their_palette(tmp_path):
    Image.fromarray(np.dstack([COLOURS, BYTES])).save(tmp_path / "a.png")
    Image.fromarray(np.dstack([BYTES, BYTES]), "LA").save(tmp_path / "b.png")
    image = Image.fromarray(np.array([[0, 1], [2, 1]], np.uint8), "P")
    image.putpalette([10, 10, 10, 20, 20, 20, 0, 255, 0])
    image.save(tmp_path / "c.png")
    for name, expected, atol, said in (
        ("a.png", COLOURS @ LUMA, 1e-12, "the alpha channel is left out"),
        ("b.png", BYTES, 0.0, "the alpha channel is left out"),
        ("c.png", [[10, 20], [255 * 0.7152, 20]], 1e-12, "palette replaced by its colours"),
    ):
        found = read(tmp_path / name)
        np.testing.assert_allclose(found.values, expected, rtol=0.0, atol=atol)
        assert noted(found, said)


def test_a_jpeg_is_turned_as_viewers_show_it(tmp_path):
    exif, wide = Image.Exif(), np.zeros((16, 48), np.uint8)
    exif[0x0112] = 6
    wide[:, :24] = 200
    Image.fromarray(wide).save(tmp_path / "b.JPEG", exif=exif, quality=95)
    found = read(tmp_path / "b.JPEG", pixel={"x": 3.0, "y": 5.0, "unit": "um"})
    assert (found.values.shape, found.pixel) == ((48, 16), (0.003, 0.005))
    assert found.values[:20].min() > 190
    assert found.values[28:].max() < 10


def test_the_dataset_is_named_or_the_only_one(tmp_path):
    """MATLAB's arrays are turned back."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["one/first"], file["one/second"], file["line"] = BYTES, WORDS, np.arange(3)
    np.testing.assert_array_equal(read(tmp_path / "a.h5", dataset="/one/second").values, WORDS)
    assert "holds several arrays: got one/first, one/second" in refusal(tmp_path / "a.h5")
    assert "Did you mean one/second" in refusal(tmp_path / "a.h5", dataset="one/secnd")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        stored = file.create_dataset("scan", data=np.stack([WORDS.T, WORDS.T + 1]))
        stored.attrs["MATLAB_class"] = np.bytes_("uint16")
    found = read(tmp_path / "a.mat", page=1)
    np.testing.assert_array_equal(found.values, WORDS.astype(float) + 1)
    assert noted(found, "MATLAB")


def test_a_scan_and_its_pixel_size(tmp_path):
    decibels = RNG.uniform(20, 60, (4, ROWS, COLUMNS)).astype(np.float32)
    linear = 10 ** (decibels.astype(float) / 10)
    scan(tmp_path / "a.oct", decibels, of_size(ROWS, COLUMNS, 'SizeY="4" RangeZ="1.5" RangeX="3.1" RangeY="0.4"'))
    how = {"pixel": None, "scale": "dB"}
    found = read(tmp_path / "a.oct", **how, page=2, index=1.333)
    np.testing.assert_allclose(found.values, linear[2], rtol=1e-12)
    assert found.pixel == pytest.approx((3.1 / COLUMNS, 1.5 / ROWS / 1.333), rel=1e-12)
    np.testing.assert_allclose(read(tmp_path / "a.oct", **how, average=True).values, linear.mean(0), rtol=1e-12)
    assert "Add `scale: dB`" in refusal(tmp_path / "a.oct")
    sizes = (
        "<SizePixel><SizeZ>5</SizeZ><SizeX>6</SizeX></SizePixel><SizeReal><SizeZ>1</SizeZ><SizeX>3</SizeX></SizeReal>"
    )
    index = "<Acquisition><RefractiveIndex>1.33</RefractiveIndex></Acquisition>"
    scan(tmp_path / "b.oct", np.ones((1, 5, 6)), f"<Ocity><Image>{sizes}</Image>{index}</Ocity>")
    assert "Add `index: 1.33`" in refusal(tmp_path / "b.oct", **how)
    assert read(tmp_path / "b.oct", **how, index=1.0).pixel == pytest.approx((0.5, 0.2))


def test_two_frames_of_a_scan_have_a_distance():
    header = ElementTree.fromstring('<O><DataFile RangeX="2" RangeZ="3" RangeY="4">data/Intensity.data</DataFile></O>')
    assert [_size(header, 10, 20, frames).z for frames in (1, 2)] == [None, 2.0]


def test_pictures_have_rows_and_columns():
    with pytest.raises(InvalidInput, match="has no size that can be read"):
        require_pixels("a.tif", -3, -4, 5)


def test_no_detector_shows_thousands_of_decibels():
    levels = np.array([[5000.0, 5001.0]])
    with pytest.raises(InvalidInput, match="has no logarithms of intensities"):
        _of_decibels(levels, "a.tif")
