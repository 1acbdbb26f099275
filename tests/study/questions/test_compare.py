"""Comparison of studies: Bayes factors against quadrature of the true model, files, and the command."""

import json
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm
from tests.study.conftest import SAMPLER
from tests.study.questions.conftest import content_of

import strandline as sl
from strandline.calibration.evidence import Evidence
from strandline.cli import main
from strandline.foundations import InvalidInput, InvalidStudy
from strandline.likelihood import InterfaceLikelihood
from strandline.questions import compare as module
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
    likelihood = InterfaceLikelihood(study.observations(study.observed), study.measure)
    posterior, space = sl.load_result(study.folder).posterior, study.space
    low = np.maximum(posterior.mean - 7 * posterior.sd, space.low)
    size = np.minimum(posterior.mean + 7 * posterior.sd, space.high) - low
    nodes, weights = (one / 2 for one in np.polynomial.legendre.leggauss(30))
    u, mass = (np.array(list(product(one, repeat=space.dim))) for one in (nodes + 0.5, weights))
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
    best = lambda k, s, posterior, r: Evidence(float(k.plug_in(posterior.draws).max()), 0.01)  # noqa: E731
    monkeypatch.setattr(module.calibration, "log_evidence", best)
    found, error = bayes_factor(sl.compare(BOTH).content, *BOTH)
    assert abs(found - (tilted - straight)) > max(3 * error, 0.05)


def test_what_it_writes(compared, analysed):
    content = content_of(compared, 2, compared.content["verdict"], "compare_marginals", "compare_predictive", "32 runs")
    assert compared.page.resolve() == analysed / "comparison" / "compare.html"
    item, shares = content["averaged"]["E"], [one["probability"] for one in content["models"].values()]
    mean = sum(share * one["mean"] for share, one in zip(shares, item["models"].values(), strict=True))
    assert item["mean"] == pytest.approx(mean)
    (predicted,) = content["predictive"]
    assert max(np.abs(predicted["models"]["tilted"]["q50"])) < 1e-6
    (narrowed,) = [remark for remark in content["remarks"] if "tilt by" in remark]
    assert narrowed.startswith("Not all models have these inputs of tilted, whose priors the data narrow: tilt by ")


def test_an_error_that_the_model_does_not_make_costs_at_most_a_half(home):
    """Half of its prior is on a model without error, so that ln B is below ln 2, if constants are the same."""
    content = sl.compare(["tilted", "erring"]).content
    found, error = bayes_factor(content, "tilted", "erring")
    assert -0.3 < found < np.log(2) + 2 * error + 0.02
    assert content["models"]["tilted"]["constant"] != content["models"]["erring"]["constant"]


def test_a_misfit_is_marked_and_a_fit_that_was_not_judged_is_told(compared, home, capsys):
    """The same seed gives the same bits, and odds change probabilities alone."""
    before = (home / "tilted" / "ledger.sqlite").read_bytes()
    worse, best = sorted(BOTH, key=lambda name: compared.content["models"][name]["log_evidence"])
    for name in BOTH:
        summary = json.loads((home / name / "summary.json").read_text("utf-8"))
        misfit = {**summary["misfit"], "flagged": True} if name == best else None
        (home / name / "summary.json").write_text(json.dumps({**summary, "misfit": misfit}))
    main(["compare", *BOTH, "--to", "here/it", "--odds", "1:2"])
    shown = capsys.readouterr()
    content = json.loads((home / "here" / "it" / "compare.json").read_text("utf-8"))
    assert content["verdict"] in shown.out
    assert (home / "tilted" / "ledger.sqlite").read_bytes() == before
    assert "does not explain the observation within the noise" in content["remarks"][0]
    assert content["bayes_factors"] == compared.content["bayes_factors"]
    odds = [np.divide(*(one["models"][name]["probability"] for name in BOTH)) for one in (compared.content, content)]
    assert odds[0] / odds[1] == pytest.approx(2)
    for name, one in content["models"].items():
        row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name] and "±" in line)
        assert f"{one['log_evidence']:.2f} ± {one['error']:.2f}" in row
        assert row.endswith("noticed" if name == best else "not judged")
    assert "page: here/it/compare.html" in shown.out
    assert f"{worse}: The fit was not judged." in (home / "here" / "it" / "compare.html").read_text("utf-8")


def nats_without_load(home, probabilities):
    """Return the mutual information of model and observation: nine points of the beam show its tilt alone."""
    slope, seen = np.linalg.norm(np.linspace(0, 1, 9)) / SD, np.linspace(-20, 80, 4001)
    tilts = sl.load_result(home / "tilted").posterior.equally_weighted(5)[:, 1]
    shown = [norm.pdf(seen[:, None], slope * some).mean(axis=1) for some in (tilts, np.array([0.015]))]
    total = np.einsum("m,ms->s", probabilities, shown)
    nats = [one @ np.log(np.maximum(one, 1e-300) / np.maximum(total, 1e-300)) for one in shown]
    return float(np.dot(probabilities, nats) * (seen[1] - seen[0]))


def test_what_separates_the_models_is_that_of_the_true_ones(compared, analysed):
    """Without a load, the models differ in whether they know the tilt."""
    one = {one["candidate"]: one["nats"] for one in compared.content["separate"]}
    expected = nats_without_load(analysed, [compared.content["models"][name]["probability"] for name in BOTH])
    assert one["load 0, 9 points"] == pytest.approx(expected, abs=0.05)
    assert (list(one)[-1], one["load 1, 9 points"]) == ("load 1, 9 points", None)
    assert "its run failed: large_deflection" in compared.page.read_text("utf-8")


def test_what_is_refused_leaves_no_folder(home):
    write_study(home / "unfinished", **{**SMALL, "name": "unfinished"})
    for studies, to, words in (
        (["tilted", "unfinished"], "new", "the study has no posterior to compare: got a study that is not finished"),
        (BOTH, "straight", "folder of the comparison: got straight, which is a study"),
        (BOTH, "beam.csv", "folder of the comparison: got .*beam.csv, which is a file"),
    ):
        with pytest.raises(InvalidStudy, match=words):
            sl.compare(studies, to=to)
    with pytest.raises(InvalidInput, match="none of the studies lists candidates"):
        sl.compare(["tilted", "erring"], to="new", separate=True)
    assert not (home / "new").exists()
