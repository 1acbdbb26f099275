"""The page on the forward model quotes verification.json and failure-map.json, and these are what was aimed at."""

import json
from pathlib import Path

import numpy as np
import pytest
from verification.validation.tables import Table, from_json, observed_orders, put_into_page

from strandline.models.biofilm.materials import LAWS

EXPLANATION = Path(__file__).parents[4] / "docs" / "explanation"
PAGE = (EXPLANATION / "forward-model.md").read_text("utf-8")
TABLES = {
    name: from_json(data)
    for source in ("verification.json", "failure-map.json")
    for name, data in json.loads((EXPLANATION / source).read_text("utf-8")).items()
}
SAMPLE = Table("sample", "Sample", ("what", "x"), ("s", ".2f"), (("one", 1.234), ("none", None)))
PERCENT = {
    "CFD1": {"lift": 0.5},
    "CSM1": {"ux": 0.3, "uy": 0.3},
    "CSM2": {"ux": 0.3, "uy": 0.3},
    "FSI1": {"ux": 0.5, "uy": 1.0, "drag": 0.05, "lift": 0.5},
}
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
        for quantity, percent in allowed.items():
            for order in (2, 3):
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
    assert max(TABLES["sensitivities"].column("relative difference")) < 1e-6
    assert set(TABLES["extremes"].column("outcome")) == {"solved"}
    assert max(TABLES["generality_sensitivities"].column("relative difference")) < 1e-6
    assert {row[0] for row in TABLES["generality_sensitivities"].rows} > set(LAWS)
    assert max(TABLES["generality_flow"].column("error of the velocity / its maximum")) < 1e-5
    assert max(TABLES["homogeneous"].column("error of stress / E")) < 1e-10
    assert {row[1] for row in TABLES["homogeneous"].rows} == set(LAWS)
    assert min(order for order in TABLES["manufactured"].column("order") if order is not None) > 2.8


def test_table_as_text_and_back_and_in_its_place_again_and_again():
    assert SAMPLE.markdown() == "| what | x |\n| --- | --- |\n| one | 1.23 |\n| none |  |"
    assert from_json(json.loads(json.dumps(SAMPLE.as_json()))) == SAMPLE
    page = "a\n<!-- table: sample -->\n<!-- end -->\nb\n<!-- table: other -->\nkept\n<!-- end -->\n"
    once = put_into_page(page, [SAMPLE])
    assert SAMPLE.markdown() in once
    assert "kept" in once
    assert put_into_page(once, [SAMPLE]) == once
    with pytest.raises(ValueError, match="0 places"):
        put_into_page("nothing", [SAMPLE])


def test_observed_order_of_a_cubic():
    sizes = (0.4, 0.2, 0.05)
    orders = observed_orders(sizes, [7 * h**3 for h in sizes])
    assert orders[0] is None
    np.testing.assert_allclose(orders[1:], 3.0, rtol=1e-12)
