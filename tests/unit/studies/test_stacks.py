"""Stacks, and two pictures of one specimen, as the observation of a study: surface or outline, errors, bad input."""

import json
import shutil
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from tests.unit.studies.test_refusals import not_refused
from verification.validation.rendered_stacks import Blob, Microscope

import strandline as sl
from strandline.cli import main
from strandline.interface import GaussianNoise, Interface, PointErrors
from strandline.readers import Reading, read_interface
from strandline.studies import load_study
from strandline.studies.keys.observation import StackFile
from strandline.studies.load.observed import Scanned
from strandline.studies.load.photographed import with_errors_of
from strandline.studies.write.shown import read_how, write_pictures
from strandline.testing.studies import BEAM_STUDY, write_study

V, RADIUS = 1e-3, 0.014
ORIGIN = [20.2, 19.5, 19.8]
CUBES = Microscope((V, V, V), (40,) * 3, (1.5 * V,) * 3)
STATED = {"frame": {"origin": ORIGIN}, "voxel": {"x": 1, "y": 1, "z": 1, "unit": "um"}}


@lru_cache(maxsize=1)
def grey():
    stack = CUBES(Blob((0.0202, 0.0195, 0.0198), (RADIUS,) * 3), np.random.default_rng(1)).values
    return np.clip(np.round(1000 + 1000 * stack), 0, 65535).astype(np.uint16)


def written(folder, *, noise=None, study=None, **changes):
    folder.mkdir(exist_ok=True)
    np.save(folder / "cells.npy", grey())
    stack = {"file": "cells.npy", **STATED, "solid": "bright", "triangles": 800, **changes}
    stack = {key: value for key, value in stack.items() if value is not None}
    base = {"discrepancy": {"closest_point": {}}, "noise": noise or {"sd": "image", "unit": "um"}, **(study or {})}
    return write_study(folder, observation={"stack": stack}, **base)


def loaded(folder, **changes):
    return load_study(written(folder, **changes))


def test_the_noise_is_that_of_the_stack(tmp_path):
    study = loaded(tmp_path)
    surface, noise = study.observed[""], study.noise_of("")
    away = np.linalg.norm(surface.points, axis=1) - RADIUS
    assert np.sqrt(np.mean(away**2)) < 0.1 * V
    assert 0.7 < noise.sd / away.std() < 1.3
    assert noise.offset >= 0.1 * V
    assert noise.length > V
    np.save(tmp_path / "half.npy", grey()[:22])
    cut = loaded(tmp_path, file="half.npy")
    assert (surface.closed, cut.observed[""].closed) == (True, False)
    assert "the surface is open" in " ".join(cut.stacks[""].notes)


REFUSED = """
reader: nowhere:read; index: 0; frame: {origin: [1, 2]}; frame: {origin: [1, 2, 3], rotation: 3}
voxel: GONE | does not state the size of a voxel
exclude: [{voxels: [[0, 0, 0], [39, 39, 39]]}] | at least 10
file: nothing.npy | nothing.npy
file: noise.npy | contrast over noise
"""
OF_STUDY = """
noise: {sd: 2, unit: um} | noise.unknown.offset
noise: {sd: image, unit: um, length: 3} | noise.sd
"""


def test_bad_input_is_one_line(tmp_path):
    np.save(tmp_path / "noise.npy", np.random.default_rng(2).standard_normal((20, 20, 20)))
    content = json.loads((written(tmp_path) / "study.yaml").read_text())
    assert not_refused(tmp_path, REFUSED, "observation.stack.", **content) == []
    assert not_refused(tmp_path, OF_STUDY, **content) == []


def test_what_the_command_writes_is_the_same_each_time(tmp_path, capsys):
    folder = written(tmp_path)
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    files = {path.name: path.read_bytes() for path in (folder / "image").iterdir()}
    assert sorted(files) == ["surface.json", "surface.png", "surface.vtu"]
    for words in ("stack of 40 planes, 1 µm apart, from the study", "at voxel (20.2, 19.5, 19.8) from the study"):
        assert words in shown
    study = load_study(folder)
    how = Reading("surface.vtu", "mm")
    read = read_interface(folder / "image" / "surface.vtu", how)
    np.testing.assert_allclose(read.points, study.observed[""].points, rtol=1e-6, atol=1e-10)
    content = json.loads(files["surface.json"])
    (how_read,) = read_how(study)
    assert (how_read["file"], how_read["notes"]) == ("cells.npy", content["notes"])
    assert content["sd"] == pytest.approx(study.stacks[""].errors.sd)
    assert next(iter(content["noise_variance"])).startswith("closest_point, direction to_simulated")
    write_pictures(study)
    assert {path.name: path.read_bytes() for path in (folder / "image").iterdir()} == files


def test_a_region_in_coordinates_of_the_model_turns_with_its_frame(tmp_path):
    """The model's x axis runs along the rows of the stack, so the same ball is another place."""
    turned = {"origin": ORIGIN, "rotation": [0, 0, 90]}
    study = loaded(tmp_path, frame=turned, exclude=[{"ball": [RADIUS, 0, 0], "radius": 0.005, "unit": "mm"}])
    points = study.observed[""].points
    assert np.linalg.norm(points - [RADIUS, 0, 0], axis=1).min() > 0.005
    assert np.linalg.norm(points - [0, RADIUS, 0], axis=1).min() < 0.002
    assert "triangles in excluded regions left out" in " ".join(study.stacks[""].notes)


EXAMPLE = Path(__file__).parents[3] / "examples" / "oct-biofilm"
SEEN = Interface.polyline(np.stack([np.linspace(0, 1, 101), np.zeros(101)], axis=1))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("oct") / "study"
    folder.mkdir()
    for name in ("study.yaml", "undeformed.png", "deformed.png"):
        shutil.copy(EXAMPLE / name, folder)
    return load_study(folder)


def test_the_model_takes_the_outline_where_the_flow_cell_moved(study):
    found, true = study.undeformed, np.asarray(sl.Biofilm().undeformed().points)
    model = np.asarray(study.model.undeformed().points)
    assert model.shape == true.shape
    assert np.linalg.norm(model - true, axis=1).max() < 0.03
    inner = Interface.polyline(found.outline.points[20:-20])
    fine = np.stack([np.interp(np.linspace(0, 65, 6000), np.arange(66), column) for column in true.T], axis=1)
    away = np.linalg.norm(inner.points[:, None] - fine[None], axis=2).min(axis=1)
    assert np.sqrt(np.mean(away**2)) < 3 * np.hypot(found.errors.sd, found.errors.offset)
    # The registration finds how the flow cell moved.
    found = study.pictures[""].registration
    c, s = np.cos(np.radians(0.3)), np.sin(np.radians(0.3))
    away = np.array(found.centre) - [-105.0, 205.0]
    true = away @ np.array([[c, s], [-s, c]]) + [4.3, -2.1] - away
    assert np.abs(np.array(found.shift) - true).max() < 3 * found.shift_sd < 6
    assert abs(found.rotation - 0.3) < 3 * found.rotation_sd < 0.5


def test_its_errors_join_those_of_the_observation(study):
    noise, own, edge = study.noise_of(""), study.undeformed.errors, study.pictures[""].errors
    assert noise.sd == pytest.approx(np.hypot(own.sd, edge.sd))
    assert noise.sd**2 * noise.length == pytest.approx(own.sd**2 * own.length + edge.sd**2 * edge.length)
    assert noise.offset == pytest.approx(np.hypot(own.offset, edge.offset))
    assert (noise.shift, noise.rotation, noise.scale) == pytest.approx((edge.shift, edge.rotation, 0.005))
    # Each condition takes its share; white points that are 10 µm apart count as correlated over half of that.
    given = PointErrors(0.002, 0.0, offset=0.001)
    one, three = (with_errors_of(study.undeformed, given, SEEN, conditions=n) for n in (1, 3))
    assert one.sd**2 * one.length == pytest.approx(given.sd**2 * 0.005 + own.sd**2 * own.length)
    assert three.sd**2 - given.sd**2 == pytest.approx(3 * own.sd**2)
    assert three.offset == pytest.approx(np.sqrt(0.001**2 + 3 * own.offset**2))
    stated = GaussianNoise(1e-4)
    assert with_errors_of(study.undeformed, stated, SEEN, conditions=1) is stated


def test_the_command_writes_both_pictures_and_how_they_were_read(study, capsys):
    first, second = read_how(study)
    assert (first["condition"], first["file"], second["file"]) == ("undeformed", "undeformed.png", "deformed.png")
    assert second["notes"][-2].startswith("in undeformed.png, the model's (0, 0) at pixel (-105, 205) from the study")
    main(["image", str(study.folder)])
    assert "undeformed: undeformed.png: edge of" in capsys.readouterr().out
    written = {path.name for path in (study.folder / "image").iterdir()}
    assert {"edge.csv", "edge.png", "undeformed-edge.png", "undeformed-outline.csv"} <= written
    assert json.loads((study.folder / "image" / "edge.json").read_text())["registration"] is not None
    outline = np.loadtxt(study.folder / "image" / "undeformed-outline.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(outline, study.undeformed.outline.points, atol=1e-6)


OUTLINE = """
pixel: GONE | pixel
solid: GONE; colour: red
path: [[89, 100], [166, 50], [247, 58], [310, 126]] | undeformed outline in the picture
"""
REGISTRATION = """
fixed: [[[2, 2], [6, 2], [6, 6]]] | fixed regions of the picture
fixed: [[[2, 2], [100, 2], [100, 30], [2, 30]]] | correlation
"""


def test_bad_input_of_two_pictures_is_one_line(study, tmp_path):
    shutil.copytree(study.folder, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("image", "*.html"))
    content = {**dict.fromkeys(BEAM_STUDY), **yaml.safe_load((EXAMPLE / "study.yaml").read_text("utf-8"))}
    assert not_refused(tmp_path, OUTLINE, "model.biofilm.outline.image.", **content) == []
    assert not_refused(tmp_path, REGISTRATION, "observation.image.registration.", **content) == []
    assert not_refused(tmp_path, "noise.unknown: {scale: 0.005, shared: true}", **content) == []


def test_one_file_or_several_of_a_stack():
    for file, files in (("a.tif", ["a.tif"]), (["a.tif", "b.tif"], ["a.tif", "b.tif"])):
        assert StackFile.model_construct(file=file).files == files


def test_a_single_surface_is_not_said_to_be_the_largest():
    for share, said in ((1.0, ()), (0.9, ("the largest of several surfaces, 90 % of their area",))):
        errors = SimpleNamespace(open_share=0.0, area_share=share)
        surface = SimpleNamespace(errors=errors, left_out=0)
        assert Scanned.notes.fget(SimpleNamespace(surface=surface, stack=SimpleNamespace(notes=()), placed="")) == said
