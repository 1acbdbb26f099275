"""A field of more modes than runs, from study.yaml to what is printed: sensitivities let it settle early."""

import json

import pytest
from tests.unit.models.strips import POINTS

from strandline.cli import main
from strandline.report.page import methods_paragraph
from strandline.testing.studies import write_study

FIELD = {"mean": 1, "sd": 0.4, "length": 0.3, "modes": POINTS, "at": {"interval": [0, 1], "points": POINTS}}
STUDY = {
    "model": {"python": {"function": "tests.unit.models.strips:strip"}},
    "fixed": {"load": 1.5},
    "inputs": {"E": {"field": FIELD, "unit": "Pa"}},
    "observation": {"synthetic": {"load": 1.5, "E_1": 0.8}, "noise": {"sd": 0.01}},
    "noise": {"sd": 10, "unit": "um"},
    "discrepancy": {"normal_offset": {}},
    "sensitivities": True,
    "design": {"active": {"runs": 40, "batch": 4}},
    "surrogate": {"field": {}},
    "executor": {"in_process": {}},
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return write_study(tmp_path_factory.mktemp("strip"), **STUDY)


def test_it_settles_with_fewer_runs_than_inputs_and_says_how(finished, capsys):
    main(["run", str(finished), "--quiet"])
    printed = capsys.readouterr().out
    summary = json.loads((finished / "summary.json").read_text("utf-8"))
    check = summary["certificate"]["check"]
    assert summary["certificate"]["converged"]
    assert summary["runs"]["ok"] < POINTS + 2
    assert (check["effective"], check["draws"] >= 8) == (None, True)
    assert 0 < check["ratio_sd"] < 0.84
    assert 0 < check["bound"] <= 0.25
    assert f"has sd {check['ratio_sd']:.2g}; a shift of a mean by {check['bound']:.2g} sd stays" in printed
    page = (finished / "report.html").read_text("utf-8")
    assert f"standard deviation of {check['ratio_sd']:.2g}, which leaves" in page
    words = "a Gaussian field of its logarithm (median 1 Pa, sd 0.4, length 0.3 mm, covariance matern32)"
    assert words in methods_paragraph(summary)
    assert "a forward run at load = 1.5, and a known field." in page
    main(["coverage", str(finished), "--replicates", "20", "--from", "posterior"])
    assert f"all {POINTS} coefficients of the field E count, but are not listed" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["what-if", str(finished)])
    assert "inputs of what-if: got fields alone" in capsys.readouterr().err
