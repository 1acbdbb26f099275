"""Comparison of studies: Bayes factors against quadrature of the true model, files, and the command."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.study.conftest import SAMPLER
from tests.study.questions.conftest import content_of, described_in, keys_of

import strandline as sl
from strandline.calibration.evidence import Evidence
from strandline.cli import main
from strandline.errors import InvalidInput, InvalidStudy, TooFewRuns
from strandline.likelihood import InterfaceLikelihood
from strandline.questions.compare import study_comparison as module
from strandline.testing.studies import undeclared_beam, write_study

E, SD = {"prior": {"uniform": [300, 560]}, "unit": "Pa"}, 0.003
TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
SMALL = {
    "inputs": {"E": E, "tilt": {"prior": {"uniform": [0.0, 0.08]}}},
    "sampler": SAMPLER,
    "surrogate": {"field": {}},
    "design": {"sobol": {"runs": 32}},
    "observation": {"file": "../beam.csv", "unit": "mm"},
    "discrepancy": {"normal_offset": {}},
    "noise": {"sd": 3, "unit": "um"},
    "draft": True,
    "report": "none",
}
NEXT = {"load": [0.0, 2e-5, 1.0], "points": [9]}
STUDIES = {
    "tilted": {},
    "straight": {"inputs": {"E": E}, "fixed": {"load": 1e-5, "tilt": 0.015}, "next": NEXT},
    "erring": {"noise": {"sd": 3, "unit": "um", "model_error": True}},
}
BOTH = ["tilted", "straight"]


@pytest.fixture(scope="module")
def analysed(tmp_path_factory):
    """Finished studies of the same beam, side by side."""
    home = tmp_path_factory.mktemp("compare")
    true = undeclared_beam(TRUTH, Path()).interfaces[""]
    seen = sl.PointErrors(SD).draw(true, np.random.default_rng(1))
    np.savetxt(home / "beam.csv", seen.points, delimiter=",")
    for name, changes in STUDIES.items():
        study = write_study(home / name, **{**SMALL, "name": name, **changes})
        sl.run_study(sl.load_study(study), executor=sl.InProcess())
    return home


@pytest.fixture
def home(analysed, tmp_path, monkeypatch):
    """A copy of the studies, which is the current folder."""
    shutil.copytree(analysed, tmp_path / "home")
    monkeypatch.chdir(tmp_path / "home")
    return tmp_path / "home"


@pytest.fixture(scope="module")
def compared(analysed):
    """The first two compared, with what would separate them."""
    studies = [sl.load_study(analysed / name) for name in BOTH]
    return sl.compare(studies, to=analysed / "comparison", separate=True, executor=sl.InProcess())


def exact(study):
    """Return the log-evidence of the true model by quadrature around its posterior."""
    likelihood = InterfaceLikelihood(study.observations(study.observed), next(iter(study.discrepancies.values())))
    posterior, space = sl.load_result(study.folder).posterior, study.space
    low = np.maximum(posterior.mean - 7 * posterior.sd, space.low)
    size = np.minimum(posterior.mean + 7 * posterior.sd, space.high) - low
    nodes, weights = (one / 2 for one in np.polynomial.legendre.leggauss(30))
    u, mass = (
        np.stack(np.meshgrid(*[one] * space.dim, indexing="ij"), axis=-1).reshape(-1, space.dim)
        for one in (nodes + 0.5, weights)
    )
    inputs = [{**study.fixed, **space.as_mapping(x)} for x in low + size * u]
    values = [likelihood(undeclared_beam(one, Path()).interfaces) for one in inputs]
    return float(logsumexp(values, b=mass.prod(axis=1) * np.prod(size / (space.high - space.low))))


def bayes_factor(content, of, over):
    (one,) = [one for one in content["bayes_factors"] if {one["of"], one["over"]} == {of, over}]
    return one["ln"] * (1 if one["of"] == of else -1), one["error"]


def test_the_bayes_factor_is_that_of_the_true_models(compared, home, monkeypatch):
    """Planted at the end: an evidence does not pay for the width of the prior, as the best likelihood does not."""
    tilted, straight = (exact(sl.load_study(name)) for name in BOTH)
    found, error = bayes_factor(compared.content, *BOTH)
    assert abs(found - (tilted - straight)) < max(3 * error, 0.05)
    assert compared.content["models"]["tilted"]["log_evidence"] == pytest.approx(tilted, abs=0.1)
    assert compared.content["models"]["tilted"]["error"] < 0.1
    best = lambda k, s, posterior, r: Evidence(float(k.plug_in(posterior.draws).max()), 0.01)  # noqa: E731
    monkeypatch.setattr(module, "log_evidence", best)
    found, error = bayes_factor(sl.compare(BOTH).content, *BOTH)
    assert abs(found - (tilted - straight)) > max(3 * error, 0.05)


def test_what_it_writes(compared, analysed):
    words = ("Kass and Raftery", "compare_marginals", "compare_predictive", "32 runs")
    content = content_of(compared, 2, compared.content["verdict"], *words)
    assert compared.page.resolve() == analysed / "comparison" / "compare.html"
    assert (compared.shared, list(content["averaged"])) == (("E",), ["E"])
    assert sum(one["probability"] for one in content["models"].values()) == pytest.approx(1.0)
    assert content["models"]["straight"]["fixed"] == {"load": 1e-5, "tilt": 0.015}
    item, shares = content["averaged"]["E"], [one["probability"] for one in content["models"].values()]
    mean = sum(share * one["mean"] for share, one in zip(shares, item["models"].values(), strict=True))
    assert item["mean"] == pytest.approx(mean)
    assert item["sd"] == pytest.approx(float(compared.averaged.sd[0]))
    assert np.diff(item["histogram"]["edges"]) @ item["histogram"]["averaged"] == pytest.approx(1.0, abs=0.01)
    (predicted,) = content["predictive"]
    assert len(predicted["models"]["tilted"]["observed"]) == 17
    assert max(np.abs(predicted["models"]["tilted"]["q50"])) < 1e-6
    (narrowed,) = [remark for remark in content["remarks"] if "tilt by" in remark]
    assert narrowed.startswith("Not all models have these inputs of tilted, whose priors the data narrow: tilt by ")
    places = ("models", "averaged", "inputs", "fixed", "versions", "averaged.NAME.models", "predictive[].models")
    named = dict.fromkeys((*places, "averaged.NAME.histogram.models", "models.NAME.fixed"), "NAME")
    assert described_in("compare.md") == keys_of(compared.content, named)


def test_an_error_that_the_model_does_not_make_costs_at_most_a_half(home):
    """Half of its prior is on a model without error, so that ln B is below ln 2, if constants are the same."""
    content = sl.compare(["tilted", "erring"]).content
    found, error = bayes_factor(content, "tilted", "erring")
    assert -0.3 < found < np.log(2) + 2 * error + 0.02
    assert content["favoured"] is None
    assert [one["model_error"] for one in content["models"].values()] == [False, True]
    assert content["models"]["tilted"]["constant"] != content["models"]["erring"]["constant"]


def test_a_misfit_is_marked_and_a_fit_that_was_not_judged_is_told(compared, home, capsys):
    """The same seed gives the same bits, and odds change probabilities alone."""
    before = (home / "tilted" / "ledger.sqlite").read_bytes()
    summaries = {name: json.loads((home / name / "summary.json").read_text("utf-8")) for name in BOTH}
    for name, summary in summaries.items():
        summary["misfit"]["flagged"] = True
        (home / name / "summary.json").write_text(json.dumps(summary))
    even = sl.compare(BOTH).content
    assert "does not explain the observation within the noise" in even["remarks"][0]
    for key in ("bayes_factors", "averaged", "predictive"):
        assert even[key] == compared.content[key]
    (home / "straight" / "summary.json").write_text(json.dumps({**summaries["straight"], "misfit": None}))
    main(["compare", *BOTH, "--to", "here/it", "--odds", "1:2"])
    shown = capsys.readouterr()
    content = json.loads((home / "here" / "it" / "compare.json").read_text("utf-8"))
    assert shown.err.splitlines() == ["surrogate …", "evidence …", "figures and report …"]
    assert content["verdict"] in shown.out
    assert (home / "tilted" / "ledger.sqlite").read_bytes() == before
    assert content["models"]["straight"]["prior_probability"] == pytest.approx(2 / 3)
    assert content["bayes_factors"] == json.loads(json.dumps(even["bayes_factors"]))
    odds = [np.divide(*(one["models"][name]["probability"] for name in BOTH)) for one in (even, content)]
    assert odds[0] / odds[1] == pytest.approx(2)
    for name, one in content["models"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name] and "±" in line)
        assert f"{one['log_evidence']:.2f} ± {one['error']:.2f}" in row
        assert row.endswith("noticed" if name == "tilted" else "not judged")
    assert "page: here/it/compare.html" in shown.out
    assert "straight: The fit was not judged." in (home / "here" / "it" / "compare.html").read_text("utf-8")


def true_separation(home, load, probabilities):
    """Return the mutual information of model and observation by nested Monte Carlo with the true model."""
    shown, random = [], np.random.default_rng(3)
    for name in BOTH:
        study = sl.load_study(home / name)
        draws = np.unique(sl.load_result(home / name).posterior.equally_weighted(5), axis=0)
        some = random.permutation(draws)[:350]
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


def test_what_separates_the_models_is_that_of_the_true_ones(compared, home, monkeypatch):
    """Without a load, the beam shows only its tilt; the models differ in whether they know it.

    Planted at the end: the signals of one model are four standard deviations off, as with another reference for each.
    """
    probabilities = [compared.content["models"][name]["probability"] for name in BOTH]
    one = {one["candidate"]: one for one in compared.content["separate"]}
    expected = {load: true_separation(home, load, probabilities) for load in (0.0, 2e-5)}
    for load, nats in expected.items():
        assert one[f"load {load:g}, 9 points"]["nats"] == pytest.approx(nats, abs=0.05)
    assert one["load 1, 9 points"]["nats"] is None
    assert list(one)[-1] == "load 1, 9 points"
    content_of(compared, 2, "Which experiment would tell them apart", "its run failed: large_deflection")
    shown = module.shown_by_models

    def shifted(*given, **options):
        some = shown(*given, **options)
        return tuple(replace(one, signals=(one.signals[0] + 4.0, *one.signals[1:])) for one in some if one.signals)

    monkeypatch.setattr(module, "shown_by_models", shifted)
    content = sl.compare(BOTH, separate=True, executor=sl.InProcess()).content
    (planted,) = (one for one in content["separate"] if one["candidate"] == "load 0, 9 points")
    assert abs(planted["nats"] - expected[0.0]) > 0.1


def test_what_is_refused_leaves_no_folder(home, monkeypatch):
    write_study(home / "unfinished", **{**SMALL, "name": "unfinished"})
    for studies, to, words in (
        (["tilted", "unfinished"], "new", "the study has no posterior to compare: got a study that is not finished"),
        (BOTH, "straight", "folder of the comparison: got straight, which is a study"),
        (BOTH, "beam.csv", "folder of the comparison: got .*beam.csv, which is a file"),
    ):
        with pytest.raises(InvalidStudy, match=words):
            sl.compare(studies, to=to)
    with pytest.raises(InvalidInput, match="none of the studies lists candidates"):
        sl.compare(["tilted", "erring"], separate=True)

    def too_few(*_, **__):
        raise TooFewRuns("runs", value=1, expected="more", remedy="Make more.")

    monkeypatch.setattr(module, "field_knowledge", too_few)
    with pytest.raises(TooFewRuns):
        sl.compare(BOTH, to="new/one")
    assert not (home / "new").exists()
