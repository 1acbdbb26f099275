"""What the questions refuse before anything is computed, which studies can be compared, and what they are called."""

import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from filelock import FileLock

import strandline as sl
from strandline.calibration.evidence import Evidence, ModelComparison
from strandline.design.candidates import Candidate, Look
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.questions.answer import LineFile
from strandline.questions.compare import labels_of, require_comparable, require_several
from strandline.questions.comparison import _factor, _verdict, may_err
from strandline.questions.knowledge import _thinned
from strandline.questions.opened import specimen_files
from strandline.questions.prospects import require_settable
from strandline.runs import RunRecord
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, undeclared_beam, write_study

SPECIMENS = {"files": "all/*.csv", "read": {"unit": "mm"}}
REFUSED = [
    ({"next": {"laod": [1]}}, r"next.laod: got laod.*Did you mean load\?"),
    ({"next": {"speed": [1]}}, r"next.speed: got speed; expected one of load, tilt, condition, part"),
    ({"next": {"E": [1]}}, r"next.E: an experiment cannot set what is to be inferred: got E; expected one of load"),
    ({"next": {"condition": ["slow"]}}, r"next.condition: .*single condition.*Remove it"),
    ({"next": {"load": [*range(1, 40)], "together": 2}}, r"next: too many candidates: got 819; expected at most 500"),
    ({"next": {"tilt": [0.02, 0.05]}}, r"next.tilt: got 0.05; expected a value in the box"),
    ({"what_if": [{"nose": {"sd": 1}}]}, r"unknown key: got what_if.0.nose; expected one of name, prior, noise"),
]
NUISANCE = {**BEAM_STUDY["inputs"], "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True}}


def test_questions_that_make_no_sense_are_refused_when_the_study_is_loaded(tmp_path):
    for asked, words in REFUSED:
        with pytest.raises(InvalidStudy, match=words):
            sl.load_study(write_study(tmp_path, inputs=NUISANCE, **asked))


def test_arguments_out_of_range(tmp_path):
    study = sl.load_study(write_study(tmp_path, next={"load": [1.0]}, specimens=SPECIMENS))
    for ask, options, words in [
        (sl.next_experiment, {"source": "posterior"}, "no posterior to plan from"),
        (sl.coverage, {"measure": "currents"}, "measure of the coverage: got currents; expected one of the study's: t"),
        (sl.coverage, {}, "the study is not finished: got 0 of 65 forward runs done"),
        (sl.specimens, {}, r"specimens: got no file all/\*.csv in "),
    ]:
        with pytest.raises(InvalidInput, match=words):
            ask(study, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


@pytest.mark.stand_in
def test_the_folder_of_a_study_in_its_place(tmp_path):
    for ask in (sl.run_study, sl.what_if, sl.next_experiment, sl.coverage, sl.specimens):
        with pytest.raises(InvalidInput, match=r"study: got beam; expected a Study. Load it with load_study\(FOLDER\)"):
            ask("beam")


def test_keys_and_tables_of_specimens_that_are_refused(tmp_path):
    for changes, words in (
        ({}, "study.yaml names no specimens: got beam; expected the key specimens"),
        ({"specimens": "none/*.csv"}, "specimens: how to read the files: got observation.synthetic"),
        ({**TWO_LOADS_STUDY, "specimens": SPECIMENS}, "a model with several conditions: got light, heavy"),
        ({"specimens": {**SPECIMENS, "files": "**.csv"}}, r"specimens.files: got \*\*.csv; expected a pattern"),
    ):
        with pytest.raises(InvalidStudy, match=words):
            _ = specimen_files(sl.load_study(write_study(tmp_path, **changes))).paths
    study = sl.load_study(write_study(tmp_path, specimens={**SPECIMENS, "given": "known.csv"}))
    for table, words in (
        ("file,weight\ns0.csv,1\n", "columns of known.csv: got file, weight; expected file and some, not all"),
        ("file,tilt\ns0.csv,0.02\ns0.csv,0.03\n", "rows of known.csv: got several for s0.csv"),
    ):
        (tmp_path / "known.csv").write_text(table)
        with pytest.raises(InvalidStudy, match=re.escape(words)):
            specimen_files(study)


def test_tables_beside_the_outlines_are_no_outlines(tmp_path):
    for name in ("specimens.csv", "s1.csv", "s0.csv"):
        (tmp_path / name).write_text("0,0\n1,1\n2,0\n")
    (tmp_path / "known.csv").write_text("file,tilt\ns0.csv,0.02\n")
    given = {**SPECIMENS, "files": "*.csv", "given": "known.csv"}
    files = specimen_files(sl.load_study(write_study(tmp_path, specimens=given)))
    assert [path.name for path in files.paths] == [*map(files.name, files.paths)] == ["s0.csv", "s1.csv"]
    assert files.alike(files.paths) == [("s0.csv", "s1.csv")]


def test_a_file_of_lines_is_resumed(tmp_path):
    file, path = LineFile(tmp_path / "lines.jsonl"), tmp_path / "lines.jsonl"
    path.write_text('not JSON\n[1]\n{"of": "another"}\n{"of": "x", "sp')
    assert file.entries() == [{}, {}, {"of": "another"}]
    file.append({"of": "mine"})
    assert file.entries()[-1] == {"of": "mine"}
    assert len(path.read_text().splitlines()) == 4
    with FileLock(f"{path}.lock"), pytest.raises(InvalidStudy, match="one at a time"), file.held("it", "lines"):
        pass


def test_long_designs_are_thinned_only_if_the_log_likelihood_is_learnt(tmp_path):
    study = sl.load_study(write_study(tmp_path))
    many = tuple(RunRecord(str(k), {}, "ok") for k in range(1000))
    assert [int(one.key) for one in _thinned(study, many)] == [*range(200), *range(800, 1000)]
    assert _thinned(replace(study, settings=replace(study.settings, surrogate="field")), many) == many


E, TILT = {"prior": {"uniform": [300, 560]}, "unit": "Pa"}, {"prior": {"uniform": [0.0, 0.08]}}
WIDER = {**E, "prior": {"uniform": [300, 600]}}
FREE = {"python": {"function": "strandline.testing.studies:undeclared_beam"}}
FIXED = {"load": 1e-5, "tilt": 0.015}


def noise(sd, **more):
    return {"noise": {"sd": sd, "unit": "um", **more}}


def observed(name):
    return {"observation": {"file": f"../{name}.csv", "unit": "mm"}}


@pytest.fixture
def study(tmp_path):
    """Return a function that writes studies of observed interfaces: the same in either direction, or another one."""
    points = undeclared_beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, Path()).interfaces[""].points
    for name, some in {"beam": points, "turned": points[::-1], "other": points + np.array([0, 0.01])}.items():
        np.savetxt(tmp_path / f"{name}.csv", some, delimiter=",")
    same = {"discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}, **observed("beam"), **noise(3)}

    def written(folder, **changes):
        content = {"inputs": {"E": E, "tilt": TILT}, "name": folder, **same, **changes}
        return sl.load_study(write_study(tmp_path / folder, **content))

    return written


def test_studies_that_can_be_compared(study):
    """They know another input, allow for an error of the model, or observe the points in the other direction."""
    one, erring = study("tilted"), noise(3, model_error=True)
    assert not may_err(one)
    for changes in ({"inputs": {"E": E}, "fixed": FIXED}, erring, observed("turned")):
        other = study("other", **changes)
        require_comparable({"tilted": one, "other": other})
        assert may_err(other) is (changes == erring)


def test_what_cannot_be_compared(study):
    one = study("tilted")
    for changes, words in [
        (noise("unknown"), "other cannot be compared: the range of its unknown noise is not"),
        (observed("other"), r"the observed interfaces differ: got points up to 10 µm apart"),
        (noise(4), "tilted and other cannot be compared: the noise differs: got sd 0.003 "),
        ({"discrepancy": {"tracked_points": {}}}, "the measures differ: got NormalOffset and TrackedPoints"),
        ({"inputs": {"E": WIDER, "tilt": TILT}}, r"supports of the priors of E differ: got \[300, 560\] and \[300, 60"),
        ({"model": FREE, "inputs": {"E": {**E, "unit": "kPa"}, "tilt": TILT}}, "units of E differ: got Pa and kPa"),
    ]:
        with pytest.raises(InvalidStudy, match=words):
            require_comparable({"tilted": one, "other": study("other", **changes)})
    synthetic = replace(study("other", **observed("other")), truth={"E": 400.0})
    with pytest.raises(InvalidStudy, match="A synthetic observation comes from the study's own model"):
        require_comparable({"tilted": one, "other": synthetic})


@pytest.mark.stand_in
def test_a_verdict_that_a_prior_decides_says_so():
    """What the prior adds to ln B is the information that it must pay for."""
    even = {"a": Evidence(0.55, 0.1), "b": Evidence(0.0, 0.1)}
    found, flat = ModelComparison({**even, "a": Evidence(4.59, 0.1)}), ModelComparison(even)
    text = _verdict(found, flat, ["EI"])
    assert text.startswith("The data favour a over b: ln B = 4.59 ± 0.14, strong evidence. But the prior of EI decides")
    assert text.endswith("same box, the data cannot tell a and b apart: ln B = 0.55 ± 0.14 of a over b, below 1.")
    assert _verdict(found, None, []) == _verdict(found, found, ["EI"]) == found.verdict
    paid = {name: Mock(posterior=Mock(information=one)) for name, one in {"a": 2.0, "b": 6.0}.items()}
    parts = _factor(found.factors[0], paid, flat)
    assert [round(parts[key], 2) for key in ("ln", "fit", "prior", "flat_ln")] == [4.59, 0.59, 4.0, 0.55]


def test_fewer_than_two_studies_and_wrong_odds_are_refused(study):
    one, other = study("tilted"), study("other")
    again = replace(one, folder=other.folder / ".." / "tilted")
    for studies, words in (([one], "tilted; expected at least two"), ([one, other, again], "tilted twice; expected")):
        with pytest.raises(InvalidInput, match=words):
            require_several(studies)
    with pytest.raises(InvalidInput, match="got 1:0; expected 2 numbers above 0"):
        sl.compare([one, other], odds=(1.0, 0.0))


def test_names_of_studies(study, tmp_path):
    a, b = study("a", name="beam"), study("b", name="beam")
    c = study("c/a", name="other", observation={"file": str(tmp_path / "beam.csv"), "unit": "mm"})
    assert labels_of([a, c]) == ("beam", "other")
    assert labels_of([a, b]) == ("a", "b")
    assert labels_of([a, b, c]) == tuple(str(one.folder.resolve()) for one in (a, b, c))


def test_candidates_must_fit_all_studies(study):
    tilted, straight = study("tilted"), study("straight", inputs={"E": E}, fixed=FIXED)
    straight = replace(straight, fixed={**FIXED, "mass": 1.0})
    for name, words in (("tilt", "which is calibrated there"), ("mass", "which its model does not have")):
        wanted = (Candidate(({name: 1.0},), Look()),)
        with pytest.raises(InvalidInput, match=f"do not fit tilted: got {name}, {words}"):
            require_settable({"straight": straight, "tilted": tilted}, wanted)
