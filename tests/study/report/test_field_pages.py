"""Report, page, summary and printed results of a study with a random field: no coefficient is listed."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from tests.study.report.pages import Page, data_in
from tests.study.report.strips import FIELD, TILT, TRUTH, strip_study

from strandline.cli.run import show
from strandline.design import FieldOutcome
from strandline.foundations import inputs_text, names_text, with_sd
from strandline.posterior import laplace
from strandline.report import write_report
from strandline.report.page import methods_paragraph
from strandline.report.warnings import find_warnings

COEFFICIENT = re.compile(r"\bB(_|<sub>)\d")
FIGURES = ["field_error", "interfaces", "predictive", "random_field_B", "residuals", "tempering"]


@pytest.fixture(scope="module", params=[(TILT,), ()], ids=["with a scalar", "alone"])
def finished(request, tmp_path_factory):
    """A field, with and without a scalar input: the scalars, the calibration, its summary, and the folder."""
    folder = tmp_path_factory.mktemp("strip")
    study, calibration, summary = strip_study(folder, *request.param)
    write_report(calibration, summary, study_text="", truth=study.truth, folder=folder)
    return request.param, calibration, summary, folder


def test_the_report_has_a_section_on_the_field_and_lists_no_coefficient(finished):
    scalars, _, summary, folder = finished
    page = (folder / "report.html").read_text("utf-8")
    text = Page(page).text
    drawn = sorted(path.stem for path in (folder / "figures").glob("*.png"))
    assert drawn == sorted([*FIGURES, *["marginals"] * len(scalars)])
    halves = summary["sampler_check"]["split"]["of"]
    assert set(COEFFICIENT.findall(page.replace(f"mass with {halves}", ""))) == set()
    assert 'href="#field-1"' in page
    assert all(words in text for words in ("Field B", summary["fields"]["B"]["statement"], "the field B explain"))
    assert ("B_1" not in methods_paragraph(summary), "the field B" in methods_paragraph(summary)) == (True, True)
    for name, one in summary["fields"]["B"]["functionals"].items():
        assert name in text
        assert f"{one['mean']:.4g}" in text
        assert f"{one['truth']:.4g}" in text
    assert ("Explore" in text) == bool(scalars)
    if scalars:
        data = data_in(page)
        assert [one["name"] for one in data["facts"]["inputs"]] == list(data["runs"]["inputs"]) == ["tilt"]


def test_the_summary_has_the_field_and_no_coefficient(finished, capsys):
    scalars, calibration, summary, _ = finished
    of, known = summary["fields"]["B"], calibration.posterior.fields["B"]
    assert list(summary["inputs"]) == [one.name for one in scalars]
    assert len(summary["gaussian"]["covariance"]) == len(scalars)
    rest = {name: one for name, one in summary.items() if name != "sampler_check"}
    assert not COEFFICIENT.search(json.dumps(rest))
    assert of["share_of_variance"] == FIELD.share
    assert (of["modes"], of["points"], list(of["functionals"])) == (10, 41, list(known.functionals))
    values = FIELD.values(np.array([list(TRUTH.values())]))
    assert of["functionals"]["mean"]["truth"] == pytest.approx(values.mean())
    left = of["share_of_prior_sd_left"]
    assert 0 < left["least"] < left["median"] < left["largest"]
    assert known.share_left[:12].max() < left["largest"], "the base of the strip is known best"
    show(summary, None)
    printed = capsys.readouterr().out
    mean = of["functionals"]["mean"]
    assert f"B: field of 10 modes, mean {with_sd(mean['mean'], mean['sd'])} N mm^2" in printed
    assert (of["statement"] in printed, "B_1" in printed, "median" in printed) == (True, False, bool(scalars))
    assert ("B: field of 10 modes" in repr(calibration), "B_1" in repr(calibration)) == (True, False)


def test_chains_need_no_laplace_approximation(finished, monkeypatch):
    signs = np.diag([1.0, *[-1.0] * (finished[1].posterior.space.dim - 1)])
    rough = replace(finished[1], laplace=laplace(signs, finished[1].posterior.map_estimate))
    assert any("no Laplace approximation" in one for one in find_warnings(rough))
    monkeypatch.setattr(FieldOutcome, "by_chains", True)
    assert not any("no Laplace approximation" in one for one in find_warnings(rough))


def test_inputs_in_a_line_leave_out_many_coefficients():
    few = {f"E_{k}": float(k) for k in range(1, 4)}
    assert inputs_text({"nu": 0.123456789, **few}) == "nu = 0.123457, E_1 = 1, E_2 = 2, E_3 = 3"
    many = {f"E_{k}": float(k) for k in range(1, 101)}
    assert inputs_text({"nu": 0.25, **many, "E_sd": 0.5}) == "nu = 0.25, E_sd = 0.5, 100 coefficients of E"


def test_many_names_are_the_first_and_the_last():
    assert names_text(["nu", "E_1", "E_2"]) == "nu, E_1, E_2"
    assert names_text(["nu", *(f"E_{k}" for k in range(1, 101)), "E_sd"]) == "nu, E_1 … E_100, E_sd"
