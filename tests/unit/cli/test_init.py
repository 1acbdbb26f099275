"""`strandline init`: a study of its own, one of an observed interface, and the examples."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.unit.cli.command_line import Shown, contents, printed, refused

from strandline.cli import main
from strandline.interface import PointErrors, UnknownErrors
from strandline.studies import load_study
from strandline.studies.examples import EXAMPLES, FOLDERS, write_example
from strandline.studies.folder import is_result

ROOT = Path(__file__).parents[3]


class Typed(io.StringIO):
    """Answers typed at a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_new_study_is_sound(tmp_path: Path, capsys: Shown) -> None:
    folder = tmp_path / "my first study"
    shown = printed(capsys, "init", str(folder))
    assert shown.startswith(f"wrote {folder}/study.yaml\nnext: strandline check '{folder}'")
    assert list(contents(folder)) == ["study.yaml"]
    assert load_study(folder).name == "my-first-study"


def test_a_study_of_an_observed_interface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its errors are stated, asked for, or unknown."""
    x = np.linspace(0.3, 0.9, 40)
    np.savetxt(tmp_path / "my edge.csv", np.stack([x, x * (1.2 - x)], axis=1), delimiter=",")
    monkeypatch.setattr("sys.stdin", Typed("inch\nmm\n-3\n2.5\n10\n8\n\n\n1\n"))
    stated = ["--unit", "mm", "--sd", "3", "--length", "15", "--shift", "0", "--rotation", "0.5", "--scale", "0.005"]
    for options, noise in (
        ([*stated, "--offset", "0"], PointErrors(0.003, 0.015, rotation=0.5, scale=0.005)),
        ([], PointErrors(0.0025, 0.01, shift=0.008, offset=0.001)),
    ):
        folder = tmp_path / "a" / f"b{len(options)}"
        main(["init", str(folder), "--observed", str(tmp_path / "my edge.csv"), *options])
        study = load_study(folder)
        assert (list(study.observed), list(study.discrepancies)) == ([""], ["normal_offset"])
        assert study.noise == noise
    monkeypatch.setattr("sys.stdin", io.StringIO())
    unknown = ["--observed", str(tmp_path / "my edge.csv"), "--unit", "mm", "--sd", "unknown"]
    main(["init", str(tmp_path / "c"), *unknown])
    assert load_study(tmp_path / "c").noise == UnknownErrors(None, 0.0)


class TestExamples:
    def test_all_files_are_written(self, tmp_path: Path, capsys: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
        for name in EXAMPLES:
            (tmp_path / name).mkdir()
            monkeypatch.chdir(tmp_path / name)
            shown = printed(capsys, "init", "my one", "--example", name)
            assert shown.endswith("next: strandline check 'my one', then strandline run 'my one'\n")
            written = contents(Path("my one"))
            text = (written["study.yaml"] or b"").decode()
            assert "\nname: my-one\n" in text
            assert "strandline run my one" in text or "strandline check my one" in text
            if name != "biofilm":
                source = ROOT / "examples" / FOLDERS.get(name, name)
                shipped = {one.name: one.read_bytes() for one in source.iterdir() if one.is_file()}
                assert {**written, "study.yaml": shipped["study.yaml"]} == {
                    one: content for one, content in shipped.items() if not is_result(one)
                }

    def test_results_of_one_that_was_run_stay_where_they_are(self, tmp_path: Path) -> None:
        strip = tmp_path / "package" / "examples" / "strip"
        shutil.copytree(ROOT / "examples" / "strip", strip)
        for name in ("ledger.sqlite", "report.html", "specimens.csv"):
            (strip / name).touch()
        write_example("python", tmp_path / "study", package=tmp_path / "package")
        assert sorted(contents(tmp_path / "study")) == [
            "make_observation.py",
            "observed.csv",
            "strip.py",
            "study.yaml",
        ]

    @pytest.mark.parametrize("there", ["study.yaml", "strip.py"])
    def test_nothing_is_overwritten(self, there: str, tmp_path: Path, capsys: Shown) -> None:
        (tmp_path / there).write_text("mine")
        assert "already" in refused(capsys, "init", str(tmp_path), "--example", "python")
        assert contents(tmp_path) == {there: b"mine"}

    def test_the_help_says_what_each_shows(self, capsys: Shown) -> None:
        shown = " ".join(printed(capsys, "init", "--help").split())
        assert all(f"{name} {about}" in shown for name, about in EXAMPLES.items())
