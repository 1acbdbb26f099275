"""Other assumptions of a study: files, the command, the key, and what is refused; a changed study as the oracle."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.stats import norm
from tests.questions.pages import Check, described_in, keys_of

import strandline as sl
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy, NoCommonPoints
from strandline.questions.what_if.study_what_if import what_if
from strandline.runs import Ledger
from strandline.studies.progress import results_of
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study

INPUTS = {
    "E": {"prior": {"normal": [420, 60]}, "box": [300, 560], "unit": "Pa"},
    "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True},
}
SMALL = {
    "inputs": INPUTS,
    "noise": {"sd": 0.008},
    "discrepancy": [{"tracked_points": {}}, {"normal_offset": {}}],
    "surrogate": {"field": {}},
    "design": {"sobol": {"runs": 24}},
    "sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}, "cut": {"values": 2}},
}
NARROW = {"prior": {"E": {"normal": [350, 20]}}, "name": "a softer beam"}
FILES = ("what-if.json", "what-if.html")


def without_figures(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study that learns the interface, with a nuisance input and two measures."""
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        folder = write_study(tmp_path_factory.mktemp("what-if") / "beam", **SMALL)
        change(folder)
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return folder


def runs_in(folder: Path) -> int:
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def change(folder: Path, **keys: Any) -> None:
    content = yaml.safe_load((folder / "study.yaml").read_text("utf-8"))
    (folder / "study.yaml").write_text(yaml.safe_dump({**content, **keys}, sort_keys=False), encoding="utf-8")


def mass_cut(sd: float) -> float:
    return float(1 - np.diff(norm.cdf([300.0, 560.0], 420.0, sd))[0])


def test_what_it_writes(folder: Path) -> None:
    before = runs_in(folder)
    found = sl.what_if(sl.load_study(folder))
    content = json.loads((folder / "what-if.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert runs_in(folder) == before
    names = [one["name"] for one in content["alternatives"]]
    assert set(names) == {
        "prior of E half as wide",
        "prior of E twice as wide",
        "prior of E flat in its box",
        "prior of E flat in its logarithm",
        "prior of tilt half as wide",
        "tilt known to be 0.02",
        "noise half as large",
        "noise twice as large",
        "measure normal_offset",
    }
    moving = [one["moves"] for one in content["alternatives"]]
    assert moving == sorted(moving, reverse=True)
    assert any(moving)
    assert "the noise" in content["conclusion"]
    assert content["conclusion"].endswith("and on nothing else that was tried.")
    assert content["surrogate"]["runs"] == 24
    assert content["surrogate"]["shift"] < 1e-9
    assert content["remarks"] == ["The posterior is the joint one, in which the data inform the nuisance inputs too."]
    known = next(one for one in content["alternatives"] if one["kind"] == "fix")
    assert list(known["inputs"]) == ["E"]
    assert known["log_evidence_change"] is not None
    noise = next(one for one in content["alternatives"] if one["kind"] == "noise")
    assert noise["log_evidence_change"] is None
    wide = next(one for one in content["alternatives"] if one["name"] == "prior of E twice as wide")
    assert wide["mass_cut"]["E"] == pytest.approx(mass_cut(120.0), abs=1e-6)
    page = found.page.read_text("utf-8")
    for words in (
        content["conclusion"],
        "24 runs",
        'id="what_if"',
        "outside the box",
        "new draws",
        "<td>known</td>",
    ):
        assert words in page
    assert "<script" not in page
    assert page.count("<img ") == page.count('src="data:image/png') == 1
    assert sorted(path.name for path in (folder / "figures").glob("what*")) == ["what_if.pdf", "what_if.png"]
    assert repr(found) == f"<StudyWhatIf of beam: {content['conclusion']}>"


CHANGES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "prior": (NARROW, {"inputs": {**INPUTS, "E": {**INPUTS["E"], "prior": {"normal": [350, 20]}}}}),
    "noise": ({"noise": {"sd": 0.05}}, {"noise": {"sd": 0.05}}),
    "points": (
        {"noise": {"sd": 3, "unit": "um"}, "measure": "normal_offset"},
        {"noise": {"sd": 3, "unit": "um"}, "discrepancy": {"normal_offset": {}}},
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_the_changed_study_gives_the_same_posterior(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run on its own: another sampler, from the prior, with a surrogate learnt for it."""
    asked, changes = CHANGES[name]
    (answer,) = what_if(sl.load_study(folder), [asked]).answers
    without_figures(monkeypatch)
    changed = write_study(folder.parent / "changed", **{**SMALL, **changes}, reuse=["../beam"])
    posterior = sl.run_study(sl.load_study(changed), executor=sl.InProcess()).calibration.posterior
    draws = answer.draws
    assert draws is not None
    errors = posterior.sd * np.sqrt(1 / posterior.ess + 1 / answer.effective)
    assert (np.abs(draws.mean - posterior.mean) < 4 * errors).all()
    assert (np.abs(draws.sd / posterior.sd - 1) < 4 * errors / posterior.sd).all()
    far = np.abs(answer.present.mean - posterior.mean) / errors + np.abs(answer.present.sd / posterior.sd - 1) / 0.05
    assert far.max() > 8, "the change must matter"


def test_questions_of_the_study_come_with_the_usual_ones(folder: Path) -> None:
    both = {"fix": {"tilt": 0.025}, "noise": {"sd": 0.03}}
    change(folder, what_if=[NARROW, both, {"measure": {"currents": {"width": 0.1}}}])
    study = sl.load_study(folder)
    assert results_of(study) == "current", "a question makes no result outdated"
    found = what_if(study)
    by_name = {one["name"]: one for one in found.content["alternatives"]}
    assert len(by_name) == 12
    assert by_name["a softer beam"]["detail"] == "E: normal [350, 20]"
    found_both = by_name["tilt known to be 0.025, other noise"]
    assert (found_both["kind"], found_both["about"]) == ("several", "what is known of tilt and the noise")
    assert found_both["detail"] == "noise variance 0.0009"
    assert by_name["measure currents"]["kind"] == "measure"
    assert [one.alternative.name for one in what_if(study, [NARROW]).answers] == ["a softer beam"]


def test_conditions_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_figures(monkeypatch)
    sampler = {"sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}}, "surrogate": {"field": {}}}
    folder = write_study(tmp_path / "two", **{**TWO_LOADS_STUDY, **sampler})
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    content = what_if(sl.load_study(folder)).content
    names = {one["name"]: one for one in content["alternatives"]}
    assert names["without condition heavy"]["inputs"]["E"]["sd_ratio"] > 1.5
    assert names["without condition heavy"]["moves"]
    study = sl.load_study(folder)
    with pytest.raises(InvalidStudy, match="at least one condition left"):
        what_if(study, [{"without": ["light", "heavy"]}])
    with pytest.raises(InvalidStudy, match=r"what_if\.without: got hvy; expected one of light, heavy"):
        what_if(study, [{"without": ["hvy"]}])


def test_a_study_that_learns_the_log_likelihood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both sides of each comparison go through the surrogate of the interface."""
    without_figures(monkeypatch)
    folder = write_study(tmp_path / "beam", sampler=SMALL["sampler"])
    study = sl.load_study(folder)
    sl.run_study(study, executor=sl.InProcess())
    found = what_if(study, [{"noise": {"sd": 0.003}}])
    assert found.content["surrogate"]["shift"] < 0.2
    assert found.answers[0].moved == ()
    assert found.answers[0].effective > 500

    def refuse(*given: object) -> None:
        raise NoCommonPoints("interfaces", value="open and closed ones", expected="alike", remedy="None.")

    monkeypatch.setattr("strandline.questions.knowledge.known_field", refuse)
    content = what_if(study).content
    assert {one["kind"] for one in content["alternatives"]} == {"prior"}
    words = "Only other priors were tried: there is no surrogate of the interface (open and closed ones)."
    assert words in content["remarks"]
    assert content["surrogate"] is None
    none = what_if(study, [{"noise": {"sd": 0.01}}])
    assert none.content["conclusion"] == "None of the alternatives can be computed without new runs."
    assert "`reuse: [../beam]`" in none.content["remarks"][0]
    assert "needs new runs: there is no surrogate" in none.page.read_text("utf-8")


def test_every_key_is_described(folder: Path) -> None:
    found = what_if(sl.load_study(folder)).content
    named = {
        "versions": "PACKAGE", "present.inputs": "NAME", "alternatives[].mass_cut": "NAME",
        "alternatives[].inputs": "NAME",
    }  # fmt: skip
    assert described_in("what-if.md") - {"alternatives", "surrogate"} == keys_of(found, named)


class TestCommand:
    def test_it_prints_what_it_writes(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["what-if", str(folder), "--ask", "{noise: {sd: 0.05}}", "--ask", "prior: {E: {normal: [420, 60.1]}}"])
        shown = capsys.readouterr()
        content = json.loads((folder / "what-if.json").read_text("utf-8"))
        assert shown.err.splitlines() == ["surrogate …", "alternatives …", "  2 of 2", "figures and report …"]
        assert "beam: 2 alternatives, no forward run" in shown.out
        assert content["conclusion"] == "The posterior depends on the noise and on nothing else that was tried."
        assert content["conclusion"] in shown.out
        noise, prior = content["alternatives"]
        (row,) = (line for line in shown.out.splitlines() if line.startswith("other noise"))
        item = noise["inputs"]["tilt"]
        assert f"tilt {item['shift']:+.2f} sd ×{item['sd_ratio']:.2f}" in row
        (row,) = (line for line in shown.out.splitlines() if line.startswith("another prior of E"))
        assert "reweighting" in row
        assert f"{prior['k_hat']:.2f}" in row
        assert "– (" in row
        assert f"page: {folder / 'what-if.html'}" in shown.out
        main(["what-if", str(folder), "--ask", "prior: {E: {normal: [420, 60.1]}}", "--quiet"])
        again = capsys.readouterr()
        assert again.err == ""
        assert "The posterior depends on nothing that was tried: no mean moves by more than 0.2 sd" in again.out

    def test_the_doctor_notices_another_study(
        self, folder: Path, noticed_by_doctor: Callable[[str, str], None]
    ) -> None:
        what_if(sl.load_study(folder), [NARROW])
        noticed_by_doctor("what-if.json", "strandline what-if")


REFUSED: list[tuple[list[str], str | None, str]] = [
    (["--seed", "-1"], None, "--seed"),
    (["--ask", "noise"], None, "--ask: got noise; expected keys with values"),
    (["--ask", "{nose: {sd: 1}}"], None, "unknown key: got what_if.nose; expected one of name, prior, noise,"),
    (["--ask", "{name: nothing}"], None, "at least one of prior, noise, measure, fix, without"),
    (["--ask", "{noise: {sd: -1}}"], None, "what_if.noise.sd: got -1"),
    (["--ask", "{noise: {sd: unknown, unit: um}}"], None, "the measure TrackedPoints"),
    (["--ask", "{prior: {F: {normal: [1, 1]}}}"], None, "what_if: name of an input: got F; expected one of E, tilt"),
    (["--ask", "{prior: {E: {normal: [1]}}}"], None, "what_if.prior.E.normal: got [1.0]"),
    (["--ask", "{prior: {E: {norml: [1, 1]}}}"], None, "norml"),
    (["--ask", "{prior: {E: {uniform: [600, 700]}}}"], None, "keeps no mass"),
    (["--ask", "{fix: {E: 900}}"], None, "what_if.fix.E: got 900.0; expected a value in its box, [300, 560]"),
    (["--ask", "{fix: {E: 400}}"], None, "at least one calibrated input left"),
    (["--ask", "{fix: {tilt: 0.01}, prior: {tilt: {normal: [0.02, 0.01]}}}"], None, "what_if.fix: got tilt"),
    (["--ask", "{measure: closest}"], None, "closest"),
    ([], "ledger.sqlite", "the study is not finished: got 0 of 25 forward runs done"),
    ([], "posterior.nc", "the study has no posterior to compare with"),
]


@pytest.mark.parametrize(("options", "without", "words"), REFUSED)
def test_what_is_refused(options: list[str], without: str | None, words: str, folder: Path, refused: Check) -> None:
    if without is not None:
        (folder / without).unlink()
    refused(["what-if", str(folder), "--quiet", *options], words, folder)


def test_a_negative_seed_is_refused(folder: Path) -> None:
    with pytest.raises(InvalidInput, match="seed of what-if"):
        what_if(sl.load_study(folder), seed=-1)


def test_a_wrong_question_is_found_when_the_study_is_loaded(folder: Path) -> None:
    change(folder, what_if=[{"nose": {"sd": 1}}])
    with pytest.raises(InvalidStudy, match=r"unknown key: got what_if.0.nose; expected one of name, prior, noise"):
        sl.load_study(folder)
    assert "what_if" not in BEAM_STUDY
