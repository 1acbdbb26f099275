"""A copy of a study with other values: its name, its text, what it takes over, and what is refused."""

from pathlib import Path

import pytest
import yaml

from strandline.errors import InvalidStudy
from strandline.studies import changed_copy
from strandline.studies.changed_copy import changed_study
from strandline.testing.studies import write_study

COMMENTED = """\
# A beam that is bent.
{text}# The end.
"""


@pytest.fixture
def beam(tmp_path: Path) -> Path:
    """A study with comments and a file of its own."""
    return write_beam(tmp_path / "beam")


def write_beam(folder: Path) -> Path:
    write_study(folder, design={"sobol": {"runs": 8}}, executor=None)
    text = yaml.safe_dump(content(folder), sort_keys=False).replace("seed:", "# chosen by a die\nseed:")
    (folder / "study.yaml").write_text(COMMENTED.format(text=text))
    (folder / "notes.txt").write_text("mine")
    return folder


def state(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def content(folder: Path) -> dict[str, object]:
    loaded: dict[str, object] = yaml.safe_load((folder / "study.yaml").read_text())
    return loaded


def test_a_copy_lies_beside_the_study_and_keeps_comments_and_files(beam: Path) -> None:
    before = state(beam)
    copy = changed_study(beam, ["seed=3", "noise={variance: 1.0e-4}"])
    assert copy == beam.with_name("beam-noise-variance-0.0001-seed-3")
    assert copy == changed_study(beam, ["noise={variance: 1.0e-4}", "seed=3"]), "the order does not matter"
    text = (copy / "study.yaml").read_text()
    assert text.startswith("# beam with noise={variance: 0.0001}, seed=3\n# A beam that is bent.\n")
    assert all(comment in text for comment in ("# chosen by a die", "# The end."))
    assert content(copy)["reuse"] == ["../beam"]
    assert (copy / "notes.txt").read_text() == "mine"
    assert state(beam) == before
    assert sorted(path.name for path in beam.parent.iterdir()) == ["beam", copy.name]


def test_a_long_name_is_shortened_the_same_way_each_time(beam: Path) -> None:
    settings = [f"inputs.{name}.prior.uniform=[0.{'1' * 20}, 0.9]" for name in ("E", "tilt")]
    one = changed_study(beam, settings)
    assert one == changed_study(beam, settings)
    assert len(one.name) <= 63
    other = changed_study(beam, [*settings, "seed=2"])
    assert other.name[:50] == one.name[:50]
    assert other != one


def test_another_folder_and_the_studies_that_the_original_reuses(beam: Path) -> None:
    write_beam(beam.with_name("earlier"))
    (beam / "study.yaml").write_text((beam / "study.yaml").read_text() + "reuse: [../earlier]\n")
    (beam.parent / "below").mkdir()
    target = beam.parent / "below" / "other"
    assert changed_study(beam, ["seed=3"], target) == target
    found = content(target)
    assert found["reuse"] == ["../../beam", "../../earlier"]
    assert (found["name"], found["seed"]) == ("other", 3)


REFUSED: list[tuple[list[str], list[str]]] = [
    (["noise"], ["--set: got noise", "KEY=VALUE"]),
    (["seed="], ["--set: got seed=", "KEY=VALUE"]),
    (["=3"], ["--set: got =3"]),
    (["noise..sd=3"], ["--set: got noise..sd=3"]),
    (["seed=[1"], ["--set seed: the value is not valid YAML", "got [1", "Put quotes"]),
    (["seed=!!python/object:os.system 1"], ["--set seed: the value is not valid YAML"]),
    (["seed=1", "seed=2"], ["--set: got seed", "each key once"]),
    (["seed.x=1"], ["--set seed.x: seed has no keys below it", "Set seed as a whole."]),
    (["inputs.E.unit.x=1"], ["inputs.E.unit has no keys below it: got Pa"]),
    (["noise.varience=3"], ["--set: study.yaml: unknown key: got noise.varience", "Did you mean variance?"]),
    (["seed=many"], ["--set: study.yaml: seed: got many", "a whole number"]),
    (["inputs.E.prior.uniform=[800, 100]"], ["--set: ", "inputs.E"]),
    (["model.python.function=nowhere:f"], ["--set: ", "got nowhere:f", "PYTHONPATH"]),
]


def test_what_is_refused_leaves_nothing_behind(beam: Path) -> None:
    before = state(beam.parent)
    for settings, told in REFUSED:
        with pytest.raises(InvalidStudy) as caught:
            changed_study(beam, settings)
        assert all(words in str(caught.value) for words in told), (settings, str(caught.value))
    for into in (".", "beam", "beam/below"):
        with pytest.raises(InvalidStudy, match="--into"):
            changed_study(beam, ["seed=3"], beam.parent / into)
    assert state(beam.parent) == before
    assert [path.name for path in beam.parent.iterdir()] == ["beam"]


def test_the_folder_of_another_study_is_refused(beam: Path) -> None:
    copy = changed_study(beam, ["seed=3"])
    for name in ("notes.txt", "study.yaml"):
        kept = (beam / name).read_text()
        (beam / name).write_text(kept + "# changed\n")
        before = state(copy)
        with pytest.raises(InvalidStudy, match=f"another study already: got {copy}, where {name} differs.*--into"):
            changed_study(beam, ["seed=3"])
        assert state(copy) == before
        (beam / name).write_text(kept)
    assert changed_study(beam, ["seed=3"]) == copy
    with pytest.raises(InvalidStudy, match=r"where study\.yaml differs"):
        changed_study(beam, ["seed=4"], copy)


def test_keys_with_dots_and_a_planted_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: each dot begins another key."""
    name = "strandline.models.python:PythonModel"
    folder = write_study(tmp_path / "beam", model={name: {"function": "nowhere:f"}})
    setting = f"model.{name}.function=strandline.testing.studies:beam"
    found = content(changed_study(folder, [setting]))["model"]
    assert found == {name: {"function": "strandline.testing.studies:beam"}}
    monkeypatch.setattr(changed_copy, "_keys", lambda name, content: tuple(name.split(".")))
    with pytest.raises(InvalidStudy):
        changed_study(folder, [setting], tmp_path / "other")
