"""Surfaces in rendered stacks: where they are, how well they know it, and what is refused."""

import builtins
import importlib
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from verification.validation.rendered_stacks import Blob, Microscope

from strandline.errors import InvalidInput
from strandline.imaging import Stack
from strandline.imaging.surfaces import StackFrame, Surface, find_surface, region_of

V = 1e-3
CENTRE = (0.0242, 0.0235, 0.0238)
CUBES = Microscope((V, V, V), (48, 48, 48), (1.5 * V,) * 3)
FLAT = Microscope((V, V, 2 * V), (29, 56, 56), (1.5 * V, 1.5 * V, 2 * V))
SPHERE = Blob(CENTRE, (0.014,) * 3)
CASES = {
    "sphere": (SPHERE, CUBES),
    "bumpy": (Blob(CENTRE, (0.017, 0.015, 0.013), bumps=0.06), CUBES),
    "voxels that are no cubes": (Blob((0.0275, 0.0278, 0.0285), (0.019, 0.018, 0.02), bumps=0.05), FLAT),
    "dark": (SPHERE, replace(CUBES, bright=False)),
}


@lru_cache
def clean(name: str) -> np.ndarray:
    blob, microscope = CASES[name]
    return microscope.clean(blob)


def stack(name: str, seed: int = 0) -> Stack:
    return CASES[name][1].with_noise(clean(name), np.random.default_rng(seed))


def of(values: np.ndarray) -> Stack:
    return Stack(values, CUBES.voxel, "a", "0")


def surface_of(one: Stack, *, solid: str = "bright", **options: Any) -> Surface:
    return find_surface(one, solid=solid, **{"triangles": 1500, **options})


@lru_cache
def found(name: str, seed: int = 0) -> Surface:
    return surface_of(stack(name, seed), solid="bright" if CASES[name][1].bright else "dark")


def off(name: str, surface: Surface) -> np.ndarray:
    """Return signed distances of the points from the truth, in sides of a voxel."""
    blob, microscope = CASES[name]
    return blob.distances(surface.mesh.points * microscope.voxel) / np.prod(microscope.voxel) ** (1 / 3)


@pytest.mark.parametrize("name", CASES)
def test_the_surface_is_within_a_tenth_of_a_voxel_and_knows_its_errors(name: str) -> None:
    surface, side = found(name), np.prod(CASES[name][1].voxel) ** (1 / 3)
    wrong, errors = off(name, surface), surface.errors
    assert np.sqrt(np.mean(wrong**2)) < 0.1
    assert abs(wrong.mean()) < 0.07
    assert len(surface.mesh.cells) <= 1500
    placed = StackFrame((0.0, 0.0, 0.0), CASES[name][1].voxel).interface(surface.mesh)
    assert placed.closed
    assert ((placed.centres - CENTRE) * placed.normals).sum() > 0
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
    assert off("sphere", surface_of(stack("sphere"))).mean() < -0.15


def test_larger_and_correlated_noise_are_seen() -> None:
    """Twice the noise is twice the sd, in the errors as in the truth."""
    usual = found("sphere").errors
    noisy = replace(CUBES, contrast_to_noise=5.0).with_noise(clean("sphere"), np.random.default_rng(4))
    smooth = gaussian_filter(np.random.default_rng(5).standard_normal(CUBES.shape), 1.5)
    larger = surface_of(noisy)
    longer = surface_of(of(clean("sphere") + 0.05 * smooth / smooth.std()))
    for surface in (larger, longer):
        assert 0.7 < surface.errors.sd / V / off("sphere", surface).std() < 1.3
    assert larger.errors.contrast_to_noise == pytest.approx(5, rel=0.1)
    assert larger.errors.sd > 1.6 * usual.sd
    assert longer.errors.length > 1.3 * usual.length


def test_the_largest_part_is_taken_and_an_open_surface_is_said_to_be_open() -> None:
    blobs = np.maximum(clean("sphere"), 0)
    blobs[2:6, 2:6, 2:6] = 1.0
    surface = surface_of(CUBES.with_noise(blobs, np.random.default_rng(0)))
    assert np.sqrt(np.mean(off("sphere", surface) ** 2)) < 0.1
    assert 0.8 < surface.errors.area_share < 0.999
    cut = surface_of(of(stack("sphere").values[:28]))
    assert 0.1 < cut.errors.open_share < 0.5
    assert found("sphere").errors.open_share == 0
    assert np.sqrt(np.mean(off("sphere", cut) ** 2)) < 0.12


def test_what_says_too_little_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, noise = stack("sphere").values, np.random.default_rng(1).standard_normal((24, 24, 24))
    for values, options, said in (
        (clean("sphere")[:24, :24, :24] + noise, {}, "contrast over noise"),
        (np.ones((8, 8, 8)), {}, "no voxel on one side"),
        (whole[18:30, 18:30, 14:40], {}, "cut off by the faces"),
        (np.pad(np.ones((1, 1, 1)), 6), {"smooth": 0.3}, "number of triangles"),
        (np.pad(np.ones((3, 3, 3)), 3), {}, "beside the surface"),
        (whole, {"triangles": 99}, "most triangles"),
        (whole, {"solid": "grey"}, "side of the solid"),
    ):
        with pytest.raises(InvalidInput, match=said):
            find_surface(of(values), **{"solid": "bright", **options})

    def missing(name: str) -> Any:
        if name.startswith("skimage"):
            raise ModuleNotFoundError(name)
        return builtins.__import__(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[image3d\]"'):
        surface_of(stack("sphere"))


def test_frames_keep_the_normals_out_of_the_solid() -> None:
    mesh = found("sphere").mesh
    for directions in ({}, {"y": "up"}, {"y": "up", "z": "first"}, {"x": "left"}):
        placed = StackFrame((24.2, 23.5, 23.8), CUBES.voxel, **directions).interface(mesh)
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


FRAME = StackFrame(tuple(one / V for one in CENTRE), CUBES.voxel, z="last")
BALL = {"ball": [0, 0, -14], "radius": 6, "unit": "um"}


def test_a_region_is_left_out_with_all_that_it_does() -> None:
    """A bright lump on the sphere is gone, and what is left is as good, and knows it, as without the lump."""
    values = stack("sphere").values.copy()
    values[8:13, 22:27, 22:27] = values.max()
    whole = surface_of(of(values))
    cut = surface_of(of(values), exclude=[region_of(BALL, "exclude[0]", FRAME)])
    assert np.abs(off("sphere", whole)).max() > 1.0
    assert np.abs(off("sphere", cut)).max() < 0.4
    assert len(cut.mesh.cells) + cut.left_out == len(whole.mesh.cells)
    assert cut.left_out > 20
    assert cut.errors.sd == pytest.approx(found("sphere").errors.sd, rel=0.1)
    assert cut.errors.open_share == 0
    assert not FRAME.interface(cut.mesh).closed


def test_the_places_of_regions() -> None:
    voxels = np.random.default_rng(6).uniform(0, 48, (400, 3))
    away = (voxels - np.array(CENTRE) / V) * [1, 1, 1]
    box, ball, in_voxels = (
        region_of(region, "exclude[0]", FRAME)
        for region in (
            {"box": [[9, 9, -9], [-9, -9, -20]], "unit": "um"},
            {**BALL, "ball": [1, 0, -10], "radius": 9},
            {"voxels": [[0, 0, 0], [48, 30, 14]]},
        )
    )
    model = FRAME.to_mm(voxels) / V
    np.testing.assert_allclose(np.abs(model), np.abs(away), atol=1e-9)
    inside = (np.abs(model[:, :2]) <= 9).all(axis=1) & (model[:, 2] <= -9) & (model[:, 2] >= -20)
    np.testing.assert_array_equal(box(voxels), inside)
    np.testing.assert_array_equal(ball(voxels), np.linalg.norm(model - [1, 0, -10], axis=1) <= 9)
    np.testing.assert_array_equal(in_voxels(voxels), (voxels[:, 1] <= 30) & (voxels[:, 2] <= 14))


REGIONS: list[tuple[Any, str]] = [
    ({"voxels": [[0, 0, 0]]}, r"exclude\[0\]\.voxels"),
    ({"voxels": [[0, 0, 0], [1, 1, 1]], "unit": "um"}, "voxels.*unit"),
    ({"box": [[0, 0, 0], [1, 1, 1]]}, "exclude"),
    ({"ball": [0, 0], "radius": 1, "unit": "um"}, r"exclude\[0\]\.ball"),
    ({"ball": [0, 0, 0], "radius": 0, "unit": "um"}, r"exclude\[0\]\.radius"),
    ({"ball": [0, 0, 0], "radius": 1, "unit": "yard"}, r"exclude\[0\]\.unit"),
    ({"blob": [0, 0, 0]}, "unknown option"),
    ([[0, 0, 0], [1, 1, 1]], r"exclude\[0\]"),
]


def test_a_region_that_cannot_be_used_is_one_line() -> None:
    for region, said in REGIONS:
        with pytest.raises(InvalidInput, match=said) as error:
            region_of(region, "exclude[0]", FRAME)
        assert "\n" not in str(error.value)
    everything = region_of({"voxels": [[0, 0, 0], [48, 48, 48]]}, "exclude[0]", FRAME)
    with pytest.raises(InvalidInput, match=r"triangles outside of the regions.*got 0.*at least 10"):
        surface_of(stack("sphere"), exclude=[everything])
