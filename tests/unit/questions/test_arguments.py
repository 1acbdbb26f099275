"""What the questions refuse before anything is computed."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

import strandline as sl
from strandline.errors import InvalidInput, InvalidStudy
from strandline.questions.knowledge import _thinned
from strandline.questions.line_file import LineFile
from strandline.questions.specimens.files import specimen_files
from strandline.runs import RunRecord
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study

SPECIMENS = {"files": "all/*.csv", "read": {"unit": "mm"}}
NUISANCE = {"inputs": {**BEAM_STUDY["inputs"], "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True}}}

NEXT: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({}, {"laod": [1]}, r"next.laod: got no such quantity.*Did you mean load\?"),
    ({}, {"E": [1]}, r"next.E: got an input to calibrate.*cannot set what is to be inferred"),
    ({}, {"load": 3}, r"next.load: got 3; expected a list"),
    ({}, {"load": []}, r"next.load: got \[\]; expected a list"),
    ({}, {"load": ["much"]}, r"next.load: got much; expected finite numbers"),
    ({}, {"load": [1e999]}, r"next.load: .*finite"),
    ({}, {"load": [1], "together": 4}, r"next.together: got 4.*from 1 to 3"),
    ({}, {"part": [[0.5, 0.2]]}, r"next.part: got \[0.5, 0.2\].*pairs of shares"),
    ({}, {"points": [2]}, r"next.points: got 2; expected whole numbers from 3"),
    ({}, {"sd": [3]}, r"next.unit: .*one of .*um"),
    ({}, {"sd": [-3], "unit": "um"}, r"next.sd: got -3.*above 0"),
    ({}, {"condition": ["slow"]}, r"next.condition: .*single condition.*Remove it"),
    ({}, {"load": list(range(1, 40)), "together": 2}, r"next: too many candidates: got 819; expected at most 500"),
    (NUISANCE, {"tilt": [0.02, 0.05]}, r"next.tilt: got 0.05; expected a value in the box"),
]


def test_candidates_that_make_no_sense_are_refused_when_the_study_is_loaded(tmp_path: Path) -> None:
    for changes, given, words in NEXT:
        with pytest.raises(InvalidStudy) as caught:
            sl.load_study(write_study(tmp_path, **changes, next=given))
        assert re.search(words, str(caught.value)), str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "wrong", "words"),
    [
        ("what_if", [{"nose": {"sd": 1}}], r"unknown key: got what_if.0.nose; expected one of name, prior, noise"),
        ("specimens", {"file": "all/*.csv"}, "unknown key"),
    ],
)
def test_other_questions_are_checked_too(key: str, wrong: Any, words: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=words):
        sl.load_study(write_study(tmp_path, **{key: wrong}))


def test_arguments_out_of_range(tmp_path: Path) -> None:
    study = sl.load_study(write_study(tmp_path, next={"load": [1.0]}, specimens=SPECIMENS))
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        (sl.next_experiment, {"draws": 199}, "from 200 to 4000"),
        (sl.next_experiment, {"draws": 4001}, "from 200 to 4000"),
        (sl.next_experiment, {"runs": 3}, "at least 4"),
        (sl.next_experiment, {"seed": -1}, "seed of the next experiment: got -1; expected 0 or above"),
        (sl.next_experiment, {"source": "x"}, "expected prior or posterior"),
        (sl.next_experiment, {"source": "posterior"}, "no posterior to plan from"),
        (sl.coverage, {"replicates": 19}, "replicates of the coverage: got 19; expected at least 20"),
        (
            sl.coverage,
            {"measure": "currents"},
            "measure of the coverage: got currents; expected one of the study's: t",
        ),
        (sl.coverage, {"seed": -1}, "seed of the coverage"),
        (sl.coverage, {"source": "somewhere"}, "source of the true inputs: got somewhere"),
        (sl.coverage, {}, "the study is not finished: got 0 of 65 forward runs done"),
        (sl.open_specimens, {"measure": "currents"}, "measure of the specimens: got currents; expected one of the stu"),
        (sl.open_specimens, {"seed": -1}, "seed of the specimens"),
        (sl.open_specimens, {}, "the study is not finished"),
        (sl.specimens, {"refine": -1}, "further runs: got -1"),
        (sl.specimens, {"processes": 0}, "processes: got 0"),
        (sl.specimens, {}, r"specimens: got no file all/\*.csv in "),
    ]
    for ask, options, words in wrong:
        with pytest.raises(InvalidInput, match=words):
            ask(study, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


class TestFilesOfSpecimens:
    def test_keys_that_are_refused(self, tmp_path: Path) -> None:
        for changes, words in (
            ({}, "study.yaml names no specimens: got beam; expected the key specimens"),
            ({"specimens": "none/*.csv"}, "specimens: how to read the files: got observation.synthetic"),
            ({"specimens": {**SPECIMENS, "read": {"unit": "inch"}}}, r"specimens.read.unit: got inch"),
            ({**TWO_LOADS_STUDY, "specimens": SPECIMENS}, "a model with several conditions: got light, heavy"),
            ({"specimens": {**SPECIMENS, "files": "**.csv"}}, r"specimens.files: got \*\*.csv; expected a pattern"),
        ):
            folder = write_study(tmp_path, **changes)
            with pytest.raises(InvalidStudy, match=words):
                _ = specimen_files(sl.load_study(folder)).paths

    def test_tables_that_are_refused(self, tmp_path: Path) -> None:
        study = sl.load_study(write_study(tmp_path, specimens={**SPECIMENS, "given": "known.csv"}))
        with pytest.raises(InvalidStudy, match=r"specimens.given: got known.csv"):
            specimen_files(study)
        for table, words in (
            ("file,weight\ns0.csv,1\n", "columns of known.csv: got file, weight; expected file and some, not all"),
            ("file,tilt,weight\ns0.csv,0,1\n", "got file, tilt, weight"),
            ("tilt\n0\n", "got tilt; expected file"),
            ("file,E,tilt\ns0.csv,400,0.02\n", "some, not all"),
            ("", "got none"),
            ("file,tilt\ns0.csv,0.02\ns0.csv,0.03\n", "rows of known.csv: got several for s0.csv"),
        ):
            (tmp_path / "known.csv").write_text(table)
            with pytest.raises(InvalidStudy, match=re.escape(words)):
                specimen_files(study)

    def test_tables_beside_the_outlines_are_no_outlines(self, tmp_path: Path) -> None:
        for name in ("specimens.csv", "s1.csv", "s0.csv"):
            (tmp_path / name).write_text("0,0\n1,1\n2,0\n")
        (tmp_path / "known.csv").write_text("file,tilt\ns0.csv,0.02\ns1.csv,x\n")
        given = {"files": "*.csv", "given": "known.csv", "read": {"unit": "mm"}}
        files = specimen_files(sl.load_study(write_study(tmp_path, specimens=given)))
        assert [path.name for path in files.paths] == ["s0.csv", "s1.csv"]
        assert [files.name(path) for path in files.paths] == ["s0.csv", "s1.csv"]
        assert files.given_of("s0.csv") == {"tilt": 0.02}
        assert files.alike(files.paths) == [("s0.csv", "s1.csv")]
        with pytest.raises(InvalidInput, match=r"known inputs of s1.csv: got no number for tilt"):
            files.given_of("s1.csv")

    def test_the_key_makes_no_result_outdated(self, tmp_path: Path) -> None:
        folder = write_study(tmp_path)
        lines = "".join(f"{key}: {json.dumps(value)}\n" for key, value in BEAM_STUDY.items())
        digests = []
        for asked in ("", 'specimens: {files: "a/*.csv"}\n'):
            (folder / "study.yaml").write_text(lines + asked)
            digests.append(sl.load_study(folder).text_digest)
        assert digests[0] == digests[1]


def test_a_file_of_lines_is_resumed(tmp_path: Path) -> None:
    file = LineFile(tmp_path / "lines.jsonl")
    assert file.entries() == []
    (tmp_path / "lines.jsonl").write_text('not JSON\n[1]\n{"of": "another"}\n{"of": "x", "sp')
    assert file.entries() == [{}, {}, {"of": "another"}]
    file.append({"of": "mine"})
    assert file.entries()[-1] == {"of": "mine"}
    assert len((tmp_path / "lines.jsonl").read_text().splitlines()) == 4
    lock, told = FileLock(tmp_path / "lines.jsonl.lock"), r"in use: got another `it`.*one at a time"
    with lock, pytest.raises(InvalidStudy, match=told), file.held("it", "lines"):
        pass
    with file.held("it", "lines"):
        pass


def test_long_designs_are_thinned_only_if_the_log_likelihood_is_learnt(tmp_path: Path) -> None:
    study = sl.load_study(write_study(tmp_path))
    many = tuple(RunRecord(str(k), {}, "ok") for k in range(1000))
    assert [int(one.key) for one in _thinned(study, many)] == [*range(200), *range(800, 1000)]
    by_field = replace(study, settings=replace(study.settings, surrogate="field"))
    assert _thinned(by_field, many) == many
    assert _thinned(study, many[:400]) == many[:400]
    assert len(_thinned(study, many[:401])) == 400
