"""Surfaces in rendered stacks: where they are, how well they know it, and what is refused."""

import builtins
import importlib
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from verification.validation.rendered_stacks import Blob, Microscope

from strandline.errors import InvalidInput
from strandline.imaging import Stack
from strandline.imaging.surfaces import StackFrame, Surface, find_surface, region_of

V = 1e-3
CENTRE = (0.0242, 0.0235, 0.0238)
CUBES = Microscope((V, V, V), (48, 48, 48), (1.5 * V,) * 3)
FLAT = Microscope((V, V, 2 * V), (29, 56, 56), (1.5 * V, 1.5 * V, 2 * V))
SPHERE, BUMPY = Blob(CENTRE, (0.014,) * 3), Blob(CENTRE, (0.016, 0.015, 0.014), bumps=0.06)
CASES = {
    "sphere": (SPHERE, CUBES),
    "ellipsoid": (Blob(CENTRE, (0.017, 0.014, 0.012)), CUBES),
    "bumpy": (BUMPY, CUBES),
    "voxels that are no cubes": (Blob((0.0275, 0.0278, 0.0285), (0.019, 0.018, 0.02), bumps=0.05), FLAT),
    "dark": (SPHERE, replace(CUBES, bright=False)),
}


@lru_cache(maxsize=8)
def clean(name: str) -> np.ndarray:
    blob, microscope = CASES[name]
    return microscope.clean(blob)


def stack(name: str, seed: int = 0) -> Stack:
    return CASES[name][1].with_noise(clean(name), np.random.default_rng(seed))


def found(name: str, seed: int = 0, **options: Any) -> Surface:
    solid = "bright" if CASES[name][1].bright else "dark"
    return find_surface(stack(name, seed), solid=solid, **{"triangles": 1500, **options})


def off(name: str, surface: Surface) -> np.ndarray:
    """Return signed distances of the points from the truth, in sides of a voxel."""
    blob, microscope = CASES[name]
    return blob.distances(surface.mesh.points * microscope.voxel) / np.prod(microscope.voxel) ** (1 / 3)


@pytest.mark.parametrize("name", CASES)
def test_the_surface_is_within_a_tenth_of_a_voxel(name: str) -> None:
    surface = found(name)
    wrong = off(name, surface)
    assert np.sqrt(np.mean(wrong**2)) < 0.1
    assert abs(wrong.mean()) < 0.07
    assert len(surface.mesh.cells) <= 1500
    placed = StackFrame((0.0, 0.0, 0.0), CASES[name][1].voxel).interface(surface.mesh)
    assert placed.closed
    assert ((placed.centres - CENTRE) * placed.normals).sum() > 0


@pytest.mark.parametrize("name", ["sphere", "voxels that are no cubes"])
def test_its_own_errors_are_right(name: str) -> None:
    side = np.prod(CASES[name][1].voxel) ** (1 / 3)
    for seed in range(3):
        surface = found(name, seed)
        wrong, errors = off(name, surface), surface.errors
        assert 0.7 < errors.sd / side / wrong.std() < 1.3
        assert abs(wrong.mean()) < 2 * errors.offset / side
        assert 0.1 * side < errors.offset < 0.2 * side
        assert errors.contrast_to_noise == pytest.approx(10, rel=0.1)
        assert errors.blur / side == pytest.approx(1.5, rel=0.15)
        assert 1.0 < errors.length / side < 2.5


def test_forgotten_anisotropy_is_caught() -> None:
    """The same check fails for a surface that takes its voxels for cubes of the same volume."""
    name = "voxels that are no cubes"
    mesh, side = found(name).mesh, float(np.prod(FLAT.voxel)) ** (1 / 3)
    for voxel, least, most in ((FLAT.voxel, 0.0, 0.1), ((side,) * 3, 1.0, 100.0)):
        points = StackFrame((0.0, 0.0, 0.0), voxel).interface(mesh).points
        assert least < np.sqrt(np.mean((CASES[name][0].distances(points) / side) ** 2)) < most


def test_uncorrected_blur_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.imaging.surfaces.surface.dislocation", lambda operators, _: 0 * operators[:, 0, 0])
    assert off("sphere", found("sphere")).mean() < -0.15


def test_noise_is_seen_where_it_is() -> None:
    """Twice the noise is twice the sd, in the errors as in the truth."""
    noisy = replace(CUBES, contrast_to_noise=5.0).with_noise(clean("sphere"), np.random.default_rng(4))
    surface = find_surface(noisy, solid="bright", triangles=1500)
    assert surface.errors.contrast_to_noise == pytest.approx(5, rel=0.1)
    assert 0.7 < surface.errors.sd / V / off("sphere", surface).std() < 1.3
    assert surface.errors.sd > 1.6 * found("sphere").errors.sd


def test_correlated_noise_is_longer() -> None:
    from scipy.ndimage import gaussian_filter

    white = np.random.default_rng(5).standard_normal(CUBES.shape)
    smooth = gaussian_filter(white, 1.5)
    one = Stack(clean("sphere") + 0.05 * smooth / smooth.std(), CUBES.voxel, "a", "0")
    surface = find_surface(one, solid="bright", triangles=1500)
    assert surface.errors.length > 1.3 * found("sphere").errors.length
    assert 0.7 < surface.errors.sd / V / off("sphere", surface).std() < 1.3


def test_the_largest_part_is_taken_and_an_open_surface_is_said_to_be_open() -> None:
    blobs = np.maximum(clean("sphere"), 0)
    blobs[2:6, 2:6, 2:6] = 1.0
    surface = find_surface(CUBES.with_noise(blobs, np.random.default_rng(0)), solid="bright", triangles=1500)
    assert np.sqrt(np.mean(off("sphere", surface) ** 2)) < 0.1
    assert 0.8 < surface.errors.area_share < 0.999
    half = stack("sphere").values[:28]
    cut = find_surface(Stack(half, CUBES.voxel, "a", "0"), solid="bright", triangles=1500)
    assert 0.1 < cut.errors.open_share < 0.5
    assert found("sphere").errors.open_share == 0
    assert np.sqrt(np.mean(off("sphere", cut) ** 2)) < 0.12


def of(values: np.ndarray) -> Stack:
    return Stack(values, CUBES.voxel, "a", "0")


@pytest.mark.parametrize(
    ("values", "options", "said"),
    [
        (lambda: clean("sphere") + np.random.default_rng(1).standard_normal(CUBES.shape), {}, "contrast over noise"),
        (lambda: np.ones((8, 8, 8)), {}, "no voxel on one side"),
        (lambda: stack("sphere").values[18:30, 18:30, 14:40], {}, "cut off by the faces"),
        (lambda: np.pad(np.ones((1, 1, 1)), 6), {"smooth": 0.3}, "number of triangles"),
        (lambda: np.pad(np.ones((3, 3, 3)), 3), {}, "beside the surface"),
        (lambda: stack("sphere").values, {"triangles": 99}, "most triangles"),
        (lambda: stack("sphere").values, {"solid": "grey"}, "side of the solid"),
    ],
)
def test_what_says_too_little_is_refused(values: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        find_surface(of(values()), **{"solid": "bright", **options})


def test_a_missing_extra_names_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        if name.startswith("skimage"):
            raise ModuleNotFoundError(name)
        return builtins.__import__(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[image3d\]"'):
        found("sphere")


def test_frames_keep_the_normals_out_of_the_solid() -> None:
    mesh = found("sphere").mesh
    for directions in ({}, {"y": "up"}, {"y": "up", "z": "first"}, {"x": "left"}):
        frame = StackFrame((24.2, 23.5, 23.8), CUBES.voxel, **directions)
        placed = frame.interface(mesh)
        assert (placed.centres * placed.normals).sum() > 0
        assert np.linalg.norm(placed.points, axis=1).mean() == pytest.approx(0.014, rel=0.01)
    up = StackFrame((0.0, 0.0, 0.0), CUBES.voxel, y="up").interface(mesh).points
    np.testing.assert_allclose(up, mesh.points * V * [1, -1, 1])
    with pytest.raises(InvalidInput, match=r"frame\.y"):
        StackFrame((0.0, 0.0, 0.0), CUBES.voxel, y="back")


def test_a_frame_that_is_turned_leads_back_to_the_voxels() -> None:
    """A point of the model appears at origin + S R m / voxel, R as an independent implementation makes it."""
    voxel, signs = np.array(FLAT.voxel), np.array([1.0, -1.0, 1.0])
    frame = StackFrame((5.0, 6.0, 7.0), FLAT.voxel, y="up", rotation=(20.0, -35.0, 110.0))
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True)
    points = np.random.default_rng(4).standard_normal((10, 3))
    np.testing.assert_allclose(frame.to_mm([5.0, 6.0, 7.0] + signs * turn.apply(points) / voxel), points, atol=1e-12)
    surface = frame.interface(found("sphere").mesh)
    assert (surface.normals * (surface.centres - surface.points.mean(axis=0))).sum(axis=1).min() > 0


@pytest.mark.parametrize(
    "region",
    [
        {"ball": [0, 0, -14], "radius": 6, "unit": "um"},
        {"box": [[9, 9, -9], [-9, -9, -20]], "unit": "um"},
        {"voxels": [[0, 0, 0], [48, 48, 14]]},
    ],
)
def test_a_region_is_left_out_with_all_that_it_does(region: dict[str, Any]) -> None:
    """A bright lump on the sphere is gone, and what is left is as good, and knows it, as without the lump."""
    values = stack("sphere").values.copy()
    values[8:13, 22:27, 22:27] = values.max()
    voxels = tuple(float(one / V) for one in CENTRE)
    frame = StackFrame(voxels, CUBES.voxel, z="last")  # type: ignore[arg-type]
    with_lump = Stack(values, CUBES.voxel, "lump", "0")
    whole = find_surface(with_lump, solid="bright", triangles=1500)
    cut = find_surface(with_lump, solid="bright", triangles=1500, exclude=[region_of(region, "exclude[0]", frame)])
    assert np.abs(off("sphere", whole)).max() > 1.0
    assert np.abs(off("sphere", cut)).max() < 0.4
    assert len(cut.mesh.cells) + cut.left_out == len(whole.mesh.cells)
    assert cut.left_out > 20
    assert cut.errors.sd == pytest.approx(found("sphere").errors.sd, rel=0.1)
    assert cut.errors.open_share == 0
    assert not frame.interface(cut.mesh).closed


@pytest.mark.parametrize(
    ("region", "said"),
    [
        ({"voxels": [[0, 0, 0], [48, 48, 48]]}, "triangles outside of the regions.*got 0.*at least 10"),
        ({"voxels": [[0, 0, 0]]}, r"exclude\[0\]\.voxels"),
        ({"voxels": [[0, 0, 0], [1, 1, 1]], "unit": "um"}, "voxels.*unit"),
        ({"box": [[0, 0, 0], [1, 1, 1]]}, "exclude"),
        ({"ball": [0, 0], "radius": 1, "unit": "um"}, r"exclude\[0\]\.ball"),
        ({"ball": [0, 0, 0], "radius": 0, "unit": "um"}, r"exclude\[0\]\.radius"),
        ({"ball": [0, 0, 0], "radius": 1, "unit": "yard"}, r"exclude\[0\]\.unit"),
        ({"blob": [0, 0, 0]}, "unknown option"),
        ([[0, 0, 0], [1, 1, 1]], r"exclude\[0\]"),
    ],
)
def test_a_region_that_cannot_be_used_is_one_line(region: Any, said: str) -> None:
    frame = StackFrame((0.0, 0.0, 0.0), CUBES.voxel)
    with pytest.raises(InvalidInput, match=said) as error:
        find_surface(stack("sphere"), solid="bright", exclude=[region_of(region, "exclude[0]", frame)])
    assert "\n" not in str(error.value)
