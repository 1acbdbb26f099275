"""`strandline init --example`: each example is written whole, is sound, and runs."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import strandline
from strandline.cli import main
from strandline.studies.examples import EXAMPLES, FOLDERS, write_example
from strandline.studies.folder import STUDY, is_result

ROOT = Path(__file__).parents[2]
NEEDS = {"calculix": "ccx"}
RUN = [
    name if name == "python" else pytest.param(name, marks=pytest.mark.long) for name in EXAMPLES if name not in NEEDS
]
TRUTH = {
    "biofilm": {"E": 400.0, "nu": 0.3},
    "python": {"B": 40.0, "tilt": 1.0},
    "command": {"E": 400.0},
    "creep": {"E": 300.0, "nu": 0.35, "ratio": 1.2, "tau": 4.0},
    "calculix": {"mu": 22.0, "stiffening": 0.25},
    "pendant-drop": {"gamma": 72.4},
    "oct": {"E": 400.0, "nu": 0.3},
}
TRIED = [
    pytest.param(name, marks=pytest.mark.skipif(not shutil.which(NEEDS.get(name, "sh")), reason=f"needs {NEEDS[name]}"))
    if name in NEEDS
    else name
    for name in EXAMPLES
]


def ends(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(str(ended.value.code))


def with_this_package() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [Path(strandline.__file__).parents[1], *sys.path]))}


@pytest.mark.parametrize("name", EXAMPLES)
def test_all_files_of_an_example_are_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main(["init", "my one", "--example", name])
    assert capsys.readouterr().out.endswith("next: strandline check 'my one', then strandline run 'my one'\n")
    text = Path("my one", STUDY).read_text("utf-8")
    assert "\nname: my-one\n" in text
    assert "strandline run my one" in text or "strandline check my one" in text
    if name == "biofilm":
        return
    source = ROOT / "examples" / FOLDERS.get(name, name)
    shipped = {path.name for path in source.iterdir() if path.is_file() and not is_result(path.name)}
    assert {path.name for path in Path("my one").iterdir()} == shipped
    for one in shipped - {STUDY}:
        assert Path("my one", one).read_bytes() == (source / one).read_bytes()


@pytest.mark.parametrize("name", TRIED)
def test_an_example_is_sound(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_example(name, tmp_path / "study")
    main(["check", str(tmp_path / "study")])
    assert "study: study.yaml is sound" in capsys.readouterr().out


@pytest.mark.parametrize("name", RUN)
def test_an_example_finds_the_truth(name: str, tmp_path: Path) -> None:
    write_example(name, tmp_path / "study")
    words = [sys.executable, "-m", "strandline", "run", "study", "--quiet", "--json"]
    done = subprocess.run(words, cwd=tmp_path, env=with_this_package(), capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    inputs = json.loads(done.stdout)["inputs"]
    for one, true in TRUTH[name].items():
        assert abs(inputs[one]["mean"] - true) < 3 * inputs[one]["sd"], inputs[one]


def test_results_of_an_example_that_was_run_stay_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(ROOT / "examples" / "strip", tmp_path / "package" / "examples" / "strip")
    for name in ("ledger.sqlite", "report.html", "specimens.csv"):
        (tmp_path / "package" / "examples" / "strip" / name).write_text("")
    monkeypatch.setattr("strandline.studies.examples.PACKAGE", tmp_path / "package")
    write_example("python", tmp_path / "study")
    assert sorted(path.name for path in (tmp_path / "study").iterdir()) == [
        "make_observation.py",
        "observed.csv",
        "strip.py",
        "study.yaml",
    ]


@pytest.mark.parametrize("name", EXAMPLES)
def test_no_study_is_overwritten(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / STUDY).write_text("mine")
    assert ends("init", str(tmp_path), "--example", name) == 2
    assert "there is a study already" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {STUDY: "mine"}


def test_no_other_file_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "strip.py").write_text("mine")
    assert ends("init", str(tmp_path), "--example", "python") == 2
    assert f"there is such a file already: got {tmp_path / 'strip.py'}" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"strip.py": "mine"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--example", "pendent-drop"], ["'pendent-drop' is not one of", "Did you mean pendant-drop?", "'calculix'"]),
        (["--example", "x"], ["'x' is not one of", "'oct'"]),
        (["--example", "oct", "--observed", "seen.csv"], ["--example oct comes with its own", "got --observed"]),
        (["--example", "oct", "--unit", "mm", "--sd", "3"], ["got --unit, --sd", "Leave out --example"]),
    ],
)
def test_what_is_refused(
    words: list[str],
    told: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert ends("init", "study", *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(text in line for text in told), line
    assert not Path("study").exists()


def test_the_help_says_what_each_example_shows(capsys: pytest.CaptureFixture[str]) -> None:
    main(["init", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert all(f"{name} {about}" in shown for name, about in EXAMPLES.items())
