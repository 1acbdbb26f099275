"""The pages on the forward model and on PyVBMC quote their files of figures, and these are what was aimed at."""

import io
import itertools
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from verification.benchmarks.peers import vbmc
from verification.validation import pyvbmc
from verification.validation.pyvbmc import Mark, Trace
from verification.validation.pyvbmc_problems import Outline, marginals, mean_variation
from verification.validation.tables import Table, from_json, observed_orders, put_into_page

from strandline.likelihood import InterfaceLikelihood
from strandline.models.biofilm.materials import LAWS

EXPLANATION = Path(__file__).parents[4] / "docs" / "explanation"
PAGE = (EXPLANATION / "forward-model.md").read_text("utf-8")
TABLES = {
    name: from_json(data)
    for source in ("verification.json", "failure-map.json")
    for name, data in json.loads((EXPLANATION / source).read_text("utf-8")).items()
}
SAMPLE = Table("sample", "Sample", ("what", "x"), ("s", ".2f"), (("one", 1.234), ("none", None)))
PERCENT = {"CFD1": {"lift": 0.5}, "CSM1": {"ux": 0.3, "uy": 0.3}, "CSM2": {"ux": 0.3, "uy": 0.3}}
PERCENT["FSI1"] = {"ux": 0.5, "uy": 1.0, "drag": 0.05, "lift": 0.5}
"""Largest errors on the finest meshes."""


def test_page_has_each_table_as_it_was_computed_and_no_others():
    for name, table in TABLES.items():
        assert f"<!-- table: {name} -->\n{table.markdown()}\n<!-- end -->" in PAGE
    # Figures of creep are looked at where its model is tested.
    assert PAGE.count("<!-- table: ") == len(TABLES) + PAGE.count("<!-- table: creep_")


def test_finest_meshes_meet_the_aims():
    for name, allowed in PERCENT.items():
        table = TABLES[name]
        rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
        for (quantity, percent), order in itertools.product(allowed.items(), (2, 3)):
            meshes = [row for row in rows if (row[table.columns[0]], row["P"]) == (quantity, order)]
            finest = max(meshes, key=lambda row: row["unknowns"])
            assert abs(finest["error, %"]) < percent
            error = 100 * (finest["value"] / finest["published"] - 1)
            np.testing.assert_allclose(finest["error, %"], error, atol=1e-9)


def test_biofilm_and_other_flow_cells_meet_their_aims():
    mesh = TABLES["biofilm_mesh"]
    (default,) = [dict(zip(mesh.columns, row, strict=True)) for row in mesh.rows if row[0] == "default"]
    assert default["largest, µm"] < 1
    assert default["largest, %"] < 1
    assert set(TABLES["extremes"].column("outcome")) == {"solved"}
    for name in ("sensitivities", "generality_sensitivities"):
        assert max(TABLES[name].column("relative difference")) < 1e-6
    assert {row[0] for row in TABLES["generality_sensitivities"].rows} > set(LAWS)
    assert max(TABLES["generality_flow"].column("error of the velocity / its maximum")) < 1e-5
    assert max(TABLES["homogeneous"].column("error of stress / E")) < 1e-10
    assert {row[1] for row in TABLES["homogeneous"].rows} == set(LAWS)
    assert min(order for order in TABLES["manufactured"].column("order") if order is not None) > 2.8


def test_table_as_text_and_back_and_in_its_place_again_and_again_and_the_order_of_a_cubic():
    assert SAMPLE.markdown() == "| what | x |\n| --- | --- |\n| one | 1.23 |\n| none |  |"
    assert from_json(json.loads(json.dumps(SAMPLE.as_json()))) == SAMPLE
    page = "a\n<!-- table: sample -->\n<!-- end -->\nb\n<!-- table: other -->\nkept\n<!-- end -->\n"
    once = put_into_page(page, [SAMPLE])
    assert SAMPLE.markdown() in once
    assert "kept" in once
    assert put_into_page(once, [SAMPLE]) == once
    with pytest.raises(ValueError, match="0 places"):
        put_into_page("nothing", [SAMPLE])
    sizes = (0.4, 0.2, 0.05)
    orders = observed_orders(sizes, [7 * h**3 for h in sizes])
    assert orders[0] is None
    np.testing.assert_allclose(orders[1:], 3.0, rtol=1e-12)


class Exact:
    """Knows log L, off by `slope` times the load."""

    def __init__(self, outline, slope=0.0):
        self.outline, self.slope = outline, slope

    def expected(self, x):
        return self.outline.log_likelihood(x) + self.slope * x[:, 6]


def test_the_truth_is_at_no_distance_from_itself_and_another_posterior_is_not(tmp_path):
    outline = Outline(tmp_path, draws=2_000_000)
    x = outline.space.prior_quantiles(np.random.default_rng(0).random((10, 7)))
    likelihood = InterfaceLikelihood(outline.observations, outline.discrepancy)
    np.testing.assert_allclose(outline.log_likelihood(x), [likelihood(outline.interface(row)) for row in x], rtol=1e-10)
    assert outline.ours(Exact(outline)) < 1e-12
    assert outline.ours(Exact(outline, 0.05)) > 0.03, "moves the load by half a standard deviation of its prior"
    x = outline.known["x"]
    weight = np.exp(0.75 * outline.known["log"])
    draws = x[np.random.default_rng(1).choice(len(x), 50_000, p=weight / weight.sum())]
    assert outline.theirs(draws) < 0.06
    assert outline.theirs(draws + 0.5 * draws.std(axis=0)) > 0.12
    three, edges = np.array([[0.1, 0.9], [0.6, 0.8], [0.7, 0.1]]), np.tile([0.0, 0.5, 1.0], (2, 1))
    found = marginals(three, np.array([0.2, 0.3, 0.5]), edges)
    np.testing.assert_allclose(found, [[0.2, 0.8], [0.5, 0.5]])  # counted by hand
    np.testing.assert_allclose(mean_variation(found, np.array([[0.4, 0.6], [0.5, 0.5]])), 0.1)


def test_the_tables_of_pyvbmc_follow_from_the_published_steps():
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


def test_a_level_is_reached_at_the_first_mark_below_it_and_seeds_that_never_arrive_count_as_the_worst():
    def trace(*variations):
        marks = tuple(Mark(8 + 2 * k, v, float(k)) for k, v in enumerate(variations))
        settings = {"method": "strandline", "problem": "biofilm", "failed": "", "seed": 1, "failures": 0}
        return Trace(**settings, marks=marks, runs=marks[-1].runs)

    assert trace(0.3, 0.09, 0.2, 0.01).reached(0.1).runs == 10
    there, later, never = trace(0.3, 0.01), trace(0.3, 0.3, 0.01), trace(0.3, 0.3, 0.3, 0.3)
    assert never.reached(0.1) is None
    assert pyvbmc.figures([there, there, later], 0.1) == pyvbmc.Figures("10 / 12", 10, 1.0)
    assert pyvbmc.figures([there, later, never], 0.1).text == "12 / not by 1 of 3"
    assert pyvbmc.figures([there, never, never], 0.1) == pyvbmc.Figures("not by 2 of 3", None, None)


PEER = """
import json, sys
task = json.loads(sys.stdin.readline())
answers = []
for x in ([1.0, 2.0], [-1.0, 0.0]):
    print(json.dumps({"x": x}), flush=True)
    answers.append(json.loads(sys.stdin.readline()))
print(json.dumps({"done": {"answers": answers, "seed": task["seed"]}}), flush=True)
"""


def test_a_peer_is_answered_until_its_last_word_and_what_it_is_told_of_failed_runs(tmp_path, monkeypatch):
    script = tmp_path / "peer.py"
    script.write_text(PEER, "utf-8")

    def answer(x):
        return {"y": sum(x) if x[0] > 0 else None, "prior": 0.5}

    done = pyvbmc.conversation({"seed": 3}, answer, Path(sys.executable), script=script)
    assert done == {"answers": [{"y": 3.0, "prior": 0.5}, {"y": None, "prior": 0.5}], "seed": 3}
    script.write_text("", "utf-8")
    with pytest.raises((RuntimeError, BrokenPipeError)):
        pyvbmc.conversation({"seed": 3}, answer, Path(sys.executable), script=script)
    answers = [{"y": None, "prior": 1.0}, {"y": 2.0, "prior": 1.0}, {"y": None, "prior": 1.0}]
    for failed, expected in {"-1000": [-999, 2, -999], "lowest": [-999, 2, 2], "-inf": [-np.inf, 2, -np.inf]}.items():
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(json.dumps(one) + "\n" for one in answers)))
        target = vbmc.Target(failed, io.StringIO())
        assert [target([0.0]) for _ in answers] == expected
        assert (target.evaluations, target.failures) == (3, 2)
