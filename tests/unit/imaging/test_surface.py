"""Surfaces in rendered stacks: where they are, how well they know it, what is refused; and their thinning."""

import sys
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from tests.unit.discrepancy.surfaces import sphere
from verification.validation.rendered_stacks import Blob, Microscope

from strandline.foundations import InvalidInput
from strandline.imaging import Stack, StackFrame, StatedRegion, find_surface
from strandline.imaging.surfaces.mesh import Mesh, _noise, cut, thinned, two_levels
from strandline.imaging.surfaces.surface import _outside
from strandline.interface import Interface
from strandline.studies.keys.parse import made

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
def clean(name):
    blob, microscope = CASES[name]
    return microscope.clean(blob)


def stack(name):
    return CASES[name][1].with_noise(clean(name), np.random.default_rng(0)).values


def surface_of(values, voxel=CUBES.voxel, **options):
    return find_surface(Stack(values, voxel, "a", "0"), **{"solid": "bright", "triangles": 1500, **options})


@lru_cache
def found(name):
    microscope = CASES[name][1]
    return surface_of(stack(name), microscope.voxel, solid="bright" if microscope.bright else "dark")


def off(name, surface):
    """Return signed distances of the points from the truth, in sides of a voxel."""
    blob, microscope = CASES[name]
    return blob.distances(surface.mesh.points * microscope.voxel) / np.prod(microscope.voxel) ** (1 / 3)


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.mark.parametrize("name", CASES)
def test_the_surface_is_within_a_tenth_of_a_voxel_and_knows_its_errors(name):
    surface, side = found(name), np.prod(CASES[name][1].voxel) ** (1 / 3)
    wrong, errors = off(name, surface), surface.errors
    assert rms(wrong) < 0.1
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


def test_forgotten_anisotropy_and_uncorrected_blur_are_caught(monkeypatch):
    """The same check fails for a surface that takes its voxels for cubes of the same volume."""
    name = "voxels that are no cubes"
    mesh, side = found(name).mesh, float(np.prod(FLAT.voxel)) ** (1 / 3)
    for voxel, least, most in ((FLAT.voxel, 0.0, 0.1), ((side,) * 3, 1.0, 100.0)):
        points = StackFrame((0.0, 0.0, 0.0), voxel).interface(mesh).points
        assert least < rms(CASES[name][0].distances(points) / side) < most
    monkeypatch.setattr("strandline.imaging.surfaces.surface.dislocation", lambda operators, _: 0 * operators[:, 0, 0])
    assert off("sphere", surface_of(stack("sphere"))).mean() < -0.15


def test_larger_and_correlated_noise_are_seen():
    """Twice the noise is twice the sd, in the errors as in the truth."""
    usual = found("sphere").errors
    noisy = replace(CUBES, contrast_to_noise=5.0).with_noise(clean("sphere"), np.random.default_rng(4)).values
    smooth = gaussian_filter(np.random.default_rng(5).standard_normal(CUBES.shape), 1.5)
    larger = surface_of(noisy)
    longer = surface_of(clean("sphere") + 0.05 * smooth / smooth.std())
    for surface in (larger, longer):
        assert 0.7 < surface.errors.sd / V / off("sphere", surface).std() < 1.3
    assert larger.errors.contrast_to_noise == pytest.approx(5, rel=0.1)
    assert larger.errors.sd > 1.6 * usual.sd
    assert longer.errors.length > 1.3 * usual.length


def test_the_largest_part_is_taken_and_an_open_surface_is_said_to_be_open():
    blobs = np.maximum(clean("sphere"), 0)
    blobs[2:6, 2:6, 2:6] = 1.0
    surface = surface_of(CUBES.with_noise(blobs, np.random.default_rng(0)).values)
    assert rms(off("sphere", surface)) < 0.1
    assert 0.8 < surface.errors.area_share < 0.999
    half = surface_of(stack("sphere")[:28])
    assert 0.1 < half.errors.open_share < 0.5
    assert found("sphere").errors.open_share == 0
    assert rms(off("sphere", half)) < 0.12


def test_what_says_too_little_is_refused(monkeypatch):
    whole, noise = stack("sphere"), np.random.default_rng(1).standard_normal((24, 24, 24))
    for values, options, said in (
        (clean("sphere")[:24, :24, :24] + noise, {}, "contrast over noise"),
        (np.ones((8, 8, 8)), {}, "no voxel on one side"),
        (whole[18:30, 18:30, 14:40], {}, "cut off by the faces"),
        (np.pad(np.ones((1, 1, 1)), 6), {"smooth": 0.3}, "number of triangles"),
        (np.pad(np.ones((3, 3, 3)), 3), {}, "beside the surface"),
    ):
        with pytest.raises(InvalidInput, match=said):
            surface_of(values, **options)
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[image3d\]"'):
        surface_of(stack("sphere"))


def test_frames_keep_the_normals_out_of_the_solid_and_lead_back_to_the_voxels():
    """A point of the model appears at origin + S R m / voxel, R as an independent implementation makes it."""
    mesh = found("sphere").mesh
    for directions in ({}, {"y": "up"}, {"y": "up", "z": "first"}, {"x": "left"}, {"rotation": (20.0, -35.0, 110.0)}):
        placed = StackFrame((24.2, 23.5, 23.8), CUBES.voxel, **directions).interface(mesh)
        assert (placed.centres * placed.normals).sum(axis=1).min() > 0
        assert np.linalg.norm(placed.points, axis=1).mean() == pytest.approx(0.014, rel=0.01)
    frame = StackFrame((5.0, 6.0, 7.0), FLAT.voxel, y="up", rotation=(20.0, -35.0, 110.0))
    turn = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True)
    points = np.random.default_rng(4).standard_normal((10, 3))
    voxels = [5.0, 6.0, 7.0] + np.array([1.0, -1.0, 1.0]) * turn.apply(points) / FLAT.voxel
    np.testing.assert_allclose(frame.to_mm(voxels), points, atol=1e-12)


FRAME = StackFrame(tuple(one / V for one in CENTRE), CUBES.voxel, z="last")
BALL = {"ball": [0, 0, -14], "radius": 6, "unit": "um"}


def region(options):
    return made(StatedRegion, options, "exclude[0]").within(FRAME)


def test_a_region_is_left_out_with_all_that_it_does():
    """A bright lump on the sphere is gone, and what is left is as good, and knows it, as without the lump."""
    values = stack("sphere")
    values[8:13, 22:27, 22:27] = values.max()
    whole, part = (surface_of(values, exclude=regions) for regions in ([], [region(BALL)]))
    assert np.abs(off("sphere", whole)).max() > 1.0
    assert np.abs(off("sphere", part)).max() < 0.4
    assert len(part.mesh.cells) + part.left_out == len(whole.mesh.cells)
    assert part.left_out > 20
    assert part.errors.sd == pytest.approx(found("sphere").errors.sd, rel=0.1)
    assert part.errors.open_share == 0
    assert not FRAME.interface(part.mesh).closed


def test_the_places_of_regions():
    voxels = np.random.default_rng(6).uniform(0, 48, (400, 3))
    model = FRAME.to_mm(voxels) / V
    np.testing.assert_allclose(model, voxels - np.array(CENTRE) / V, atol=1e-9)
    in_box = (np.abs(model[:, :2]) <= 9).all(axis=1) & (model[:, 2] <= -9) & (model[:, 2] >= -20)
    for options, inside in (
        ({"box": [[9, 9, -9], [-9, -9, -20]], "unit": "um"}, in_box),
        ({**BALL, "ball": [1, 0, -10], "radius": 9}, np.linalg.norm(model - [1, 0, -10], axis=1) <= 9),
        ({"voxels": [[0, 0, 0], [48, 30, 14]]}, (voxels[:, 1] <= 30) & (voxels[:, 2] <= 14)),
    ):
        np.testing.assert_array_equal(region(options)(voxels), inside)
    for options, said in (
        ({"voxels": [[0, 0, 0], [1, 1, 1]], "unit": "um"}, "unit.*voxels"),
        ({"ball": [0, 0], "radius": 1, "unit": "um"}, r"exclude\[0\]\.ball"),
        ({**BALL, "radius": 0}, "a length above 0"),
    ):
        with pytest.raises(InvalidInput, match=said):
            region(options)
    everything = region({"voxels": [[0, 0, 0], [48, 48, 48]]})
    with pytest.raises(InvalidInput, match=r"triangles outside of the regions.*got 0.*at least 10"):
        surface_of(stack("sphere"), exclude=[everything])


BALL_MESH = Mesh(sphere(1.0, 4).points, sphere(1.0, 4).cells)


def test_a_thinned_sphere_stays_a_sphere_and_what_cannot_be_thinner_stays():
    thin = thinned(BALL_MESH, 400)
    assert 300 < len(thin.cells) <= 400
    surface = Interface(thin.points, thin.cells)
    assert surface.closed
    assert np.abs(np.linalg.norm(thin.points, axis=1) - 1).max() < 0.03
    outwards = (surface.centres * surface.normals).sum(axis=1)
    assert outwards.sum() / 3 == pytest.approx(4 * np.pi / 3, rel=0.03)
    assert outwards.min() > 0
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    assert len(thinned(Mesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])), 2).cells) == 4


def test_a_plane_cuts_a_sphere_in_a_circle():
    for axis in range(3):
        segments = cut(BALL_MESH, axis, 0.3)
        np.testing.assert_allclose(segments[:, :, axis], 0.3)
        np.testing.assert_allclose(np.linalg.norm(segments, axis=2), 1, atol=0.01)
        length = np.linalg.norm(segments[:, 0] - segments[:, 1], axis=1).sum()
        assert length == pytest.approx(2 * np.pi * np.sqrt(1 - 0.09), rel=0.01)


def test_the_noise_and_the_levels_of_a_stack():
    values = np.where(np.arange(40)[:, None, None] < 20, 1.0, 5.0) * np.ones((40, 40, 40))
    noisy = (values + 0.5 * np.random.default_rng(1).standard_normal(values.shape)).astype(np.float32)
    assert _noise(noisy) == pytest.approx(0.5, rel=0.05)
    assert two_levels(noisy) == pytest.approx((1.0, 5.0), abs=0.05)


def test_regions_are_in_voxels_whatever_their_shape():
    """Triangles at 0, 10, 20 … 190 along x, in voxels twice as long: those beyond the 50th are left out."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]) + np.arange(20)[:, None, None] * [10.0, 0, 0]
    mesh = Mesh(corners.reshape(-1, 3), np.arange(60).reshape(20, 3))
    used, _ = _outside(mesh, [lambda places: places[:, 0] > 50], np.array([2.0, 1.0, 1.0]))
    assert used.tolist() == list(range(30))
