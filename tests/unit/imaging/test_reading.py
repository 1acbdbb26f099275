"""Pages, frames, pixel sizes, the refractive index and the scale: where they come from, and mistakes."""

import hashlib

import numpy as np
import pytest
import tifffile
from PIL import Image
from tests.unit.imaging.files import SQUARE, read, reading, refusal

from strandline.foundations import InvalidInput
from strandline.imaging.picture import PixelSize
from strandline.imaging.read import read_frames, read_picture, read_stack

RNG = np.random.default_rng(3)
NOISE = RNG.integers(0, 65536, (5, 20, 30)).astype(np.uint16)
VOXEL = {"size": 2.0, "z": 7.0, "unit": "um"}


def imagej(path, values=NOISE[0], *, axes="YX", **header):
    tifffile.imwrite(path, values, imagej=True, resolution=(2.0, 4.0), metadata={"axes": axes, **header})


def ome(path, values=NOISE[0], *, axes="YX", **header):
    tifffile.imwrite(path, values, ome=True, metadata={"axes": axes, **header})


def saved_frames(folder):
    paths = [folder / f"{k}.npy" for k in range(5)]
    for path, values in zip(paths, NOISE, strict=True):
        np.save(path, values)
    return paths


MISTAKES = [
    ({"pagee": 1}, "unknown option: got pagee;.*Did you mean page"),
    ({"page": -1}, r"observation\.image\.page: got -1"),
    ({"average": True, "page": 0}, "page and average: got both; expected one of the two"),
    ({"index": 0.5}, r"observation\.image\.index: got 0\.5"),
    ({"scale": "db"}, "expected one of intensity, amplitude, log10, dB, sRGB. Did you mean dB"),
    ({"pixel": {"size": 3.0}}, r"observation\.image\.pixel\.unit: got nothing"),
    ({"pixel": {"size": 0, "unit": "um"}}, r"observation\.image\.pixel\.size: got 0"),
]


def test_options_their_units_and_mistakes_in_them():
    for options, said in MISTAKES:
        with pytest.raises(InvalidInput, match=said) as caught:
            reading(**options)
        assert "\n" not in str(caught.value)
    how = reading(page=3, scale="dB", pixel={"x": 6, "y": 4, "unit": "um"}, dataset=None)
    assert how.given == {"page": 3, "scale": "dB", "pixel": PixelSize(0.006, 0.004)}
    for unit, mm in (("nm", 1e-6), ("um", 1e-3), ("µm", 1e-3), ("mm", 1.0), ("m", 1e3)):
        assert reading(pixel={"size": 6, "unit": unit}).pixel == PixelSize(6 * mm, 6 * mm)


def test_the_size_of_a_pixel_is_that_in_a_header_or_the_picture_is_refused(tmp_path):
    Image.fromarray(NOISE[0]).save(tmp_path / "a.png", dpi=(300, 300))
    tifffile.imwrite(tmp_path / "a.tif", NOISE[0], resolution=(300, 300), resolutionunit="INCH")
    imagej(tmp_path / "c.tif", unit="pixel")
    for path in sorted(tmp_path.iterdir()):
        assert "does not state the size of a pixel" in refusal(path, pixel=None)
    for unit in ("um", "micron", "\\u00B5m"):
        imagej(tmp_path / "a.tif", unit=unit)
        found = read(tmp_path / "a.tif", pixel=None)
        assert "pixel size 0.5 × 0.25 µm from the ImageJ header" in found.notes
    imagej(tmp_path / "a.tif", NOISE, axes="ZYX", unit="um", yunit="nm", zunit="mm", spacing=3.0)
    assert read_stack(tmp_path / "a.tif", reading()).voxel == pytest.approx((0.5e-3, 0.25e-6, 3.0), rel=1e-6)
    ome(tmp_path / "a.ome.tif", PhysicalSizeX=6.5, PhysicalSizeY=400.0, PhysicalSizeYUnit="nm")
    found = read(tmp_path / "a.ome.tif", pixel=None)
    assert found.pixel == pytest.approx((6.5e-3, 4e-4), rel=1e-12)
    assert "pixel size 6.5 × 0.4 µm from the OME header" in found.notes


def test_the_study_and_the_header_must_agree_and_the_index_divides_y_only(tmp_path):
    ome(tmp_path / "a.tif", PhysicalSizeX=6.0, PhysicalSizeY=4.0)
    found = read(tmp_path / "a.tif", pixel={"x": 6.05, "y": 4.0, "unit": "um"}, index=1.333)
    assert found.pixel == pytest.approx((6.05e-3, 4e-3 / 1.333), rel=1e-12)
    assert {"pixel size 6.05 × 4 µm from the study", "index 1.333 divides y"} <= set(found.notes)
    message = refusal(tmp_path / "a.tif", pixel={"x": 6.07, "y": 4.0, "unit": "um"})
    assert "the study and the file disagree: got 6.07 × 4 µm in the study, 6 × 4 µm" in message


def test_pages_of_every_stack(tmp_path):
    np.save(tmp_path / "a.npy", NOISE)
    imagej(tmp_path / "imagej.tif", NOISE, axes="ZYX")
    ome(tmp_path / "ome.tif", NOISE, axes="TYX")
    for path in sorted(tmp_path.iterdir()):
        for page in (None, 0, 4):
            found = read(path, page=page)
            np.testing.assert_array_equal(found.values, NOISE[page or 0])
            assert any(note.startswith(f"frame {page or 0} of 5") for note in found.notes)
        assert "has no such page: got 5; expected a page from 0 to 4" in refusal(path, page=5)
        mean = read(path, average=True)
        np.testing.assert_allclose(mean.values, NOISE.astype(float).mean(0), rtol=1e-14)
    with tifffile.TiffWriter(tmp_path / "two.tif") as two:
        two.write(NOISE[0])
        two.write(NOISE[1, :5])
    assert "the first of 2 series of pictures in the file" in read(tmp_path / "two.tif").notes


def test_a_stack_above_4_gb_has_one_page(tmp_path):
    """ImageJ describes the frames in the first page only; they follow one another in the file."""
    path, description = tmp_path / "a.tif", "ImageJ=1.54f\nimages=5\nslices=5\nunit=micron\nspacing=2.0\n"
    tifffile.imwrite(path, NOISE[0], metadata=None, description=description, resolution=(2, 4))
    path.write_bytes(path.read_bytes() + NOISE[1:].tobytes())
    for page in (0, 4):
        np.testing.assert_array_equal(read(path, pixel=None, page=page).values, NOISE[page])
    path.write_bytes(path.read_bytes()[:-10])
    refusal(path, pixel=None, page=4)


def test_several_files_are_frames_of_one_state(tmp_path):
    """They are averaged in intensity."""
    paths, how = saved_frames(tmp_path), reading(pixel=SQUARE)
    found = read_picture(paths, how)
    np.testing.assert_allclose(found.values, NOISE.astype(float).mean(0), rtol=1e-14)
    assert found.name == "0.npy and 4 more"
    digests = [hashlib.sha256(path.read_bytes()).digest() for path in paths]
    assert found.sha256 == hashlib.sha256(b"".join(digests)).hexdigest()
    assert read_picture(paths[:1], how).sha256 == read_picture(paths[0], how).sha256 == digests[0].hex()
    np.testing.assert_array_equal([frame.values for frame in read_frames(paths, how)], NOISE)
    for path, decibels in zip(paths[:2], (0.0, 20.0), strict=True):
        np.save(path, np.full((4, 4), decibels))
    np.testing.assert_allclose(read(paths[:2], scale="dB").values, 50.5, rtol=1e-14)
    a, b = tmp_path / "a.tif", tmp_path / "b.tif"
    ome(a, NOISE[0], PhysicalSizeX=2.0, PhysicalSizeY=2.0)
    ome(b, NOISE[1], PhysicalSizeX=2.0, PhysicalSizeY=2.1)
    for files, pixel, said in (
        (paths[1:3], SQUARE, r"2\.npy differs from 1\.npy: got Picture\(2\.npy, 30 × 20 pixels of 2 × 2 µm"),
        ([a, b, a], SQUARE, r"files of a picture: got a\.tif; expected .*each once"),
        ([], SQUARE, "files of a picture: got no file"),
        ([a, b], None, r"b\.tif differs from a\.tif"),
    ):
        with pytest.raises(InvalidInput, match=said):
            read(files, pixel=pixel)


def test_a_scale_is_undone_and_said(tmp_path):
    truth = RNG.uniform(0, 1, (20, 30))
    truth[3, 4] = 0.0
    with np.errstate(divide="ignore"):
        logarithm = np.log10(truth)
    coded = np.where(truth <= 0.0031308, 12.92 * truth, 1.055 * truth ** (1 / 2.4) - 0.055)
    stored = {"intensity": truth, "amplitude": np.sqrt(truth), "log10": logarithm, "dB": 10 * logarithm, "sRGB": coded}
    for scale, values in stored.items():
        np.save(tmp_path / "a.npy", values)
        found = read(tmp_path / "a.npy", scale=scale)
        np.testing.assert_allclose(found.values, truth, rtol=1e-9, atol=1e-12)
    for kind, full in ((np.uint8, 255), (np.uint16, 65535)):
        np.save(tmp_path / "a.npy", np.array([[0, full], [full // 5, full]], kind))
        found = read(tmp_path / "a.npy", scale="sRGB")
        np.testing.assert_allclose(found.values, [[0, 1], [0.0331048, 1]], atol=1e-6)
    display = np.arange(256, dtype=np.uint8).reshape(16, 16)
    for values, options, said in (
        (np.array([[0.0, 1.5]]), {"scale": "sRGB"}, "is not coded as sRGB: got 0 to 1.5"),
        (display, {"scale": "dB"}, "has no logarithms of intensities: got 0 to 255 dB"),
        (display.astype(float) - 9, {"scale": "amplitude"}, "has negative amplitudes: got -9.0"),
        (display, {"channel": "red"}, "has no colours: got channel: red"),
    ):
        np.save(tmp_path / "a.npy", values)
        assert said in refusal(tmp_path / "a.npy", **options)


def test_a_stack_in_one_file_and_in_several(tmp_path):
    imagej(tmp_path / "a.tif", NOISE, axes="ZYX", unit="um", spacing=3.0)
    found = read_stack(tmp_path / "a.tif", reading(index=1.5))
    np.testing.assert_array_equal(found.values, NOISE)
    assert found.voxel == pytest.approx((0.5e-3, 0.25e-3 / 1.5, 3e-3), rel=1e-6)
    assert found.notes[0] == "stack of 5 planes, 3 µm apart, from the ImageJ header"
    several = read_stack(saved_frames(tmp_path), reading(pixel=VOXEL))
    np.testing.assert_array_equal(several.values, NOISE)
    assert several.voxel == pytest.approx((2e-3, 2e-3, 7e-3))
    np.save(tmp_path / "many.npy", NOISE.reshape(5, 2, 10, 30))
    np.save(tmp_path / "a.npy", NOISE)
    imagej(tmp_path / "times.tif", NOISE, axes="TYX", unit="um", spacing=3.0)
    for name, options, said in (
        ("0.npy", {"pixel": VOXEL}, r"0\.npy holds no stack: got one plane"),
        ("many.npy", {"pixel": VOXEL}, r"many\.npy holds no stack: got axis 0 5, axis 1 2"),
        ("times.tif", {}, r"times\.tif holds no stack: got T 5"),
        ("a.npy", {"pixel": SQUARE}, r"a\.npy does not state z.*Add z to the size of a voxel"),
    ):
        with pytest.raises(InvalidInput, match=said):
            read_stack(tmp_path / name, reading(**options))
