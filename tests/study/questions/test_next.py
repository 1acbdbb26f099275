"""The next experiment of a study, against nested Monte Carlo with the true model."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.study.questions.conftest import content_of, described_in, line_by_line

import strandline as sl
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy
from strandline.planning import forecast
from strandline.runs import Ledger
from strandline.testing.models import TwoLoads
from strandline.testing.studies import BEAM_STUDY, TWO_LOADS_STUDY, write_study
from strandline.testing.studies import beam as true_beam

LOADS = (0.5e-5, 1e-5, 2e-5, 3e-5)
NEXT = {"load": list(LOADS), "together": 2}
SD = 0.003
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


def true_gain(draws, loads, nodes=slice(None)):
    """Return the expected information gain from the true model at draws, by nested Monte Carlo."""
    signals = np.array([np.ravel([points(*draw, load)[nodes] for load in loads]) for draw in draws]) / SD
    seen = signals + np.random.default_rng(8).standard_normal(signals.shape)
    logs = seen @ signals.T - 0.5 * (signals**2).sum(axis=1) - 0.5 * (seen**2).sum(axis=1)[:, None]
    own = np.diag(logs).copy()
    np.fill_diagonal(logs, -np.inf)
    return float(np.mean(own - logsumexp(logs, axis=1) + np.log(len(draws) - 1)))


def some_draws(folder):
    """Return draws of the posterior, all different."""
    draws = np.unique(sl.load_result(folder).posterior.equally_weighted(5), axis=0)
    return np.random.default_rng(5).permutation(draws)[:700]


def asked(folder, **options):
    return sl.next_experiment(sl.load_study(folder), executor=sl.InProcess(), **options).content


def by_label(content):
    return {one["label"]: one for one in content["candidates"]}


def by_loads(content):
    return {tuple(s.get("load", 1e-5) for s in one["settings"]): one for one in content["candidates"]}


def test_gains_of_other_loads_and_pairs_are_those_of_the_true_model(answered):
    folder, experiment = answered
    found, draws = by_loads(experiment.content), some_draws(folder)
    for loads in [(load,) for load in LOADS] + [(0.5e-5, 3e-5), (2e-5, 2e-5)]:
        assert found[loads]["gain"] == pytest.approx(true_gain(draws, loads), abs=0.12), loads
        assert found[loads]["by"] == "nested Monte Carlo"


def test_what_it_writes(answered):
    folder, found = answered
    content = content_of(found, 2, found.content["advice"].split(":")[0])
    assert content["runs"] == {"new": 9, "reused": 0}  # three loads without sensitivities: one run and one per input
    with Ledger.open(folder / "next.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 9
    assert [one["label"] for one in content["candidates"][:2]] == ["load 3e-05", "load 2e-05"]
    assert content["advice"].startswith("Choose load 3e-05: ")
    described = {part for key in described_in("next.md") for part in re.split(r"[.\[\]]+", key)}
    firsts = (content["candidates"][0], content["noise"][0], content["directions"][0], content["inputs"]["E"])
    assert {key for part in (content, *firsts) for key in part} <= described


def test_runs_are_made_once_and_a_seed_decides_the_gains(folder, answered, monkeypatch):
    """Planted at the end: the candidate's slopes are half as large as they are, which costs a quarter of a nat."""
    first, again = answered[1].content, asked(folder)
    ask(folder, {"load": [2e-5, 3e-5]})
    other = by_loads(asked(folder, seed=2))[(2e-5,)]["gain"]
    assert again["runs"] == {"new": 0, "reused": 9}
    assert again["candidates"] == first["candidates"]
    assert 0 < abs(by_loads(first)[(2e-5,)]["gain"] - other) < 0.15
    transfer = forecast.transfer
    monkeypatch.setattr(forecast, "transfer", lambda s, at, field, slopes, c: transfer(s, at, field, 0.5 * slopes, c))
    assert by_loads(asked(folder))[(3e-5,)]["gain"] < by_loads(first)[(3e-5,)]["gain"] - 0.2


def test_parts_points_and_errors_of_the_same_experiment_cost_no_run(folder):
    """Nine points of a half of the beam are its own nodes there; more points, or better ones, tell more."""
    ask(folder, {"part": [[0, 0.5], [0.5, 1]], "points": [9, 33], "sd": [3, 1], "unit": "um"})
    content, draws = asked(folder), some_draws(folder)
    assert content["runs"] == {"new": 0, "reused": 0}
    near, far, finer, better = (
        by_label(content)[f"the same again, {part} % of the interface, {number} points, sd {sd} µm"]["gain"]
        for part, number, sd in (("0–50", 9, 3), ("50–100", 9, 3), ("50–100", 33, 3), ("50–100", 9, 1))
    )
    assert near == pytest.approx(true_gain(draws, (1e-5,), slice(None, 9)), abs=0.08)
    assert far == pytest.approx(true_gain(draws, (1e-5,), slice(8, None)), abs=0.08)
    assert far < finer < better


def test_an_experiment_whose_run_fails_comes_last_with_its_reason(folder):
    """Candidates may be replaced at any time: no result depends on them."""
    ask(folder, {"load": [2e-5, 1.0]})
    first, last = asked(folder)["candidates"]
    assert last["gain"] is None
    assert last["problem"].startswith("its run failed: large_deflection: the tip would move by")
    assert first["label"] == "load 2e-05"
    ask(folder, {"load": [1.0]})
    assert asked(folder)["advice"] == "Every candidate's run failed."


def test_what_is_refused_before_any_run(folder):
    (folder / "next.sqlite").unlink()
    ask(folder, {"load": [2e-5], "part": [[0, 0.05]]})
    with pytest.raises(InvalidInput, match="part of the interface to look at"):
        asked(folder)
    assert not (folder / "next.sqlite").exists()
    ask(folder, {})
    with pytest.raises(InvalidStudy, match=r"lists no candidates.*next: \{load: \[1e-05, 2e-05\]\}"):
        asked(folder)


def test_the_command_prints_what_it_writes(folder, capsys):
    main(["next", str(folder), "--quiet"])
    printed = capsys.readouterr().out
    assert "beam: the next experiment, from its posterior" in printed
    assert re.search(r"^load 3e-05 +\d\.\d\d ", printed, re.MULTILINE)
    assert "0 new forward runs, 9 known; " in printed
    assert printed.rstrip().endswith("next.html")


class TestBeforeAnyData:
    def test_the_prior_takes_the_place_of_the_posterior(self, tmp_path):
        """The beam is linear in 1/E and the tilt: the widths follow from its slopes at the draws of the prior."""
        folder = write_study(tmp_path / "beam", next=NEXT, **DRAFT)
        content = asked(folder)
        assert content["source"] == "prior"
        found = by_label(content)
        x = sl.load_study(folder).space.prior_quantiles(sl.sobol(8, 2, scramble=0))
        expected = np.mean([self.sd(row) for row in x], axis=0)
        np.testing.assert_allclose([found["as planned"]["sd"][name] for name in ("E", "tilt")], expected, rtol=0.03)
        assert found["load 3e-05"]["gain"] > found["as planned"]["gain"] > found["load 5e-06"]["gain"]
        assert {one["by"] for one in found.values()} == {"linearised"}
        assert content["identifiability"][0].startswith("The planned picture would determine tilt up and E up")
        assert not (folder / "ledger.sqlite").exists()
        assert content["noise"][0]["in_words"] == "standard deviation of each point 3 µm"

    def sd(self, x):
        """Return the widths after an observation of the beam, with normal priors of the same sd."""
        steps = np.diag([1e-3, 1e-6])
        rows = [(points(*(x + one), 1e-5) - points(*(x - one), 1e-5)).ravel() / (2 * one.sum()) for one in steps]
        slopes = np.array(rows).T / SD
        prior = np.diag(12 / np.array([260.0, 0.04]) ** 2)
        return np.sqrt(np.diag(np.linalg.inv(prior + slopes.T @ slopes)))

    def test_unknown_noise_is_guessed(self, tmp_path):
        noise = {"sd": "unknown", "unit": "um"}
        changes = {"noise": noise, "discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
        (one,) = asked(write_study(tmp_path / "beam", **changes, **DRAFT), runs=4)["noise"]
        assert one["guessed"]
        assert one["in_words"].endswith(" µm, a guess: the study does not know its noise")

    def test_combinations_that_no_picture_determines_are_named(self, tmp_path):
        """Without a known load, the beam shows only load/E."""
        load = {"prior": {"uniform": [0.6e-5, 1.2e-5]}, "unit": "N/m"}
        inputs = {**BEAM_STUDY["inputs"], "load": load}
        folder = write_study(tmp_path / "beam", inputs=inputs, fixed=None, **DRAFT)
        named, *others = [line for line in asked(folder)["identifiability"] if "could not determine" in line]
        assert named.startswith("The planned picture could not determine E up and load up (1 : 0.89)")
        assert others == []

    def test_a_condition_that_is_not_observed_can_be_asked_about(self, tmp_path):
        seen = TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces["light"]
        np.savetxt(tmp_path / "light.csv", seen.points, delimiter=",")
        observation = [{"condition": "light", "file": "../light.csv", "unit": "mm"}]
        changes = {**TWO_LOADS_STUDY, **DRAFT, "observation": observation, "next": {"condition": ["heavy"]}}
        heavy, planned = asked(write_study(tmp_path / "two", **changes), runs=4)["candidates"]
        assert (heavy["label"], planned["label"]) == ("condition heavy", "as planned")
        assert heavy["gain"] > planned["gain"] > 0


def test_conditions_can_be_repeated_alone_and_cost_no_run(two_loads, tmp_path):
    """The heavy load bends the beam 2.5 times as far, and tells E as much better."""
    folder = line_by_line(two_loads, tmp_path / "two")
    ask(folder, {"condition": ["light", "heavy"]})
    content = asked(folder)
    assert content["runs"] == {"new": 0, "reused": 0}
    heavy, light = content["candidates"]
    assert (heavy["label"], light["label"]) == ("condition heavy", "condition light")
    assert heavy["sd"]["E"] < light["sd"]["E"] < content["inputs"]["E"]["sd"]
