"""A study of a field of unknown length and a scalar, with derivatives, from study.yaml to its report and files."""

import json
import re
from functools import partial

import numpy as np
import pytest
from tests.study.report.pages import Page
from tests.unit.models.strips import POINTS
from tests.unit.studies.test_fields import STUDY

import strandline as sl
from strandline.cli import main
from strandline.cli.run import show
from strandline.posterior import netcdf
from strandline.questions.next import next_experiment
from strandline.questions.what_if import what_if
from strandline.report.page import methods_paragraph
from strandline.testing.studies import write_study
from strandline.view.viewed import ViewedStudy

RUNS = {"design": {"sobol": {"runs": 32}}, "surrogate": {"field": {}}, "sensitivities": True, "draft": True}
COEFFICIENT = re.compile(r"\bE(_|<sub>)\d")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = write_study(tmp_path_factory.mktemp("strip") / "study", **(STUDY | RUNS))
    main(["run", str(found), "--quiet"])
    return found


def test_scalars_are_listed_and_coefficients_are_not(folder):
    summary = json.loads((folder / "summary.json").read_text())
    assert list(summary["inputs"]) == ["E_length", "load"]
    assert (summary["sampler"]["kind"], summary["certificate"]) == ("chains", None)
    rest = {name: one for name, one in summary.items() if name not in ("sampler_check", "warnings")}
    assert not COEFFICIENT.search(json.dumps(rest))
    of = summary["fields"]["E"]
    assert (of["modes"], of["points"]) == (6, POINTS)
    assert "length LogUniform(low=0.1, high=0.5)" in of["prior"]
    text = Page((folder / "report.html").read_text("utf-8")).text
    assert of["statement"] in text
    assert "Hamiltonian Monte Carlo" in text
    assert "tempering" not in text
    assert repr(sl.load_study(folder)).startswith("<Study beam: E_length, load, E of PythonModel")


def test_draws_of_the_true_posterior_are_named(folder, capsys):
    summary = json.loads((folder / "summary.json").read_text())
    words = "1513 effective draws from 3360 runs, Pareto k̂ 0.28"
    summary["certificate"] = {"converged": True, "exact": words, "check": None, "statement": "The end."}
    assert f"each draw weighted by a run of the model: {words}." in methods_paragraph(summary)
    show(summary, None)
    assert f"converged: {words}\nThe end." in capsys.readouterr().out


@pytest.mark.parametrize("ask", [what_if, partial(next_experiment, source="prior", runs=4)])
def test_pages_of_answers_list_no_coefficient(folder, ask):
    found = ask(sl.load_study(folder))
    assert "E_length" in str(found)
    assert not COEFFICIENT.search(json.dumps(found.content) + found.page.read_text("utf-8"))


def test_the_netcdf_file_has_draws_of_all_inputs_and_the_field(folder):
    study = sl.load_study(folder)
    tree = netcdf.read(folder / "posterior.nc")
    assert {*study.space.names} <= {*tree["posterior"].data_vars}
    stored, found = tree["field_E"], netcdf.from_datatree(tree, study.space).fields["E"]
    np.testing.assert_allclose(stored["mean"], found.mean)
    np.testing.assert_allclose(stored["share_of_prior_sd_left"], found.share_left)
    exact = found.field.values(found.inputs[:50])
    np.testing.assert_allclose(found.values.draws[:50], exact, rtol=0.02)


def test_the_view_has_sliders_for_scalars_alone(folder):
    viewed = ViewedStudy(sl.load_study(folder))
    viewed.feed.update()
    viewed.newest.refresh(viewed.feed.succeeded)
    shown = [viewed.facts, viewed.state | {"summary": None}, viewed.posterior, viewed.run(0), viewed.feed.since(0)]
    assert not COEFFICIENT.search(json.dumps(shown[0]))
    assert not COEFFICIENT.search(json.dumps(shown[1:]))
    assert "The coefficients of E are at their posterior mean" in viewed.facts["held"]
    mean = viewed.newest.shown.now.mean
    at = viewed._inputs({"E_length": 0.3, "load": 900.0})
    np.testing.assert_array_equal(at, [*mean[:6], 0.3, 900.0])
