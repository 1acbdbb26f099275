"""The pages on the forward model and on PyVBMC quote their files of figures, and these are what was aimed at."""

import itertools
import json
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from verification.validation import pyvbmc
from verification.validation.tables import Table, observed_orders, put_into_page

from strandline.models.biofilm.materials import LAWS

RESULTS = Path(__file__).parents[4] / "docs" / "results"
PAGE = (RESULTS / "forward-model.md").read_text("utf-8")
TABLES = {
    name: Table(**data)
    for source in ("verification.json", "failure-map.json")
    for name, data in json.loads((RESULTS / source).read_text("utf-8")).items()
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


def test_a_table_is_put_into_its_place_and_the_order_of_a_cubic_is_three():
    assert SAMPLE.markdown() == "| what | x |\n| --- | --- |\n| one | 1.23 |\n| none |  |"
    page = "a\n<!-- table: sample -->\n<!-- end -->\nb\n<!-- table: other -->\nkept\n<!-- end -->\n"
    once = put_into_page(page, [SAMPLE])
    assert once == page.replace("sample -->\n", f"sample -->\n{SAMPLE.markdown()}\n")
    sizes = (0.4, 0.2, 0.05)
    np.testing.assert_allclose(observed_orders(sizes, [7 * h**3 for h in sizes])[1:], 3.0, rtol=1e-12)


def test_the_tables_of_pyvbmc_follow_from_the_published_steps():
    page = pyvbmc.PAGE.read_text("utf-8")
    published = json.loads(pyvbmc.PAGE.with_name("pyvbmc.json").read_text("utf-8"))
    tables = [Table(**one) for one in published["tables"].values()]
    assert put_into_page(page, tables) == page
    assert page.count("<!-- table: ") == len(tables)
    first = published["tables"]["pyvbmc"]["rows"][0]
    for column, method, failed in ((4, "strandline", ""), (5, "PyVBMC", "-1000")):
        runs = [
            next(mark["runs"] for mark in one["marks"] if mark["variation"] < 0.2)
            for one in published["traces"]
            if (one["method"], one["problem"], one["failed"]) == (method, "biofilm", failed)
        ]
        assert first[column] == f"{np.median(runs):g} / {max(runs)}"


def test_commands_of_the_page_of_results_exist():
    page = (RESULTS / "index.md").read_text("utf-8")
    commands = re.findall(r"`python -m (verification[a-z_.]+)`", page)
    commands += [f"verification.validation{name}" for name in re.findall(r"`(\.[a-z_.]+)`", page)]
    assert len(commands) > 20
    assert [name for name in commands if find_spec(name) is None] == []
