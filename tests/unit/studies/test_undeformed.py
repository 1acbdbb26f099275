"""Two pictures of one specimen: the undeformed outline drives the model, and its errors are those of the study."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.unit.studies.refused import message_of

import strandline as sl
from strandline.cli import main
from strandline.interface import GaussianNoise, Interface, PointErrors, UnknownErrors
from strandline.studies import Study, load_study
from strandline.studies.pictures.undeformed import Undeformed, with_errors_of
from strandline.studies.read_how import read_how

EXAMPLE = Path(__file__).parents[3] / "examples" / "oct-biofilm"
SEEN = Interface.polyline(np.stack([np.linspace(0, 1, 101), np.zeros(101)], axis=1))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """The study of the example, loaded from a copy."""
    folder = tmp_path_factory.mktemp("oct") / "study"
    folder.mkdir()
    for name in ("study.yaml", "undeformed.png", "deformed.png"):
        shutil.copy(EXAMPLE / name, folder)
    return load_study(folder)


def undeformed(study: Study) -> Undeformed:
    assert study.undeformed is not None
    return study.undeformed


def test_the_model_takes_the_outline(study: Study) -> None:
    found, true = undeformed(study), np.asarray(sl.Biofilm().undeformed().points)
    assert isinstance(study.model, sl.Biofilm)
    model = np.asarray(study.model.undeformed().points)
    assert model.shape == true.shape
    assert np.linalg.norm(model - true, axis=1).max() < 0.03
    inner = Interface.polyline(found.outline.points[20:-20])
    fine = np.stack([np.interp(np.linspace(0, 65, 6000), np.arange(66), column) for column in true.T], axis=1)
    away = np.linalg.norm(inner.points[:, None] - fine[None], axis=2).min(axis=1)
    assert np.sqrt(np.mean(away**2)) < 3 * np.hypot(found.errors.sd, found.errors.offset)


def test_the_registration_finds_how_the_flow_cell_moved(study: Study) -> None:
    found = study.pictures[""].registration
    assert found is not None
    c, s = np.cos(np.radians(0.3)), np.sin(np.radians(0.3))
    away = np.array(found.centre) - [-105.0, 205.0]
    true = away @ np.array([[c, s], [-s, c]]) + [4.3, -2.1] - away
    assert np.abs(np.array(found.shift) - true).max() < 3 * found.shift_sd < 6
    assert abs(found.rotation - 0.3) < 3 * found.rotation_sd < 0.5


def test_its_errors_join_those_of_the_observation(study: Study) -> None:
    noise, own, edge = study.noise_of(""), undeformed(study).errors, study.pictures[""].errors
    assert isinstance(noise, PointErrors)
    assert noise.sd == pytest.approx(np.hypot(own.sd, edge.sd))
    assert noise.sd**2 * noise.length == pytest.approx(own.sd**2 * own.length + edge.sd**2 * edge.length)
    assert noise.offset == pytest.approx(np.hypot(own.offset, edge.offset))
    assert noise.shift == pytest.approx(edge.shift)
    assert noise.shift > 0.001
    assert noise.rotation == pytest.approx(edge.rotation)
    assert noise.scale == 0.005


def test_each_condition_takes_its_share(study: Study) -> None:
    own = undeformed(study).errors
    given = PointErrors(0.002, 0.0, offset=0.001)
    one, three = (with_errors_of(study.undeformed, given, SEEN, conditions=n) for n in (1, 3))
    assert isinstance(one, PointErrors)
    assert isinstance(three, PointErrors)
    assert one.sd**2 - given.sd**2 == pytest.approx(own.sd**2)
    assert three.sd**2 - given.sd**2 == pytest.approx(3 * own.sd**2)
    assert three.offset == pytest.approx(np.sqrt(0.001**2 + 3 * own.offset**2))
    # white points that are 10 µm apart count as correlated over half of that
    assert one.sd**2 * one.length == pytest.approx(given.sd**2 * 0.005 + own.sd**2 * own.length)


def test_other_noise_stays(study: Study) -> None:
    stated = GaussianNoise(1e-4)
    assert with_errors_of(study.undeformed, stated, SEEN, conditions=1) is stated
    assert with_errors_of(None, PointErrors(0.002), SEEN, conditions=1) == PointErrors(0.002)
    inferred = with_errors_of(study.undeformed, UnknownErrors(offset=0.001), SEEN, conditions=1)
    assert isinstance(inferred, UnknownErrors)
    assert inferred.offset > 0.001


def test_both_pictures_say_how_they_were_read(study: Study) -> None:
    first, second = read_how(study)
    assert (first["condition"], first["file"], second["file"]) == ("undeformed", "undeformed.png", "deformed.png")
    assert first["notes"][-2].startswith("the model's (0, 0) at pixel (-105, 205) from the study")
    assert second["notes"][-2].startswith("in undeformed.png, the model's (0, 0) at pixel (-105, 205) from the study")


def test_the_command_writes_both_pictures(study: Study, capsys: pytest.CaptureFixture[str]) -> None:
    main(["image", str(study.folder)])
    out = capsys.readouterr().out
    assert "undeformed: undeformed.png: edge of" in out
    assert "smooth outline: sd of a point" in out
    assert "set-up moved by" in out
    written = {path.name for path in (study.folder / "image").iterdir()}
    assert {"edge.csv", "edge.png", "undeformed-edge.png", "undeformed-outline.csv"} <= written
    outline = np.loadtxt(study.folder / "image" / "undeformed-outline.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(outline, undeformed(study).outline.points, atol=1e-6)
    main(["image", str(study.folder), "--edit", "--condition", "undeformed"])
    assert "undeformed.mark.html" in capsys.readouterr().out


CROSSING = [[89, 100], [166, 50], [247, 58], [310, 126]]
REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("outline", {"pixel": None}, "pixel"),
    ("outline", {"solid": None}, "model.biofilm.outline.image.solid"),
    ("outline", {"colour": "red"}, "model.biofilm.outline.image.colour"),
    ("outline", {"path": CROSSING}, "undeformed outline in the picture"),
    ("registration", {"to": "nothing.png"}, "nothing.png"),
    ("registration", {"fixed": []}, "regions that do not move"),
    ("registration", {"fixed": [[[2, 2], [6, 2], [6, 6]]]}, "fixed regions of the picture"),
    ("registration", {"fixed": [[[2, 2], [100, 2], [100, 30], [2, 30]]]}, "correlation"),
    ("registration", {"marks": "nothing.path.json"}, "nothing.path.json"),
    ("noise", {"unknown": {"scale": 0.005, "shared": True}}, "noise.unknown.shared"),
]


def test_bad_input_is_one_line(study: Study, tmp_path: Path) -> None:
    shutil.copytree(study.folder, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("image", "*.html"))
    for where, keys, words in REFUSED:
        content = yaml.safe_load((EXAMPLE / "study.yaml").read_text("utf-8"))
        place = {
            "outline": content["model"]["biofilm"]["outline"]["image"],
            "registration": content["observation"]["image"]["registration"],
            "noise": content["noise"],
        }[where]
        place |= keys
        for key in [key for key, value in keys.items() if value is None]:
            del place[key]
        (tmp_path / "study.yaml").write_text(yaml.safe_dump(content), "utf-8")
        assert words in message_of(tmp_path)
