"""Comparison of studies: Bayes factors against quadrature of the true model, files, the command, and refusals."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.special import logsumexp
from tests.questions.pages import Check, described_in, keys_of

import strandline as sl
from strandline.calibration.evidence import Evidence
from strandline.cli import main
from strandline.errors import TooFewRuns
from strandline.likelihood import InterfaceLikelihood
from strandline.planning.candidate import Candidate, Look
from strandline.questions.compare import study_comparison as module
from strandline.questions.compare.comparable import labels_of
from strandline.questions.compare.separation import require_settable
from strandline.runs import Ledger
from strandline.testing.studies import undeclared_beam, write_study

E = {"prior": {"uniform": [300, 560]}, "unit": "Pa"}
TILT = {"prior": {"uniform": [0.0, 0.08]}}
SMALL = {
    "inputs": {"E": E, "tilt": TILT},
    "sampler": {"smc": {"particles": 2000, "rejuvenation_steps": 4}},
    "surrogate": {"field": {}},
    "design": {"sobol": {"runs": 24}},
    "observation": {"file": "../beam.csv", "unit": "mm"},
    "discrepancy": {"normal_offset": {}},
    "noise": {"sd": 3, "unit": "um"},
}
TRUTH, SD = {"E": 400.0, "tilt": 0.02, "load": 1e-5}, 0.003
STUDIES: dict[str, dict[str, Any]] = {
    "tilted": {"name": "tilted"},
    "straight": {"name": "straight", "inputs": {"E": E}, "fixed": {"load": 1e-5, "tilt": 0.015}},
    "erring": {"name": "erring", "noise": {"sd": 3, "unit": "um", "model_error": True}},
    "stiffer": {"name": "stiffer", "inputs": {"E": {**E, "prior": {"uniform": [300, 600]}}, "tilt": TILT}},
    "hotter": {"name": "hotter", "noise": {"sd": 4, "unit": "um"}},
    "traced": {"name": "traced", "discrepancy": {"tracked_points": {}}},
    "other": {"name": "other", "observation": {"file": "../other.csv", "unit": "mm"}},
    "loose": {"name": "loose", "noise": {"sd": "unknown", "unit": "um"}},
    "unfinished": {"name": "unfinished"},
    "heavier": {"name": "heavier", "inputs": {"E": {**E, "unit": "kPa"}, "tilt": TILT}},
    "synthetic": {"name": "synthetic", "observation": {"synthetic": TRUTH}},
}
ANALYSED = ("tilted", "straight", "erring")


def observed(seed: int) -> sl.Interface:
    true = undeclared_beam(TRUTH, Path()).interfaces[""]
    return sl.PointErrors(SD).draw(true, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished studies of the same beam, side by side."""
    home = tmp_path_factory.mktemp("compare")
    for name, seed in (("beam", 1), ("other", 2)):
        np.savetxt(home / f"{name}.csv", observed(seed).points, delimiter=",")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        for name, changes in STUDIES.items():
            folder = write_study(home / name, **{**SMALL, **changes})
            edit(folder)
            if name in ANALYSED:
                sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    return home


@pytest.fixture
def drawn(analysed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the studies, which is the current folder."""
    shutil.copytree(analysed, tmp_path / "home")
    monkeypatch.chdir(tmp_path / "home")
    return tmp_path / "home"


@pytest.fixture
def home(drawn: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same, where comparisons draw no page."""
    monkeypatch.setattr(module, "write_comparison", lambda content, folder: folder / "compare.html")
    return drawn


def exact(study: sl.Study) -> float:
    """Return the log-evidence of the true model by quadrature."""
    likelihood = InterfaceLikelihood(study.observations(study.observed), next(iter(study.discrepancies.values())))
    posterior = sl.load_result(study.folder).posterior
    low = np.maximum(posterior.mean - 7 * posterior.sd, study.space.low)
    high = np.minimum(posterior.mean + 7 * posterior.sd, study.space.high)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    grid = [a + (b - a) * 0.5 * (nodes + 1) for a, b in zip(low, high, strict=True)]
    share = np.prod((high - low) / (study.space.high - study.space.low)) * 0.5**study.space.dim
    x = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, study.space.dim)
    values = [
        likelihood(undeclared_beam({**study.fixed, **study.space.as_mapping(row)}, Path()).interfaces) for row in x
    ]
    mass = np.prod(np.stack(np.meshgrid(*[weights] * study.space.dim, indexing="ij")), axis=0).ravel()
    return float(logsumexp(np.array(values) + np.log(mass * share)))


def bayes_factor(content: dict[str, Any], of: str, over: str) -> tuple[float, float]:
    (one,) = [one for one in content["bayes_factors"] if {one["of"], one["over"]} == {of, over}]
    return one["ln"] * (1 if one["of"] == of else -1), one["error"]


@pytest.mark.parametrize("planted", [False, True])
def test_the_bayes_factor_is_that_of_the_true_models(
    home: Path, planted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the evidence of a model does not pay for the width of its prior, as the best likelihood does not."""
    if planted:
        monkeypatch.setattr(
            module, "log_evidence", lambda k, s, posterior, r: Evidence(float(k.plug_in(posterior.draws).max()), 0.01)
        )
    content = sl.compare(["tilted", "straight"]).content
    tilted, straight = (exact(sl.load_study(name)) for name in ("tilted", "straight"))
    found, error = bayes_factor(content, "tilted", "straight")
    assert (abs(found - (tilted - straight)) < max(3 * error, 0.05)) is not planted
    if not planted:
        assert content["models"]["tilted"]["log_evidence"] == pytest.approx(tilted, abs=0.1)
        assert content["models"]["tilted"]["error"] < 0.1


def test_what_it_writes(drawn: Path) -> None:
    before = runs_in("tilted")
    found = sl.compare(["tilted", sl.load_study("straight")])
    folder = drawn / "comparison"
    content = json.loads((folder / "compare.json").read_text("utf-8"))
    assert content == json.loads(json.dumps(found.content))
    assert runs_in("tilted") == before
    assert found.page.resolve() == folder / "compare.html"
    assert (found.shared, list(content["averaged"])) == (("E",), ["E"])
    assert sum(one["probability"] for one in content["models"].values()) == pytest.approx(1.0)
    assert content["models"]["straight"]["fixed"] == {"load": 1e-5, "tilt": 0.015}
    item, shares = content["averaged"]["E"], [one["probability"] for one in content["models"].values()]
    mean = sum(share * one["mean"] for share, one in zip(shares, item["models"].values(), strict=True))
    assert item["mean"] == pytest.approx(mean)
    assert found.averaged is not None
    assert item["sd"] == pytest.approx(float(found.averaged.sd[0]))
    density = np.array(item["histogram"]["averaged"]) @ np.diff(item["histogram"]["edges"])
    assert density == pytest.approx(1.0, abs=0.01)
    (predicted,) = content["predictive"]
    assert len(predicted["models"]["tilted"]["observed"]) == 17
    assert max(np.abs(predicted["models"]["tilted"]["q50"])) < 1e-6
    page = found.page.read_text("utf-8")
    for words in (content["verdict"], "Kass and Raftery", "compare_marginals", "compare_predictive", "24 runs"):
        assert words in page
    assert "<script" not in page
    assert page.count("<img ") == page.count('src="data:image/png') == 2
    assert repr(found) == f"<StudyComparison of tilted, straight: {content['verdict']}>"


def runs_in(name: str) -> int:
    with Ledger.open(Path(name) / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().total


def test_the_same_seed_gives_the_same_bits(home: Path) -> None:
    texts = []
    for to in ("one", "two"):
        sl.compare(["tilted", "straight"], to=to)
        texts.append((home / to / "compare.json").read_bytes())
    assert texts[0] == texts[1]


def test_an_error_that_the_model_does_not_make_costs_at_most_a_half(home: Path) -> None:
    """Half of its prior is on a model without error, so that ln B is below ln 2, if constants are the same."""
    content = sl.compare(["tilted", "erring"]).content
    found, error = bayes_factor(content, "tilted", "erring")
    assert -0.3 < found < np.log(2) + 2 * error + 0.02
    assert content["favoured"] is None
    assert [one["model_error"] for one in content["models"].values()] == [False, True]
    assert content["models"]["tilted"]["constant"] != content["models"]["erring"]["constant"]


def test_remarks_on_inputs_of_one_model_alone(home: Path) -> None:
    remarks = sl.compare(["tilted", "straight"]).content["remarks"]
    (one,) = [remark for remark in remarks if "tilt by" in remark]
    assert one.startswith("Not all models have these inputs of tilted, whose priors the data narrow: tilt by ")


def test_a_best_model_that_does_not_fit_is_marked(home: Path) -> None:
    for name in ("tilted", "straight"):
        path = home / name / "summary.json"
        summary = json.loads(path.read_text("utf-8"))
        summary["misfit"]["flagged"] = True
        path.write_text(json.dumps(summary))
    content = sl.compare(["tilted", "straight"]).content
    assert "does not explain the observation within the noise" in content["remarks"][0]


def test_a_study_whose_fit_was_not_judged_can_be_compared(drawn: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = drawn / "straight" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "misfit": None}))
    main(["compare", "tilted", "straight", "--quiet"])
    assert "not judged" in capsys.readouterr().out
    assert "straight: The fit was not judged." in (drawn / "comparison" / "compare.html").read_text("utf-8")


def test_odds_change_probabilities_alone(home: Path) -> None:
    even = sl.compare(["tilted", "straight"]).content
    odd = sl.compare(["tilted", "straight"], odds=(1.0, 3.0)).content
    assert odd["bayes_factors"] == even["bayes_factors"]
    one, two = (
        np.log(content["models"]["tilted"]["probability"] / content["models"]["straight"]["probability"])
        for content in (even, odd)
    )
    assert one - two == pytest.approx(np.log(3))


NEXT = {"load": [0.0, 2e-5, 1.0], "points": [9]}


def told(content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["candidate"]: one for one in content["separate"]}


def true_separation(home: Path, load: float, probabilities: list[float]) -> float:
    """Return the mutual information of model and observation by nested Monte Carlo with the true model."""
    shown, random = [], np.random.default_rng(3)
    for name in ("tilted", "straight"):
        study = sl.load_study(home / name)
        draws = np.unique(sl.load_result(home / name).posterior.equally_weighted(5), axis=0)
        some = random.permutation(draws)[:500]
        inputs = [{**study.fixed, **study.space.as_mapping(x), "load": load} for x in some]
        shown.append(np.array([undeclared_beam(one, Path()).interfaces[""].points[::2, 1] for one in inputs]) / SD)
    total = 0.0
    for k, truths in enumerate(shown):
        seen = truths + random.standard_normal(truths.shape)
        logs = []
        for m, draws in enumerate(shown):
            squares = -0.5 * ((seen[:, None] - draws[None]) ** 2).sum(axis=2)
            if m == k:
                np.fill_diagonal(squares, -np.inf)
            logs.append(logsumexp(squares, axis=1) - np.log(len(draws)) + np.log(probabilities[m]))
        total += probabilities[k] * float(np.mean(logs[k] - logsumexp(logs, axis=0) - np.log(probabilities[k])))
    return total


def test_what_separates_the_models_is_that_of_the_true_ones(drawn: Path) -> None:
    """Without a load, the beam shows only its tilt; the models differ in whether they know it."""
    edit(drawn / "straight", next=NEXT)
    found = sl.compare(["tilted", "straight"], separate=True, executor=sl.InProcess())
    probabilities = [found.content["models"][name]["probability"] for name in ("tilted", "straight")]
    one = told(found.content)
    for load in (0.0, 2e-5):
        expected = true_separation(drawn, load, probabilities)
        assert one[f"load {load:g}, 9 points"]["nats"] == pytest.approx(expected, abs=0.05)
    assert one["load 1, 9 points"]["nats"] is None
    assert list(one)[-1] == "load 1, 9 points"
    page = (drawn / "comparison" / "compare.html").read_text("utf-8")
    assert "Which experiment would tell them apart" in page
    assert "its run failed: large_deflection" in page


def test_a_model_whose_signals_are_shifted_is_noticed(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the signals of one model are four standard deviations off, as with another reference for each model."""
    edit(home / "straight", next=NEXT)
    shown = module.shown_by_models

    def shifted(*given: Any, **options: Any) -> Any:
        return tuple(
            replace(one, signals=(one.signals[0] + 4.0, *one.signals[1:])) if one.signals else one
            for one in shown(*given, **options)
        )

    monkeypatch.setattr(module, "shown_by_models", shifted)
    content = sl.compare(["tilted", "straight"], separate=True, executor=sl.InProcess()).content
    probabilities = [content["models"][name]["probability"] for name in ("tilted", "straight")]
    assert abs(told(content)["load 0, 9 points"]["nats"] - true_separation(home, 0.0, probabilities)) > 0.1


def test_no_candidates_to_separate_the_models(home: Path) -> None:
    with pytest.raises(sl.InvalidInput, match="none of the studies lists candidates"):
        sl.compare(["tilted", "straight"], separate=True)
    assert not (home / "comparison").exists()


@pytest.mark.parametrize(
    ("fixed", "words"),
    [
        ({"load": 1e-5, "tilt": 0.015}, "do not fit tilted: got tilt, which is calibrated there"),
        ({"load": 1e-5, "tilt": 0.015, "mass": 1.0}, "do not fit tilted: got mass, which its model does not have"),
    ],
)
def test_candidates_must_fit_all_studies(home: Path, fixed: dict[str, float], words: str) -> None:
    straight, tilted = (sl.load_study(home / name) for name in ("straight", "tilted"))
    wanted = tuple(Candidate(({name: 1.0},), Look()) for name in list(fixed)[-1:])
    with pytest.raises(sl.InvalidInput, match=words):
        require_settable({"straight": replace(straight, fixed=fixed), "tilted": tilted}, wanted)


def test_a_comparison_that_fails_leaves_no_folder(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def too_few(*_: Any, **__: Any) -> None:
        raise TooFewRuns("runs", value=1, expected="more", remedy="Make more.")

    monkeypatch.setattr(module, "field_knowledge", too_few)
    with pytest.raises(TooFewRuns):
        sl.compare(["tilted", "straight"], to="new/one")
    assert not (home / "new").exists()


def test_names_of_studies(home: Path) -> None:
    for name, changes in (("a", {}), ("b", {}), ("c/a", {"name": "other"})):
        write_study(home / name, **{**SMALL, "observation": {"file": str(home / "beam.csv"), "unit": "mm"}, **changes})
    a, b, c = (sl.load_study(home / name) for name in ("a", "b", "c/a"))
    assert labels_of([a, c]) == ("beam", "other")
    assert labels_of([a, b]) == ("a", "b")
    assert labels_of([a, b, c]) == tuple(str(one.folder.resolve()) for one in (a, b, c))


def test_the_direction_of_the_points_does_not_matter(home: Path) -> None:
    np.savetxt(home / "turned.csv", np.loadtxt(home / "beam.csv", delimiter=",")[::-1], delimiter=",")
    edit(home / "straight", observation={"file": "../turned.csv", "unit": "mm"})
    sl.run_study(sl.load_study(home / "straight"), executor=sl.InProcess())
    assert sl.compare(["tilted", "straight"]).content["bayes_factors"]


def edit(folder: Path, **changes: Any) -> None:
    content = yaml.safe_load((folder / "study.yaml").read_text("utf-8"))
    (folder / "study.yaml").write_text("".join(f"{k}: {json.dumps(v)}\n" for k, v in {**content, **changes}.items()))


def test_every_key_is_described(home: Path) -> None:
    edit(home / "tilted", next={"points": [9]})
    found = sl.compare(["tilted", "straight"], separate=True).content
    places = ("models", "averaged", "inputs", "fixed", "versions", "averaged.NAME.models", "predictive[].models")
    named = dict.fromkeys((*places, "averaged.NAME.histogram.models", "models.NAME.fixed"), "NAME")
    assert described_in("compare.md") == keys_of(found, named)


def test_the_command_prints_what_it_writes(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["compare", "tilted", "straight", "--to", "here/it", "--odds", "1:2"])
    shown = capsys.readouterr()
    content = json.loads((home / "here" / "it" / "compare.json").read_text("utf-8"))
    assert shown.err.splitlines() == ["surrogate …", "evidence …", "figures and report …"]
    assert content["verdict"] in shown.out
    assert content["models"]["straight"]["prior_probability"] == pytest.approx(2 / 3)
    for name, one in content["models"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name] and "±" in line)
        assert f"{one['log_evidence']:.2f} ± {one['error']:.2f}" in row
    assert "page: here/it/compare.html" in shown.out
    main(["compare", "tilted", "straight", "--to", "here/it", "--odds", "1:2", "--quiet"])
    again = capsys.readouterr()
    assert (again.err, again.out) == ("", shown.out)


REFUSED: list[tuple[list[str], str]] = [
    ([], "studies to compare: got none; expected at least two study folders"),
    (["tilted"], "studies to compare: got tilted; expected at least two study folders"),
    (["tilted", "straight", "./tilted"], "studies to compare: got tilted twice; expected different folders"),
    (["tilted", "unfinished"], "the study has no posterior to compare: got a study that is not finished"),
    (["tilted", "synthetic"], "the study has no posterior to compare: got a study that is not finished"),
    (["tilted", "loose"], "loose cannot be compared: the range of its unknown noise is not stated"),
    (["tilted", "nowhere"], "nowhere"),
    (["tilted", "other"], "tilted and other cannot be compared: the observed interfaces differ: got points up to "),
    (["tilted", "hotter"], "tilted and hotter cannot be compared: the noise differs: got sd 0.003 and 0.004; expected"),
    (["tilted", "traced"], "tilted and traced cannot be compared: the measures differ: got NormalOffset and Tracked"),
    (
        ["tilted", "stiffer"],
        "tilted and stiffer cannot be compared: the supports of the priors of E differ: got [300, 560] and [300, 600]",
    ),
    (["tilted", "straight", "--odds", "1:0"], "prior odds of the models: got 1:0; expected 2 numbers above 0"),
    (["tilted", "straight", "--odds", "1"], "prior odds of the models: got 1; expected 2 numbers above 0"),
    (["tilted", "straight", "--odds", "one"], "prior odds of the models: got one; expected numbers above 0"),
    (["tilted", "straight", "--to", "straight"], "folder of the comparison: got straight, which is a study"),
    (["tilted", "straight", "--to", "beam.csv"], "folder of the comparison: got beam.csv, which is a file"),
    (["tilted", "straight", "--seed", "-1"], "--seed"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_what_is_refused(words: list[str], message: str, home: Path, refused: Check) -> None:
    refused(["compare", "--quiet", *words], message, home)


def test_synthetic_data_of_two_models_are_different_data(home: Path, refused: Check) -> None:
    """Each model makes its own."""
    edit(home / "straight", observation={"synthetic": {**TRUTH, "tilt": 0.01}}, fixed={"load": 1e-5, "tilt": 0.01})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        sl.run_study(sl.load_study(home / "straight"), executor=sl.InProcess())
    message = "A synthetic observation comes from the study's own model"
    refused(["compare", "--quiet", "tilted", "straight"], message, home)
