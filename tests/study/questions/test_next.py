"""The next experiment of a study, against nested Monte Carlo with the true model."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.study.questions.conftest import content_of, line_by_line

import strandline as sl
from strandline.cli import main
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.questions import observing
from strandline.testing.models import TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, write_study
from strandline.testing.studies import beam as true_beam

NEXT = {"load": [0.5e-5, 1e-5, 2e-5, 3e-5], "together": 2}
SD, X = 0.003, np.linspace(0.0, 1.0, 17)
DRAFT = {"draft": True, "report": "none"}


@pytest.fixture(scope="module")
def answered(beam, tmp_path_factory):
    """A study with enough particles that lists candidates, and what each is expected to teach."""
    folder = line_by_line(beam, tmp_path_factory.mktemp("next") / "beam")
    text = (folder / "study.yaml").read_text("utf-8").replace('"particles": 1000', '"particles": 2000')
    (folder / "study.yaml").write_text(f"{text}report: none\n")
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    ask(folder, NEXT)
    before = (folder / "ledger.sqlite").read_bytes()
    found = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess())
    assert (folder / "ledger.sqlite").read_bytes() == before
    return folder, found


def ask(folder, candidates):
    """Give study.yaml other candidates, on a line of their own."""
    lines = (folder / "study.yaml").read_text("utf-8").splitlines()
    kept = [line for line in lines if line and not line.startswith("next: ")]
    (folder / "study.yaml").write_text("\n".join([*kept, "", f"next: {json.dumps(candidates)}", ""]))


def points(young, tilt, load):
    return true_beam({"E": young, "tilt": tilt, "load": load}, Path()).interface.points


def true_gain(draws, loads):
    """Return the expected information gain from the true model at draws, by nested Monte Carlo."""
    signals = np.array([np.ravel([points(*draw, load) for load in loads]) for draw in draws]) / SD
    seen = signals + np.random.default_rng(8).standard_normal(signals.shape)
    logs = seen @ signals.T - 0.5 * (signals**2).sum(axis=1) - 0.5 * (seen**2).sum(axis=1)[:, None]
    own = np.diag(logs).copy()
    np.fill_diagonal(logs, -np.inf)
    return float(np.mean(own - logsumexp(logs, axis=1) + np.log(len(draws) - 1)))


def asked(folder, **options):
    return sl.next_experiment(sl.load_study(folder), executor=sl.InProcess(), **options).content


def by_loads(content):
    return {tuple(s.get("load", 1e-5) for s in one["settings"]): one for one in content["candidates"]}


def test_gains_of_other_loads_and_pairs_are_those_of_the_true_model(answered):
    folder, experiment = answered
    found = by_loads(experiment.content)
    draws = np.unique(sl.load_result(folder).posterior.equally_weighted(5), axis=0)
    draws = np.random.default_rng(5).permutation(draws)[:700]
    for loads in [(0.5e-5,), (1e-5,), (2e-5,), (0.5e-5, 3e-5), (2e-5, 2e-5)]:
        assert found[loads]["gain"] == pytest.approx(true_gain(draws, loads), abs=0.12), loads
        assert found[loads]["by"] == "nested Monte Carlo"


def test_what_it_writes(answered):
    found = answered[1]
    content = content_of(found, 2, found.content["advice"].split(":")[0])
    assert content["runs"] == {"new": 9, "reused": 0}  # three loads without sensitivities: one run and one per input
    assert [one["label"] for one in content["candidates"][:2]] == ["load 3e-05", "load 2e-05"]
    assert content["advice"].startswith("Choose load 3e-05: ")
    unknown = {"fails": "failing", "moved, sd": "displacement_in_sd"}
    for column, key in unknown.items():
        assert (column in found.table.head) == any(one[key] is not None for one in content["candidates"])


def test_the_command_makes_no_run_twice_and_a_seed_decides_the_gains(folder, answered, monkeypatch, capsys):
    """Planted at the end: the candidate's slopes are half as large as they are, which costs a quarter of a nat."""
    first = answered[1].content
    main(["next", str(folder), "--quiet"])
    printed, again = capsys.readouterr().out, json.loads((folder / "next.json").read_text("utf-8"))
    assert again["runs"] == {"new": 0, "reused": 9}
    assert again["candidates"] == json.loads(json.dumps(first["candidates"]))
    assert re.search(r"^load 3e-05 +\d\.\d\d ", printed, re.MULTILINE)
    assert "0 new forward runs, 9 known; " in printed
    assert printed.rstrip().endswith("next.html")
    ask(folder, {"load": [2e-5, 3e-5]})
    other = by_loads(asked(folder, seed=2))[(2e-5,)]["gain"]
    assert 0 < abs(by_loads(first)[(2e-5,)]["gain"] - other) < 0.15
    transfer = observing.transfer
    half = lambda s, at, field, slopes, c: transfer(s, at, field, 0.5 * slopes, c)  # noqa: E731
    monkeypatch.setattr(observing, "transfer", half)
    assert by_loads(asked(folder))[(3e-5,)]["gain"] < by_loads(first)[(3e-5,)]["gain"] - 0.2


def test_what_is_refused_before_any_run_and_an_experiment_whose_run_fails_comes_last(folder):
    (folder / "next.sqlite").unlink()
    ask(folder, {"load": [2e-5], "part": [[0, 0.05]]})
    with pytest.raises(InvalidInput, match="part of the interface to look at"):
        asked(folder)
    assert not (folder / "next.sqlite").exists()
    ask(folder, {})
    with pytest.raises(InvalidStudy, match=r"lists no candidates.*next: \{load: \[1e-05, 2e-05\]\}"):
        asked(folder)
    ask(folder, {"load": [1.0, 2e-5]})
    first, last = asked(folder)["candidates"]
    assert (first["label"], last["gain"]) == ("load 2e-05", None)
    assert last["problem"].startswith("its run failed: large_deflection: the tip would move by")
    ask(folder, {"load": [1.0]})
    assert asked(folder)["advice"] == "Every candidate's run failed."


def widths(E):
    """Return the widths after an observation of the beam, with normal priors of the same sd."""
    slopes = np.stack([-20 / E**2 * X**2 * (3 - X), X], axis=1) / SD
    prior = np.diag(12 / np.array([260.0, 0.04]) ** 2)
    return np.sqrt(np.diag(np.linalg.inv(prior + slopes.T @ slopes)))


def test_before_any_data_the_prior_takes_the_place_of_the_posterior(tmp_path):
    """The beam is linear in 1/E and the tilt: the widths follow from its slopes at the draws of the prior."""
    folder = write_study(tmp_path / "beam", next=NEXT, **DRAFT)
    content, space = asked(folder), sl.load_study(folder).space
    found = {one["label"]: one for one in content["candidates"]}
    assert content["source"] == "prior"
    expected = np.mean([widths(x[0]) for x in space.prior_quantiles(sl.sobol(8, 2, scramble=0))], axis=0)
    np.testing.assert_allclose([found["as planned"]["sd"][name] for name in ("E", "tilt")], expected, rtol=0.03)
    assert found["load 3e-05"]["gain"] > found["as planned"]["gain"] > found["load 5e-06"]["gain"]
    assert {one["by"] for one in found.values()} == {"linearised"}
    assert content["identifiability"][0].startswith("The planned picture would determine tilt up and E up")
    assert not (folder / "ledger.sqlite").exists()


def test_a_condition_that_is_not_observed_can_be_asked_about_and_unknown_noise_is_guessed(tmp_path):
    seen = TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces["light"]
    np.savetxt(tmp_path / "light.csv", seen.points, delimiter=",")
    observation = [{"condition": "light", "file": "../light.csv", "unit": "mm"}]
    by = {"noise": {"sd": "unknown", "unit": "um"}, "discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
    changes = {**TWO_LOADS_STUDY, **DRAFT, **by, "observation": observation, "next": {"condition": [["heavy"]]}}
    content = asked(write_study(tmp_path / "two", **changes), runs=4)
    heavy, planned = content["candidates"]
    assert (heavy["label"], planned["label"]) == ("condition heavy", "as planned")
    assert heavy["gain"] > planned["gain"] > 0
    assert content["noise"][0]["in_words"].endswith(" µm, a guess: the study does not know its noise")
