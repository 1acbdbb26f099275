"""`strandline run --set`: a copy with other values, which takes over the runs and leaves the original as it is."""

import json
from pathlib import Path

import pytest
import yaml

from strandline.cli import main
from strandline.errors import InvalidStudy
from strandline.studies import changed_copy
from strandline.studies.changed_copy import changed_study
from strandline.testing.studies import write_study

SAMPLER = {"smc": {"particles": 300, "rejuvenation_steps": 2, "zeta": 0.5}}
COMMENTED = """\
# A beam that is bent.
{text}# The end.
"""


def beam(folder: Path) -> Path:
    write_study(folder, sampler=SAMPLER, design={"sobol": {"runs": 8}}, executor=None)
    content = yaml.safe_load((folder / "study.yaml").read_text())
    text = yaml.safe_dump(content, sort_keys=False).replace("seed:", "# chosen by a die\nseed:")
    (folder / "study.yaml").write_text(COMMENTED.format(text=text))
    (folder / "notes.txt").write_text("mine")
    return folder


def state(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def content(folder: Path) -> dict[str, object]:
    loaded: dict[str, object] = yaml.safe_load((folder / "study.yaml").read_text())
    return loaded


def ends(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(str(ended.value.code))


def test_it_runs_a_copy_that_takes_over_all_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    monkeypatch.chdir(tmp_path)
    beam(Path("beam"))
    main(["run", "beam", "--quiet", "--json"])
    first = json.loads(capsys.readouterr().out)
    assert first["runs"]["new"] == 8
    before = state(Path("beam"))
    words = ["run", "beam", "--set", "noise.sd=0.006", "--set", "seed=3", "--json"]
    main(words)
    shown = capsys.readouterr()
    second = json.loads(shown.out)
    assert "noise.sd=0.006, seed=3: the study in beam-noise.sd-0.006-seed-3\n" in shown.err
    assert (second["runs"]["new"], second["runs"]["reused"]) == (0, 8)
    assert second["study"] == "beam-noise.sd-0.006-seed-3"
    assert second["inputs"]["E"]["sd"] > 1.3 * first["inputs"]["E"]["sd"]
    copy = Path(second["study"])
    text = (copy / "study.yaml").read_text()
    assert text.startswith("# beam with noise.sd=0.006, seed=3\n# A beam that is bent.\n")
    assert all(comment in text for comment in ("# chosen by a die", "# The end."))
    assert content(copy)["reuse"] == ["../beam"]
    assert (copy / "notes.txt").read_text() == "mine"
    main(words)  # the same again
    assert json.loads(capsys.readouterr().out)["runs"] == {**second["runs"], "reused": 8, "new": 0}
    assert state(Path("beam")) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["beam", copy.name]


def test_the_order_of_settings_does_not_matter(tmp_path: Path) -> None:
    beam(tmp_path / "beam")
    one = changed_study(tmp_path / "beam", ["seed=3", "noise={variance: 1.0e-4}"])
    assert one == changed_study(tmp_path / "beam", ["noise={variance: 1.0e-4}", "seed=3"])
    assert one.name == "beam-noise-variance-0.0001-seed-3"


def test_a_long_name_is_shortened_the_same_way_each_time(tmp_path: Path) -> None:
    beam(tmp_path / "beam")
    settings = [f"inputs.{name}.prior.uniform=[0.{'1' * 20}, 0.9]" for name in ("E", "tilt")]
    one = changed_study(tmp_path / "beam", settings)
    assert one == changed_study(tmp_path / "beam", settings)
    assert len(one.name) <= 63
    other = changed_study(tmp_path / "beam", [*settings, "seed=2"])
    assert other.name[:50] == one.name[:50]
    assert other != one


def test_another_folder_and_the_studies_that_the_original_reuses(tmp_path: Path) -> None:
    beam(tmp_path / "earlier")
    folder = beam(tmp_path / "beam")
    (folder / "study.yaml").write_text((folder / "study.yaml").read_text() + "reuse: [../earlier]\n")
    (tmp_path / "below").mkdir()
    copy = changed_study(folder, ["seed=3"], tmp_path / "below" / "other")
    assert copy == tmp_path / "below" / "other"
    assert content(copy)["reuse"] == ["../../beam", "../../earlier"]
    assert content(copy)["name"] == "other"
    assert content(copy)["seed"] == 3


@pytest.mark.parametrize(
    ("settings", "told"),
    [
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
        (["sed=3"], ["--set: study.yaml: unknown key: got sed", "Did you mean seed?"]),
        (["seed=many"], ["--set: study.yaml: seed: got many", "a whole number"]),
        (["inputs.E.prior.uniform=[800, 100]"], ["--set: ", "inputs.E"]),
        (["model.python.function=nowhere:f"], ["--set: ", "got nowhere:f", "PYTHONPATH"]),
    ],
)
def test_what_is_refused_leaves_nothing_behind(
    settings: list[str], told: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beam(tmp_path / "beam")
    before = state(tmp_path)
    words = [word for setting in settings for word in ("--set", setting)]
    assert ends("run", str(tmp_path / "beam"), *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(text in line for text in told), line
    assert state(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["beam"]


def test_the_folder_of_another_study_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = beam(tmp_path / "beam")
    copy = changed_study(folder, ["seed=3"])
    for name in ("notes.txt", "study.yaml"):
        kept = (folder / name).read_text()
        (folder / name).write_text(kept + "# changed\n")
        before = state(copy)
        assert ends("run", str(folder), "--set", "seed=3") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"there is another study already: got {copy}, where {name} differs" in line
        assert "--into" in line
        assert state(copy) == before
        (folder / name).write_text(kept)
    assert changed_study(folder, ["seed=3"]) == copy
    assert ends("run", str(folder), "--set", "seed=4", "--into", str(copy)) == 2
    assert "where study.yaml differs" in capsys.readouterr().err


@pytest.mark.parametrize("into", [".", "beam", "beam/below"])
def test_no_copy_within_the_study_or_around_it(into: str, tmp_path: Path) -> None:
    beam(tmp_path / "beam")
    before = state(tmp_path)
    with pytest.raises(InvalidStudy, match="--into"):
        changed_study(tmp_path / "beam", ["seed=3"], tmp_path / into)
    assert state(tmp_path) == before


def test_a_folder_needs_a_setting(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    beam(tmp_path / "beam")
    assert ends("run", str(tmp_path / "beam"), "--into", str(tmp_path / "other")) == 2
    assert "expected --set KEY=VALUE too" in capsys.readouterr().err


def test_keys_with_dots_and_a_planted_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_study(tmp_path / "beam", model={"strandline.models.python:PythonModel": {"function": "nowhere:f"}})
    beam_function = "strandline.testing.studies:beam"
    setting = f"model.strandline.models.python:PythonModel.function={beam_function}"
    assert content(changed_study(folder, [setting]))["model"] == {
        "strandline.models.python:PythonModel": {"function": beam_function}
    }
    monkeypatch.setattr(changed_copy, "_keys", lambda name, content: tuple(name.split(".")))
    with pytest.raises(InvalidStudy):
        changed_study(folder, [setting], tmp_path / "other")
