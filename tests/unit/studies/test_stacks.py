"""A stack of pictures as the observation of a study: the surface, its errors, and every bad input."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from tests.unit.imaging.files import scan
from tests.unit.studies.refused import message_of
from tests.unit.studies.scans import ORIGIN, RADIUS, V, grey, loaded, written

from strandline.cli import main
from strandline.interface import PointErrors
from strandline.readers import Reading, read_interface
from strandline.studies import load_study
from strandline.studies.pictures.stack_files import write_stacks
from strandline.studies.read_how import read_how
from strandline.testing.studies import write_study


def test_the_noise_is_that_of_the_stack(tmp_path: Path) -> None:
    study = loaded(tmp_path)
    surface, noise = study.observed[""], study.noise_of("")
    away = np.linalg.norm(surface.points, axis=1) - RADIUS
    assert np.sqrt(np.mean(away**2)) < 0.1 * V
    assert isinstance(noise, PointErrors)
    assert 0.7 < noise.sd / away.std() < 1.3
    assert noise.offset >= 0.1 * V
    assert noise.length > V
    stated = loaded(tmp_path, noise={"sd": "image", "unit": "um", "unknown": {"offset": 7, "shift": 2}}).noise_of("")
    assert isinstance(stated, PointErrors)
    assert (stated.offset, stated.shift) == pytest.approx((0.007, 0.002))


def test_the_header_states_the_size_of_a_voxel(tmp_path: Path) -> None:
    typed = loaded(tmp_path)
    metadata = {"axes": "ZYX", "unit": "um", "spacing": 1.0}
    tifffile.imwrite(tmp_path / "cells.tif", grey(), imagej=True, resolution=(1.0, 1.0), metadata=metadata)
    header = loaded(tmp_path, file="cells.tif", voxel=None)
    np.testing.assert_allclose(header.observed[""].points, typed.observed[""].points)
    assert "from the ImageJ header" in " ".join(header.stacks[""].notes)
    assert "from the study" in " ".join(typed.stacks[""].notes)


OCT = (
    "<Ocity><Image><SizePixel><SizeZ>40</SizeZ><SizeX>40</SizeX><SizeY>40</SizeY></SizePixel><SizeReal><SizeZ>0.0532"
    "</SizeZ><SizeX>0.04</SizeX><SizeY>0.04</SizeY></SizeReal></Image><Acquisition><RefractiveIndex>1.33"
    "</RefractiveIndex></Acquisition></Ocity>"
)
"""Header of a volume whose depths are optical paths: 1.33 times as long."""


def test_a_volume_that_states_an_index_takes_the_one_that_the_message_asks_for(tmp_path: Path) -> None:
    scan(tmp_path / "cells.oct", grey(), header=OCT)
    volume = {"file": "cells.oct", "voxel": None, "scale": "intensity"}
    message = message_of(written(tmp_path, **volume))
    assert "states a refractive index" in message
    assert "Add `index: 1.33`" in message
    found = loaded(tmp_path, **volume, index=1.33)
    assert found.stacks[""].stack.voxel == pytest.approx((V, V, V))
    np.testing.assert_allclose(found.observed[""].points, loaded(tmp_path).observed[""].points, atol=1e-6)
    assert "index 1.33 divides y" in found.stacks[""].notes


REFUSED: list[tuple[dict[str, Any], dict[str, Any] | None, str]] = [
    ({"reader": "nowhere:read"}, None, "observation.stack.reader"),
    ({"index": 0}, None, "observation.stack.index"),
    ({"voxel": None}, None, "does not state the size of a voxel"),
    ({"voxel": {"x": 1, "y": 1, "unit": "um"}}, None, "does not state z"),
    ({"voxel": {"size": 1, "unit": "um"}}, None, "observation.stack.voxel"),
    ({"voxel": {"x": 1, "y": 1, "z": 1}}, None, "observation.stack.voxel.unit"),
    ({"frame": None}, None, "observation.stack.frame.origin"),
    ({"frame": {"origin": [1, 2]}}, None, "observation.stack.frame.origin"),
    ({"frame": {"origin": [1, 2, 3], "rotation": 3}}, None, "observation.stack.frame.rotation"),
    ({"exclude": [{"voxels": [[0, 0, 0]]}]}, None, "observation.stack.exclude[0].voxels"),
    ({"exclude": [{"voxels": [[0, 0, 0], [39, 39, 39]]}]}, None, "at least 10"),
    ({"file": "nothing.npy"}, None, "nothing.npy"),
    ({"file": "page.npy"}, None, "holds no stack"),
    ({"file": "noise.npy"}, None, "contrast over noise"),
    ({"solid": "grey"}, None, "solid"),
    ({"triangles": 50}, None, "triangles"),
    ({"page": 3}, None, "page"),
    ({}, {"sd": 2, "unit": "um"}, "noise.unknown.offset"),
    ({}, {"sd": "image", "unit": "um", "length": 3}, "noise.sd"),
]


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    np.save(tmp_path / "page.npy", grey()[20])
    np.save(tmp_path / "noise.npy", np.random.default_rng(2).standard_normal((20, 20, 20)))
    for changes, noise, words in REFUSED:
        message = message_of(written(tmp_path, noise=noise, **changes))
        assert words in message, message
    both = {"stack": {"file": "a.npy", "solid": "bright"}, "file": "b"}
    assert "`stack`" in message_of(write_study(tmp_path, observation=both))


def test_what_the_command_writes_is_the_same_each_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path)
    main(["image", str(folder)])
    shown = capsys.readouterr().out
    files = {path.name: path.read_bytes() for path in (folder / "image").iterdir()}
    assert sorted(files) == ["surface.json", "surface.png", "surface.vtu"]
    for words in ("stack of 40 planes, 1 µm apart, from the study", "closed", "σ_N² for closest_point", "surface.vtu"):
        assert words in shown
    study = load_study(folder)
    how = Reading.from_options({"file": "surface.vtu", "unit": "mm"}, "surface")
    read = read_interface(folder / "image" / "surface.vtu", how)
    np.testing.assert_allclose(read.points, study.observed[""].points, rtol=1e-6, atol=1e-10)
    content = json.loads(files["surface.json"])
    (how_read,) = read_how(study)
    assert (how_read["file"], how_read["notes"]) == ("cells.npy", content["notes"])
    assert "at voxel (20.2, 19.5, 19.8) from the study; its axes point x right (default), y down" in shown
    assert content["triangles"] == len(read.cells)
    assert content["sd"] == pytest.approx(study.stacks[""].errors.sd)
    (name, one), other = content["noise_variance"].items()
    assert name.startswith("closest_point, direction to_simulated")
    assert one["value"] > 0
    assert other[0] == "normal_offset"
    write_stacks(folder, study.stacks, measures=study.discrepancies)
    assert {path.name: path.read_bytes() for path in (folder / "image").iterdir()} == files


def test_an_open_surface_is_noted(tmp_path: Path) -> None:
    np.save(tmp_path / "half.npy", grey()[:22])
    study = loaded(tmp_path, file="half.npy")
    assert not study.observed[""].closed
    assert "the surface is open" in " ".join(study.stacks[""].notes)


def test_a_region_in_coordinates_of_the_model_turns_with_its_frame(tmp_path: Path) -> None:
    """The model's x axis runs along the rows of the stack, so the same ball is another place."""
    turned = {"origin": ORIGIN, "rotation": [0, 0, 90]}
    study = loaded(tmp_path, frame=turned, exclude=[{"ball": [RADIUS, 0, 0], "radius": 0.005, "unit": "mm"}])
    points = study.observed[""].points
    assert np.linalg.norm(points - [RADIUS, 0, 0], axis=1).min() > 0.005
    assert np.linalg.norm(points - [0, RADIUS, 0], axis=1).min() < 0.002
    mesh = study.stacks[""].surface.mesh
    assert np.linalg.norm(mesh.points - ORIGIN - [0, RADIUS / V, 0], axis=1).min() > 5
    assert "triangles in excluded regions left out" in " ".join(study.stacks[""].notes)
