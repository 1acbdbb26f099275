"""Other assumptions of a study: files, the command, the key, and what is refused; a changed study as the oracle."""

import json

import numpy as np
import pytest
from scipy.stats import norm
from tests.study.conftest import NOISY, SAMPLER
from tests.study.questions.conftest import content_of, line_by_line

import strandline as sl
from strandline.calibration.what_if import baseline
from strandline.cli import main
from strandline.foundations import InvalidInput, InvalidStudy, NoCommonPoints
from strandline.questions.knowledge import field_knowledge
from strandline.questions.what_if import PLACE, alternative_of, what_if
from strandline.studies.keys.parse import checked
from strandline.studies.keys.study_file import WhatIf
from strandline.testing.studies import write_study

NARROW = {"prior": {"E": {"normal": [350, 20]}}, "name": "a softer beam"}
WIDER = {"noise": {"sd": 9, "unit": "um"}}


def test_what_it_writes(field, copy_of):
    folder = copy_of(field)
    before = (folder / "ledger.sqlite").read_bytes()
    found = sl.what_if(sl.load_study(folder))
    content = content_of(found, 1, found.content["conclusion"], "32 runs", "new draws", "<td>known</td>")
    assert (folder / "ledger.sqlite").read_bytes() == before
    by_name = {one["name"]: one for one in content["alternatives"]}
    priors = {"prior of E half as wide", "prior of E flat in its logarithm", "prior of tilt half as wide"}
    noise = {"noise half as large", "noise twice as large"}
    assert set(by_name) == priors | noise | {"tilt known to be 0.02", "measure tracked_points"}
    moving = [one["moves"] for one in content["alternatives"]]
    assert any(moving)
    assert moving == sorted(moving, reverse=True)
    assert "the noise" in content["conclusion"]
    assert content["surrogate"]["shift"] < 1e-9
    assert list(by_name["tilt known to be 0.02"]["inputs"]) == ["E"]
    assert by_name["tilt known to be 0.02"]["log_evidence_change"] is not None
    assert by_name["noise twice as large"]["log_evidence_change"] is None


def test_the_changed_study_gives_the_same_posterior(field, tmp_path, copy_of):
    """Run on its own: another sampler, from the prior, with a surrogate learnt for it."""
    asked = {**NARROW, **WIDER, "measure": "tracked_points"}
    (answer,) = what_if(sl.load_study(copy_of(field)), [asked]).found
    tilt = {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True}
    inputs = {"E": {"prior": {"normal": [350, 20]}, "box": [300, 560], "unit": "Pa"}, "tilt": tilt}
    settings = {"design": {"sobol": {"runs": 32}}, "sampler": SAMPLER, "draft": True, "report": "none"}
    parts = {**NOISY, **settings, **WIDER, "discrepancy": {"tracked_points": {}}, "inputs": inputs}
    changed = write_study(tmp_path / "changed", **parts, reuse=["../study"])
    posterior = sl.run_study(sl.load_study(changed), executor=sl.InProcess()).calibration.posterior
    errors = posterior.sd * np.sqrt(1 / posterior.ess + 1 / answer.effective)
    assert (np.abs(answer.draws.mean - posterior.mean) < 4 * errors).all()
    assert (np.abs(answer.draws.sd / posterior.sd - 1) < 4 * errors / posterior.sd).all()
    far = np.abs(answer.present.mean - posterior.mean) / errors + np.abs(answer.present.sd / posterior.sd - 1) / 0.05
    assert far.max() > 8, "the change must matter"


def test_questions_of_the_study_come_with_the_usual_ones(field, tmp_path):
    folder = line_by_line(field, tmp_path / "beam")
    asked = [NARROW, {"fix": {"tilt": 0.025}, **WIDER}, {"measure": {"currents": {"width": 0.1}}, "noise": {"sd": 1}}]
    with (folder / "study.yaml").open("a") as file:
        file.write(f"what_if: {json.dumps(asked)}\n")
    study = sl.load_study(folder)
    assert study.results == "current", "a question makes no result outdated"
    content = what_if(study).content
    by_name = {one["name"]: one for one in content["alternatives"]}
    assert len(by_name) == 10
    several = by_name["tilt known to be 0.025, other noise"]
    assert (several["kind"], several["about"]) == ("several", "what is known of tilt and the noise")
    assert several["detail"].startswith("point sd 9 µm")
    softer, cut = by_name["a softer beam"], 1 - np.diff(norm.cdf([300.0, 560.0], 350.0, 20.0))[0]
    assert softer["detail"] == "E: normal [350, 20]"
    assert softer["mass_cut"]["E"] == pytest.approx(cut, abs=1e-6)


def test_conditions_are_left_out(two_loads, copy_of):
    study = sl.load_study(copy_of(two_loads))
    (found,) = (one for one in what_if(study).content["alternatives"] if one["name"] == "without condition heavy")
    assert found["inputs"]["E"]["sd_ratio"] > 1.5
    with pytest.raises(InvalidStudy, match="at least one condition left"):
        what_if(study, [{"without": ["light", "heavy"]}])


def test_a_study_that_learns_the_log_likelihood(beam, copy_of, monkeypatch):
    """Both sides of each comparison go through the surrogate of the interface."""
    study = sl.load_study(copy_of(beam))
    found = what_if(study, [{"noise": {"sd": 0.003}}])
    assert found.content["surrogate"]["shift"] < 0.2
    assert found.found[0].moved == ()

    def refuse(*given):
        raise NoCommonPoints("interfaces", value="open and closed ones", expected="alike", remedy="None.")

    monkeypatch.setattr("strandline.questions.knowledge.known_field", refuse)
    content = what_if(study).content
    assert {one["kind"] for one in content["alternatives"]} == {"prior"}
    words = "Only other priors were tried: there is no surrogate of the interface (open and closed ones)."
    assert words in content["remarks"]
    none = what_if(study, [{"noise": {"sd": 0.01}}]).content
    assert none["conclusion"] == "None of the alternatives can be computed without new runs."


def test_the_command_prints_what_it_writes(field, copy_of, capsys):
    folder, same = copy_of(field), "prior: {E: {uniform: [300, 559.9]}}"
    main(["what-if", str(folder), "--ask", "{noise: {sd: 12, unit: um}}", "--ask", same])
    shown = capsys.readouterr()
    content = json.loads((folder / "what-if.json").read_text("utf-8"))
    assert content["conclusion"] == "The posterior depends on the noise and on nothing else that was tried."
    for words in (content["conclusion"], f"page: {folder / 'what-if.html'}"):
        assert words in shown.out
    item = content["alternatives"][0]["inputs"]["tilt"]
    (row,) = (line for line in shown.out.splitlines() if line.startswith("other noise"))
    assert f"{item['shift']:+.2f} sd ×{item['sd_ratio']:.2f}" in row
    main(["what-if", str(folder), "--ask", same, "--quiet"])
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "The posterior depends on nothing that was tried: no mean moves by more than 0.2 sd" in shown.out


REFUSED = [
    ({"name": "nothing"}, "at least one of prior, noise, measure, fix, without"),
    ({"noise": {"sd": "unknown", "unit": "um"}, "measure": "tracked_points"}, "the measure TrackedPoints"),
    ({"prior": {"F": {"normal": [1, 1]}}}, "what_if: name of an input: got F; expected one of E, tilt"),
    ({"prior": {"E": {"uniform": [600, 700]}}}, "keeps no mass"),
    ({"fix": {"E": 900}}, "what_if.fix.E: got 900.0; expected a value in its box, [300, 560]"),
    ({"fix": {"E": 400}}, "at least one calibrated input left"),
    ({"fix": {"tilt": 0.01}, "prior": {"tilt": {"normal": [0.02, 0.01]}}}, "what_if.fix: got tilt"),
    ({"measure": "closest"}, "closest"),
    ({"without": ["light"]}, "several conditions: the study has one"),
]


def test_alternatives_that_do_not_fit_are_refused(field):
    study = sl.load_study(field.folder)
    now = baseline(field.outcome.calibration.posterior, field_knowledge(study, "normal_offset"), why_not="")
    for given, words in REFUSED:
        with pytest.raises(InvalidInput) as caught:
            alternative_of(checked(WhatIf, given, PLACE), study, now)
        assert words in str(caught.value)
    begun = []
    for given in ({"noise": {"sd": -5, "unit": "um"}}, {"measure": "closest"}):
        with pytest.raises(InvalidInput):
            sl.what_if(study, [given], observer=sl.Observer(stage=begun.append))
    assert not begun
