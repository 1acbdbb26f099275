"""What the page is told of a study: its runs, its posterior, what other assumptions give and how they are saved."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.study.conftest import Finished

import strandline as sl
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.testing.studies import write_study
from strandline.view import viewed as module
from strandline.view.assumptions import Asked, answer_to, asked_by, knobs_of, save_as
from strandline.view.viewed import ViewedStudy

Copy = Callable[[Finished], Path]


def opened(folder: Path) -> ViewedStudy:
    """Return a study as the page sees it once it has the runs and the posterior."""
    viewed = ViewedStudy(sl.load_study(folder))
    viewed.feed.update()
    viewed.newest.refresh(viewed.feed.succeeded)
    return viewed


@pytest.fixture(scope="module")
def viewed(field: Finished) -> ViewedStudy:
    return opened(field.folder)


def digests(folder: Path) -> dict[str, str]:
    files = [one for one in folder.iterdir() if one.is_file() and not one.name.endswith(("-shm", "-wal", ".lock"))]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_it_says_what_the_study_says_and_changes_nothing(viewed: ViewedStudy, field: Finished) -> None:
    before = digests(field.folder)
    facts = viewed.facts
    assert (facts["name"], facts["fixed"], facts["flow"]) == ("beam", {"load": 1e-5}, False)
    assert [(one["name"], one["nuisance"]) for one in facts["inputs"]] == [("E", False), ("tilt", True)]
    posterior, summary = viewed.posterior, json.loads((field.folder / "summary.json").read_text("utf-8"))
    assert (posterior["source"], posterior["why_none"], len(posterior["history"])) == ("stored", "", 1)
    for name, item in summary["inputs"].items():
        assert posterior["mean"][name] == pytest.approx(item["mean"], abs=0.1 * item["sd"])
        assert posterior["sd"][name] == pytest.approx(item["sd"], rel=0.06)
    runs, run = viewed.feed.since(0), viewed.run(3)
    assert (runs["total"], set(runs["state"])) == (33, {"ok"})
    assert run["inputs"]["E"] == pytest.approx(runs["inputs"]["E"][3], rel=1e-5)
    assert [place for place in range(33) if (viewed.run(place) or {})["observes"]] == [0]
    state = viewed.state
    assert (state["ok"], state["results"], state["edited"]) == (32, "current", False)
    assert state["summary"]["misfit"]["verdict"] == summary["misfit"]["verdict"]
    json.dumps([facts, posterior, runs, run, state], allow_nan=False)
    assert digests(field.folder) == before


def test_other_assumptions_are_those_of_what_if(viewed: ViewedStudy, field: Finished, copy_of: Copy) -> None:
    """The slider says what the command says, by other weights or by new draws, which are judged by all of them."""
    study = sl.load_study(copy_of(field))
    asked = {"noise": 1.5, "priors": {"E": {"normal": [420.0, 30.0]}}}
    narrow = {"E": {"normal": [380.0, 12.0]}}
    truth = sl.what_if(study, [{"noise": {"sd": 4.5, "unit": "um"}, "prior": asked["priors"]}, {"prior": narrow}])
    answers = {one.alternative.kind: one for one in truth.found}
    both = answers["several"].draws
    quick, again = viewed.ask(asked, again=False), viewed.ask(asked, again=True)
    for found in (quick, again):
        for k, name in enumerate(study.space.names):
            assert found["mean"][name] == pytest.approx(both.mean[k], abs=0.15 * both.sd[k])
            assert found["sd"][name] == pytest.approx(both.sd[k], rel=0.12)
    assert (quick["by"], quick["effective"] > 100, len(quick["weights"])) == ("reweighting", True, 2000)
    fixed = viewed.ask({"fixed": {"tilt": 0.01}}, again=False)
    assert set(fixed["draws"]["tilt"]) == {0.01}
    found, answer = viewed.ask({"priors": narrow}, again=True), answers["prior"]
    assert (found["by"], found["k_hat"]) == (answer.by, pytest.approx(answer.k_hat))
    assert (found["mean"]["E"], len(found["draws"]["E"])) == (pytest.approx(float(answer.draws.mean[0])), 2000)


REFUSED = [
    ("predict", {"E": 430}, "tilt: got nothing; expected a number from 0 to 0.04"),
    ("ask", {"noise": 0}, "noise: got 0; expected a number greater than or equal to 0.2"),
    ("ask", {"measure": "currents"}, "measure: got currents; expected one of normal_offset, tracked"),
    ("ask", {"fixed": {"E": 400}}, "at least one calibrated input left"),
    ("ask", {"fixed": {"tilt": 0.05}}, "tilt: got 0.05; expected a number from 0 to 0.04"),
    ("flow", {"E": 400, "tilt": 0.01}, "expected a model that offers its fields"),
]


def test_what_makes_no_sense_is_refused(viewed: ViewedStudy) -> None:
    for name, given, words in REFUSED:
        options: dict[str, Any] = {"ask": {"again": False}, "flow": {"condition": ""}}.get(name, {})
        with pytest.raises(InvalidInput, match=words) as caught:
            getattr(viewed, name)(given, **options)
        assert "\n" not in str(caught.value)


def test_an_answer_is_of_one_posterior(field: Finished, copy_of: Copy, monkeypatch: pytest.MonkeyPatch) -> None:
    """The posterior of fewer runs is ready while the earlier one is being told."""
    viewed = opened(copy_of(field))
    study = viewed.study

    def meanwhile(*given: Any) -> Any:
        monkeypatch.setattr(module, "knobs_of", knobs_of)
        with study.runs.ledger() as ledger:
            ledger.exclude(study.runs.design_keys[3], "looks wrong")
        viewed.newest.refresh(viewed.feed.succeeded - 1)
        return knobs_of(*given)

    monkeypatch.setattr(module, "knobs_of", meanwhile)
    for told, made in ((viewed.posterior, 1), (viewed.posterior, 2)):
        assert len(told["history"]) == made
        for name, one in told["history"][-1]["mean"].items():
            assert told["mean"][name] == pytest.approx(one, rel=1e-12)
    viewed.feed.update()
    assert viewed.run(viewed.feed.since(0)["state"].index("excluded"))["excluded"] == "looks wrong"


def test_a_study_without_runs_and_its_posterior_that_is_due_after_a_tenth_more_of_them(tmp_path: Path) -> None:
    viewed = ViewedStudy(sl.load_study(write_study(tmp_path)))
    feed = viewed.newest
    assert [feed.due(made) for made in (3, 4)] == [False, True]
    feed._tried = 100
    assert [feed.due(made) for made in (109, 110)] == [False, True]
    assert viewed.posterior["why_none"] == "too few forward runs have ended yet"
    for ask in (lambda: viewed.ask({"noise": 2.0}, again=False), lambda: viewed.predict({"E": 400, "tilt": 0.0})):
        with pytest.raises(InvalidInput, match="too few forward runs have ended yet"):
            ask()
    viewed.require_ledger()
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(InvalidStudy, match=r"no file .*ledger\.sqlite"):
        viewed.require_ledger()


def test_the_new_study_gives_the_posterior_that_the_page_showed(field: Finished, copy_of: Copy) -> None:
    folder = copy_of(field)
    study, now = sl.load_study(folder), opened(folder).newest.shown.now
    asked = asked_by({"noise": 2.0, "length_um": 20.0, "priors": {"E": {"normal": [420.0, 30.0]}}}, study)
    shown = answer_to(asked, study, now, again=True).draws
    target = save_as(study, "wider", asked)
    noise = sl.load_study(target).noise
    assert (noise.sd, noise.length) == (pytest.approx(0.006), pytest.approx(0.02))
    assert not (target / "posterior.nc").exists()
    text = (target / "study.yaml").read_text()
    (target / "study.yaml").write_text(text.replace('"draft": true', '"draft": true, "report": "none"'))
    calibration = sl.run_study(sl.load_study(target), executor=sl.InProcess()).calibration
    assert not calibration.made
    sd = calibration.posterior.sd
    assert (np.abs(shown.mean - calibration.posterior.mean) < 0.15 * sd).all()
    np.testing.assert_allclose(shown.sd, sd, rtol=0.12)


def test_what_cannot_be_saved_leaves_nothing_and_other_inputs_can(field: Finished, copy_of: Copy) -> None:
    folder = copy_of(field)
    before, study = sorted(folder.parent.iterdir()), sl.load_study(folder)
    for name in ("", "../there", ".hidden", "a" * 64, "a\nb", folder.name):
        with pytest.raises(InvalidInput, match="name of the new study"):
            save_as(study, name, Asked())
    with pytest.raises(InvalidInput):
        save_as(study, "wrong", Asked(priors={"E": {"uniform": [0.0, 1000.0]}}))
    assert sorted(folder.parent.iterdir()) == before
    asked = asked_by({"fixed": {"tilt": 0.02}, "measure": "tracked_points"}, study)
    other = sl.load_study(save_as(study, "known", asked))
    assert (other.space.names, other.fixed) == (("E",), {"load": 1e-5, "tilt": 0.02})
    assert next(iter(other.discrepancies)) == "tracked_points"
