"""The next experiment of a study, against nested Monte Carlo with the true model, and what is refused."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.special import logsumexp

import strandline as sl
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy
from strandline.planning import forecast
from strandline.runs import Ledger
from strandline.testing.models import TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, beam, write_study

SMALL = {"sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}}}
LOADS = (0.5e-5, 1e-5, 2e-5, 3e-5)
NEXT = {"load": list(LOADS), "together": 2}
PAGE = Path(__file__).parents[2] / "docs" / "reference" / "next.md"
SD = 0.003


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study of the beam, which learns the log-likelihood."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        folder = write_study(tmp_path_factory.mktemp("next") / "beam", **SMALL)
        ask(folder, {})
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    target = tmp_path / "beam"
    shutil.copytree(finished, target)
    ask(target, NEXT)
    return target


def ask(folder: Path, candidates: dict[str, Any]) -> None:
    """Give study.yaml other candidates, on lines of their own as a user would."""
    text = (folder / "study.yaml").read_text("utf-8")
    content = {key: value for key, value in yaml.safe_load(text).items() if key != "next"}
    lines = [f"{key}: {json.dumps(value)}\n" for key, value in content.items()]
    (folder / "study.yaml").write_text("".join(lines) + f"\nnext: {json.dumps(candidates)}\n")


def true_gain(draws: np.ndarray, loads: tuple[float, ...], seed: int, nodes: slice = slice(None)) -> float:
    """Return the expected information gain from the true model at draws, by nested Monte Carlo."""

    def shown_at(young: float, tilt: float, load: float) -> np.ndarray:
        return beam({"E": young, "tilt": tilt, "load": load}, Path()).interface.points[nodes].ravel()

    shown = [np.concatenate([shown_at(*draw, load) for load in loads]) for draw in draws]
    signals = np.array(shown) / SD
    noise = np.random.default_rng(seed).standard_normal(signals.shape)
    seen = signals + noise
    logs = seen @ signals.T - 0.5 * (signals**2).sum(axis=1) - 0.5 * (seen**2).sum(axis=1)[:, None]
    own = np.diag(logs).copy()
    np.fill_diagonal(logs, -np.inf)
    return float(np.mean(own - logsumexp(logs, axis=1) + np.log(len(draws) - 1)))


def some_draws(folder: Path) -> np.ndarray:
    """Return 700 draws of the posterior, all different."""
    draws = np.unique(sl.load_result(folder).posterior.equally_weighted(5), axis=0)
    return np.random.default_rng(5).permutation(draws)[:700]


def gains(folder: Path, **options: Any) -> dict[tuple[float, ...], dict[str, Any]]:
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess(), **options).content
    return {tuple(s.get("load", 1e-5) for s in one["settings"]): one for one in content["candidates"]}


def test_gains_of_other_loads_and_pairs_are_those_of_the_true_model(folder: Path) -> None:
    found = gains(folder)
    draws = some_draws(folder)
    for loads in [(load,) for load in LOADS] + [(0.5e-5, 3e-5), (2e-5, 2e-5)]:
        assert found[loads]["gain"] == pytest.approx(true_gain(draws, loads, 8), abs=0.12), loads
        assert found[loads]["by"] == "nested Monte Carlo"


def test_slopes_of_the_wrong_experiment_are_noticed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the candidate's slopes are half as large as they are, which costs a quarter of a nat or more."""
    right = gains(folder)[(3e-5,)]["gain"]
    transfer = forecast.transfer
    monkeypatch.setattr(forecast, "transfer", lambda s, at, field, slopes, c: transfer(s, at, field, 0.5 * slopes, c))
    assert gains(folder)[(3e-5,)]["gain"] < right - 0.2


def test_what_it_writes_and_that_runs_are_made_once(folder: Path) -> None:
    before = (folder / "ledger.sqlite").read_bytes()
    found = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess())
    content = json.loads((folder / "next.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert (folder / "ledger.sqlite").read_bytes() == before
    assert content["runs"] == {"new": 9, "reused": 0}  # three loads without sensitivities: one run and one per input
    with Ledger.open(folder / "next.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().total == 9
    again = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    assert again["runs"] == {"new": 0, "reused": 9}
    assert again["candidates"] == content["candidates"]
    singles = [one["label"] for one in content["candidates"][:4]]
    assert singles[:2] == ["load 3e-05", "load 2e-05"]
    assert content["advice"].startswith("Choose load 3e-05: ")
    page = found.page.read_text("utf-8")
    assert content["advice"].split(":")[0] in page
    assert page.count("<img ") == page.count('src="data:image/png') == 2
    pictures = sorted(path.name for path in (folder / "figures").glob("next*.png"))
    assert pictures == ["next_candidates.png", "next_directions.png"]
    assert repr(found).startswith("<NextExperiment after beam: Choose load 3e-05: ")


def test_the_same_seed_gives_the_same_gains_and_another_one_does_not(folder: Path) -> None:
    first, second, other = gains(folder, seed=1), gains(folder, seed=1), gains(folder, seed=2)
    assert first == second
    assert first[(2e-5,)]["gain"] != other[(2e-5,)]["gain"]
    assert first[(2e-5,)]["gain"] == pytest.approx(other[(2e-5,)]["gain"], abs=0.15)


def test_results_stay_up_to_date_when_candidates_change(folder: Path) -> None:
    gains(folder)
    with (folder / "study.yaml").open("a", encoding="utf-8") as file:
        file.write("# none of the results depends on these\n")
    text = (folder / "study.yaml").read_text("utf-8").replace(json.dumps(NEXT), '{"load": [4e-5]}')
    (folder / "study.yaml").write_text(text)
    assert set(gains(folder)) == {(4e-5,)}


def test_parts_points_and_errors_of_the_same_experiment_cost_no_run(folder: Path) -> None:
    """Nine points of a half of the beam are its own nodes there; more points, or better ones, tell more."""
    ask(folder, {"part": [[0, 0.5], [0.5, 1]], "points": [9, 33], "sd": [3, 1], "unit": "um"})
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    assert content["runs"] == {"new": 0, "reused": 0}
    found = {one["label"]: one for one in content["candidates"]}
    near, far = (found[f"the same again, {part} % of the interface, 9 points, sd 3 µm"] for part in ("0–50", "50–100"))
    draws = some_draws(folder)
    assert near["gain"] == pytest.approx(true_gain(draws, (1e-5,), 8, slice(None, 9)), abs=0.08)
    assert far["gain"] == pytest.approx(true_gain(draws, (1e-5,), 8, slice(8, None)), abs=0.08)
    finer = found["the same again, 50–100 % of the interface, 33 points, sd 3 µm"]
    better = found["the same again, 50–100 % of the interface, 9 points, sd 1 µm"]
    assert far["gain"] < finer["gain"] < better["gain"]


def test_before_any_data_the_prior_takes_its_place(tmp_path: Path) -> None:
    """The beam is linear in 1/E and the tilt: the widths follow from its slopes at the draws of the prior."""
    folder = write_study(tmp_path / "beam", next=NEXT)
    study = sl.load_study(folder)
    content = sl.next_experiment(study, executor=sl.InProcess()).content
    assert content["source"] == "prior"
    found = {one["label"]: one for one in content["candidates"]}
    x = study.space.prior_quantiles(sl.sobol(8, 2, scramble=0))
    expected = np.mean([_sd(row, 1e-5) for row in x], axis=0)
    np.testing.assert_allclose([found["as planned"]["sd"][name] for name in ("E", "tilt")], expected, rtol=0.03)
    assert found["load 3e-05"]["gain"] > found["as planned"]["gain"] > found["load 5e-06"]["gain"]
    assert {one["by"] for one in found.values()} == {"linearised"}
    assert content["identifiability"][0].startswith("The planned picture would determine tilt up and E up")
    assert not (folder / "ledger.sqlite").exists()
    assert content["noise"][0]["in_words"] == "standard deviation of each point 3 µm"


def test_unknown_noise_is_guessed_before_any_data(tmp_path: Path) -> None:
    noise = {"sd": "unknown", "unit": "um"}
    changes = {"noise": noise, "discrepancy": {"normal_offset": {}}, "surrogate": {"field": {}}}
    folder = write_study(tmp_path / "beam", **changes)
    (one,) = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content["noise"]
    assert one["guessed"]
    assert one["in_words"].endswith(" µm, a guess: the study does not know its noise")


def _sd(x: np.ndarray, load: float) -> np.ndarray:
    """Return the widths after an observation of the beam, with normal priors of the same sd."""
    step = np.array([1e-3, 1e-6])

    def points(inputs: np.ndarray) -> np.ndarray:
        return beam({"E": inputs[0], "tilt": inputs[1], "load": load}, Path()).interface.points.ravel()

    rows = [(points(x + one) - points(x - one)) / (2 * one.sum()) for one in np.diag(step)]
    slopes = np.array(rows).T / SD
    prior = np.diag(12 / np.array([260.0, 0.04]) ** 2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(prior + slopes.T @ slopes))))


def test_combinations_that_no_picture_determines_are_named(tmp_path: Path) -> None:
    """Without a known load, the beam shows only load/E."""
    inputs = {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "load": {"prior": {"uniform": [0.6e-5, 1.2e-5]}, "unit": "N/m"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}},
    }
    folder = write_study(tmp_path / "beam", inputs=inputs, fixed=None)
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    first = "The planned picture could not determine E up and load up (1 : 0.89)"
    assert content["identifiability"][0].startswith(first)
    assert len([line for line in content["identifiability"] if "could not determine" in line]) == 1


def test_conditions_can_be_repeated_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    changes = {**TWO_LOADS_STUDY, **SMALL, "surrogate": {"field": {}}, "next": {"condition": ["light", "heavy"]}}
    folder = write_study(tmp_path / "two", **changes)
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    assert [one["label"] for one in content["candidates"]] == ["condition heavy", "condition light"]
    assert content["runs"]["new"] == 0


def test_a_condition_that_was_not_observed_yet_costs_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The heavy load bends the beam 2.5 times as far, and tells E as much better."""
    monkeypatch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
    seen = TwoLoads()({"E": 400.0, "load": 1e-5}, tmp_path).interfaces["light"]
    np.savetxt(tmp_path / "light.csv", seen.points, delimiter=",")
    observation = [{"condition": "light", "file": "../light.csv", "unit": "mm"}]
    changes = {**TWO_LOADS_STUDY, **SMALL, "observation": observation, "surrogate": {"field": {}}}
    folder = write_study(tmp_path / "two", **changes, next={"condition": ["light", "heavy"]})
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    found = {one["label"]: one for one in content["candidates"]}
    assert content["runs"] == {"new": 0, "reused": 0}
    now = content["inputs"]["E"]["sd"]
    assert found["condition light"]["sd"]["E"] == pytest.approx(now / np.sqrt(2), rel=0.1)
    assert found["condition heavy"]["sd"]["E"] == pytest.approx(now / np.sqrt(1 + TwoLoads().ratio ** 2), rel=0.1)


def test_a_condition_that_is_not_observed_can_be_asked_about_before_any_data(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "two", **TWO_LOADS_STUDY)
    seen = sl.load_study(folder).model({"E": 400.0, "load": 1e-5}, tmp_path).interfaces["light"]
    np.savetxt(folder / "light.csv", seen.points, delimiter=",")
    observation = [{"condition": "light", "file": "light.csv", "unit": "mm"}]
    write_study(folder, **{**TWO_LOADS_STUDY, "observation": observation, "next": {"condition": ["heavy"]}})
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess(), runs=4).content
    assert [one["label"] for one in content["candidates"]] == ["condition heavy", "as planned"]
    assert content["candidates"][0]["gain"] > content["candidates"][1]["gain"] > 0


def test_a_part_with_too_few_points_is_refused_before_any_run(folder: Path) -> None:
    ask(folder, {"load": [2e-5], "part": [[0, 0.05]]})
    with pytest.raises(InvalidInput, match="part of the interface to look at"):
        sl.next_experiment(sl.load_study(folder), executor=sl.InProcess())
    assert not (folder / "next.sqlite").exists()


def test_an_experiment_whose_run_fails_comes_last_with_its_reason(folder: Path) -> None:
    ask(folder, {"load": [2e-5, 1.0]})
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    last = content["candidates"][-1]
    assert last["gain"] is None
    assert last["problem"].startswith("its run failed: large_deflection: the tip would move by")
    assert content["candidates"][0]["label"] == "load 2e-05"
    ask(folder, {"load": [1.0]})
    advice = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content["advice"]
    assert advice == "Every candidate's run failed."


def test_the_command(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["next", str(folder), "--quiet", "--draws", "300"])
    printed = capsys.readouterr().out
    assert "beam: the next experiment, from its posterior" in printed
    assert re.search(r"^load 3e-05 +\d\.\d\d ", printed, re.MULTILINE)
    assert "9 new forward runs, 0 known; " in printed
    assert printed.rstrip().endswith("next.html")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"laod": [1]}, r"next.laod: got no such quantity.*Did you mean load\?"),
        ({"E": [1]}, r"next.E: got an input to calibrate.*cannot set what is to be inferred"),
        ({"load": 3}, r"next.load: got 3; expected a list"),
        ({"load": []}, r"next.load: got \[\]; expected a list"),
        ({"load": ["much"]}, r"next.load: got much; expected finite numbers"),
        ({"load": [1e999]}, r"next.load: .*finite"),
        ({"load": [1], "together": 4}, r"next.together: got 4.*from 1 to 3"),
        ({"part": [[0.5, 0.2]]}, r"next.part: got \[0.5, 0.2\].*pairs of shares"),
        ({"points": [2]}, r"next.points: got 2; expected whole numbers from 3"),
        ({"sd": [3]}, r"next.unit: .*one of .*um"),
        ({"sd": [-3], "unit": "um"}, r"next.sd: got -3.*above 0"),
        ({"condition": ["slow"]}, r"next.condition: .*single condition.*Remove it"),
        ({"load": list(range(1, 40)), "together": 2}, r"next: too many candidates: got 819; expected at most 500"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(tmp_path: Path, given: dict[str, Any], words: str) -> None:
    folder = write_study(tmp_path / "beam", next=given)
    with pytest.raises(InvalidStudy) as caught:
        sl.load_study(folder)
    assert re.search(words, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_value_outside_the_box_of_a_nuisance_input_is_refused(tmp_path: Path) -> None:
    inputs = {
        "E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"},
        "tilt": {"prior": {"uniform": [0.0, 0.04]}, "nuisance": True},
    }
    folder = write_study(tmp_path / "beam", inputs=inputs, next={"tilt": [0.02, 0.05]})
    with pytest.raises(InvalidStudy, match=r"next.tilt: got 0.05; expected a value in the box"):
        sl.load_study(folder)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"draws": 10}, "from 200 to 4000"),
        ({"runs": 1}, "at least 4"),
        ({"seed": -1}, "0 or above"),
        ({"source": "x"}, "prior"),
    ],
)
def test_arguments_out_of_range(tmp_path: Path, options: dict[str, Any], words: str) -> None:
    study = sl.load_study(write_study(tmp_path / "beam", next=NEXT))
    with pytest.raises(InvalidInput, match=words):
        sl.next_experiment(study, **options)
    assert not (tmp_path / "beam" / "next.sqlite").exists()


def test_no_posterior_and_no_candidates(folder: Path, tmp_path: Path) -> None:
    unfinished = sl.load_study(write_study(tmp_path / "new", next=NEXT))
    with pytest.raises(InvalidStudy, match="no posterior to plan from"):
        sl.next_experiment(unfinished, source="posterior")
    ask(folder, {})
    with pytest.raises(InvalidStudy, match=r"lists no candidates.*next: \{load: \[1e-05, 2e-05\]\}"):
        sl.next_experiment(sl.load_study(folder))


def test_every_key_is_described(folder: Path) -> None:
    content = sl.next_experiment(sl.load_study(folder), executor=sl.InProcess()).content
    rows = [line.split("|")[1] for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `")]
    keys = [key for row in rows for key in re.findall(r"`([^`]+)`", row)]
    described = {part for key in keys for part in re.split(r"[.\[\]]+", key)}
    named = {
        *content,
        *content["candidates"][0],
        *content["noise"][0],
        *content["directions"][0],
        *content["inputs"]["E"],
    }
    assert named <= described, named - described
