"""The comparison with PyVBMC, without it: distances with known answers, figures, and a peer that follows a script."""

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from verification.benchmarks.peers import vbmc
from verification.validation import pyvbmc
from verification.validation.pyvbmc import Mark, Trace
from verification.validation.pyvbmc_problems import Outline, marginals, mean_variation
from verification.validation.tables import from_json, put_into_page

from strandline.likelihood import InterfaceLikelihood


@pytest.fixture(scope="module")
def outline(tmp_path_factory) -> Outline:
    return Outline(tmp_path_factory.mktemp("outline"), draws=2_000_000)


class Exact:
    """Knows log L, off by `slope` times the load."""

    def __init__(self, outline, slope=0.0):
        self.outline, self.slope = outline, slope

    def expected(self, x):
        return self.outline.log_likelihood(x) + self.slope * x[:, 6]


def test_the_closed_form_is_the_measure_on_outlines_with_a_ridge(outline):
    x = outline.space.prior_quantiles(np.random.default_rng(0).random((10, 7)))
    likelihood = InterfaceLikelihood(outline.observations, outline.discrepancy)
    np.testing.assert_allclose(outline.log_likelihood(x), [likelihood(outline.interface(row)) for row in x], rtol=1e-10)
    assert outline.log_likelihood(np.array([outline.truth]))[0] == 0
    x = np.array([outline.truth, outline.truth])
    x[1, [0, 1, 2, 6]] *= 1.2
    a, b = outline.log_likelihood(x)
    assert abs(a - b) < 1e-12
    x[1, 0] *= 1.2
    assert outline.log_likelihood(x)[1] < -1


def test_the_truth_is_at_no_distance_from_itself_and_another_posterior_is_not(outline):
    assert outline.ours(Exact(outline)) < 1e-12
    shifted = outline.ours(Exact(outline, 0.05))  # moves the load by half a standard deviation of its prior
    assert shifted > 0.03
    x = outline.known["x"]
    weight = np.exp(0.75 * outline.known["log"])
    draws = x[np.random.default_rng(1).choice(len(x), 50_000, p=weight / weight.sum())]
    assert outline.theirs(draws) < 0.06
    assert outline.theirs(draws + 0.5 * draws.std(axis=0)) > 0.12


def test_marginals_against_bins_counted_by_hand():
    x = np.array([[0.1, 0.9], [0.6, 0.8], [0.7, 0.1]])
    edges = np.tile([0.0, 0.5, 1.0], (2, 1))
    found = marginals(x, np.array([0.2, 0.3, 0.5]), edges)
    np.testing.assert_allclose(found, [[0.2, 0.8], [0.5, 0.5]])
    np.testing.assert_allclose(mean_variation(found, np.array([[0.4, 0.6], [0.5, 0.5]])), 0.1)


def test_the_tables_of_the_page_follow_from_the_published_steps():
    page = pyvbmc.PAGE.read_text("utf-8")
    published = json.loads(pyvbmc.PAGE.with_suffix(".json").read_text("utf-8"))
    tables = [from_json(one) for one in published["tables"].values()]
    assert put_into_page(page, tables) == page
    assert page.count("<!-- table: ") == len(tables) == 3
    first = from_json(published["tables"]["pyvbmc"]).rows[0]
    assert first[2] == 0.2
    for column, method, failed in ((4, "strandline", ""), (5, "PyVBMC", "-1000")):
        runs = [
            next(mark["runs"] for mark in one["marks"] if mark["variation"] < 0.2)
            for one in published["traces"]
            if (one["method"], one["problem"], one["failed"]) == (method, "biofilm", failed)
        ]
        assert first[column] == f"{np.median(runs):g} / {max(runs)}"


def trace(*variations: float) -> Trace:
    marks = tuple(Mark(8 + 2 * k, v, float(k)) for k, v in enumerate(variations))
    settings = {"method": "strandline", "problem": "biofilm", "failed": "", "seed": 1, "failures": 0}
    return Trace(**settings, marks=marks, runs=marks[-1].runs)


def test_a_level_is_reached_at_the_first_mark_below_it_and_seeds_that_never_arrive_count_as_the_worst():
    one = trace(0.3, 0.09, 0.2, 0.01)
    assert one.reached(0.1).runs == 10
    assert one.reached(0.005) is None
    there, later, never = trace(0.3, 0.01), trace(0.3, 0.3, 0.01), trace(0.3, 0.3, 0.3, 0.3)
    assert pyvbmc.figures([there, there, later], 0.1) == pyvbmc.Figures("10 / 12", 10, 1.0)
    assert pyvbmc.figures([there, later, never], 0.1).text == "12 / not by 1 of 3"
    assert pyvbmc.figures([there, never, never], 0.1) == pyvbmc.Figures("not by 2 of 3", None, None)
    assert pyvbmc.figures([], 0.1).text == "not measured"


PEER = """
import json, sys
task = json.loads(sys.stdin.readline())
answers = []
for x in ([1.0, 2.0], [-1.0, 0.0]):
    print(json.dumps({"x": x}), flush=True)
    answers.append(json.loads(sys.stdin.readline()))
print(json.dumps({"done": {"answers": answers, "seed": task["seed"]}}), flush=True)
"""


def test_a_peer_is_answered_until_its_last_word(tmp_path):
    script = tmp_path / "peer.py"
    script.write_text(PEER, "utf-8")

    def answer(x):
        return {"y": sum(x) if x[0] > 0 else None, "prior": 0.5}

    done = pyvbmc.conversation({"seed": 3}, answer, Path(sys.executable), script=script)
    assert done == {"answers": [{"y": 3.0, "prior": 0.5}, {"y": None, "prior": 0.5}], "seed": 3}
    script.write_text("", "utf-8")
    with pytest.raises((RuntimeError, BrokenPipeError)):
        pyvbmc.conversation({"seed": 3}, answer, Path(sys.executable), script=script)


def test_what_the_peer_is_told_of_failed_runs(monkeypatch):
    answers = [{"y": None, "prior": 1.0}, {"y": 2.0, "prior": 1.0}, {"y": None, "prior": 1.0}]
    for failed, expected in {"-1000": [-999, 2, -999], "lowest": [-999, 2, 2], "-inf": [-np.inf, 2, -np.inf]}.items():
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(json.dumps(one) + "\n" for one in answers)))
        target = vbmc.Target(failed, io.StringIO())
        assert [target([0.0]) for _ in answers] == expected
        assert (target.evaluations, target.failures) == (3, 2)
