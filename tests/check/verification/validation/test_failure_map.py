"""Counting of the failure map, on outcomes of a made-up solid whose fold is known, and on a few real runs."""

import numpy as np
import pytest
from verification.validation import failure_map
from verification.validation.biofilm_mesh import flow_cell
from verification.validation.failure_map import FOLD_RATIOS, WIDTH, Runs, Survey, box_inputs, critical_moduli
from verification.validation.failure_tables import BAND, band_table, differing_table, distances, fold_table

from strandline.interface import Interface
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.model import Biofilm
from strandline.runs import InProcess, RunRecord

INPUTS = box_inputs(1024)
NUMBER = np.arange(len(INPUTS))
E, NU = np.array([(point["E"], point["nu"]) for point in INPUTS]).T
SHIFT = 0.02
"""The fold of the made-up default mesh lies lower by this share: within the band."""


def fold(poisson):
    return 200.0 + 100.0 * poisson


def made_up(inputs, *, shift=0.0, solved=()):
    """Return the outcomes of a solid with a fold, and of those numbers in `solved` as if it had none."""
    records = []
    for k, point in enumerate(inputs):
        critical, bent = (1 - shift) * fold(point["nu"]), 10.0 / point["E"]
        if point["E"] > critical or k in solved:
            interface = Interface.polyline(np.array([[0.0, 0.0], [0.5 + bent * (1 + shift), 0.4], [1.0, 0.0]]))
            figures = {"max_displacement": bent, "min_J_fluid": 0.9, "min_J_solid": 0.8}
            records.append(RunRecord(str(k), point, "ok", {"": interface}, figures | {"newton_jacobians": 1.0 + k % 3}))
        else:
            figures = {"limit_load": 100.0 * point["E"] / critical, "jacobians": 7.0}
            kind = "limit_point" if k % 2 else "continuation_stalled"
            records.append(RunRecord(str(k), point, "failed", {}, figures, failure_kind=kind))
    return records


def cells(table, row=0):
    return dict(zip(table.columns, table.rows[row], strict=True))


@pytest.fixture(scope="module")
def tables():
    critical = np.array([fold(nu) for nu in FOLD_RATIOS])
    survey = Survey(
        {"default": made_up(INPUTS, shift=SHIFT), "fine": made_up(INPUTS)},
        {"default": list(60.0 / E), "fine": list(60.0 / E)},
        {"coarse": critical - 3.0, "default": (1 - SHIFT) * critical, "fine": critical},
    )
    return {table.name: table for table in survey.tables()}


def test_outcomes_over_the_box_are_counted(tables):
    np.testing.assert_allclose(np.array([E[:2], NU[:2]]).T, [[100.0, -0.8], [450.0, -0.15]], rtol=1e-15)
    for row, shift in enumerate((SHIFT, 0.0)):
        failed = (1 - shift) * fold(NU) >= E
        counted = cells(tables["failures"], row)
        assert (counted["points"], counted["solved"]) == (1024, (~failed).sum())
        assert counted["`limit_point`"] == (failed & (NUMBER % 2 == 1)).sum()
        assert [counted[c] for c in tables["failures"].columns[-4:]] == [2.0, 3.0, 7.0, 7.0]
        largest = cells(tables["failure_evidence"], row)["largest, mm²/s"]
        np.testing.assert_allclose(largest, (100 * E / fold(NU) / (1 - shift))[failed].max(), rtol=1e-12)
    solved, strain = fold(NU) < E, 60.0 / E
    row = cells(tables["first_order_compression"], 1)
    assert row["largest of a solved run"] == strain[solved].max()
    assert row["smallest of a failed run"] == strain[~solved].min()
    assert row["> 0.27: solved"] == (solved & (strain > 0.27)).sum() > 0
    assert sum(row[column] for column in tables["first_order_compression"].columns[3:]) == len(INPUTS)


def test_points_between_two_folds_are_the_band_and_interfaces_are_compared_where_both_meshes_solve(tables):
    between = (fold(NU) >= E) & ((1 - SHIFT) * fold(NU) < E)
    row = cells(tables["two_meshes"])
    assert (row["solved on default only"], row["failed on default only"]) == (between.sum(), 0)
    assert row[f"of them beyond {BAND:g} %"] == row[f"solved on default only beyond {BAND:g} %"] == 0
    assert row["error of the fold's line, %"] == 0.0
    furthest = 100 * (1 - (E / fold(NU))[between].min())
    np.testing.assert_allclose(row["those two at most so far from the fold, %"], furthest, rtol=1e-9)
    np.testing.assert_allclose(np.sort(tables["different_outcomes"].column("E, Pa")), np.sort(E[between]), rtol=1e-12)
    both = fold(NU) < E
    for row, chosen in enumerate((both, both & (np.abs(E / fold(NU) - 1) > BAND / 100))):
        figures = cells(tables["two_interfaces"], row)
        assert figures["number"] == chosen.sum() > 0
        np.testing.assert_allclose(figures["largest, µm"], 1e4 * SHIFT / E[chosen].min(), rtol=1e-9)
        np.testing.assert_allclose(figures["largest, %"], 100 * SHIFT, rtol=1e-9)


@pytest.mark.parametrize("wrong_on", ["default", "fine"])
def test_a_planted_wrong_success_is_beyond_the_band(wrong_on):
    victim = int(np.argmin(E / fold(NU)))
    default = made_up(INPUTS, shift=SHIFT, solved=[victim] if wrong_on == "default" else [])
    fine = made_up(INPUTS, solved=[victim] if wrong_on == "fine" else [])
    row = cells(band_table(default, fine, fold))
    assert row[f"of them beyond {BAND:g} %"] == 1
    assert row[f"solved on default only beyond {BAND:g} %"] == (wrong_on == "default")
    assert E[victim] in differing_table(default, fine, fold).column("E, Pa")


def test_the_fold_is_found_by_bisection_and_distances_are_relative_to_it():
    found = critical_moduli(made_up, FOLD_RATIOS)
    np.testing.assert_allclose(found, [fold(nu) for nu in FOLD_RATIOS], atol=0.5 * WIDTH)
    row = cells(fold_table(FOLD_RATIOS, {"fine": found}), FOLD_RATIOS.index(0.0))
    assert row["prototype, Pa"] == 197.0
    assert abs(row["fine, Pa"] - 200.0) < WIDTH
    runs = made_up([{"E": 206.0, "nu": 0.0}, {"E": 225.0, "nu": 0.5}])
    np.testing.assert_allclose(distances(runs, fold), [3.0, -10.0], rtol=1e-9)
    with pytest.raises(ValueError, match="not between"):
        critical_moduli(lambda inputs: made_up(inputs, shift=-3.0), FOLD_RATIOS)


def test_runs_are_made_once_and_first_order_compression_is_that_of_a_stiff_solid(tmp_path):
    inputs = [{"E": E, "nu": 0.3, "V_in": 100.0} for E in (400.0, 150.0)]
    runs, model = Runs(tmp_path, InProcess()), Biofilm(mesh="coarse", failure_budget=0)
    first = runs("map", model, inputs)
    assert [(run.ok, run.failure_kind) for run in first] == [(True, None), (False, "limit_point")]
    assert 60.0 < first[1].diagnostics["limit_load"] < 100.0
    assert [run.seconds for run in runs("map", model, inputs[::-1])] == [run.seconds for run in first[::-1]]
    (run,) = runs("compression", failure_map.FirstOrder("coarse"), [{"E": 4e5, "nu": 0.3, "V_in": 100.0}])
    cell = flow_cell(MESHES["coarse"])
    solution = cell.solve([4e5], [0.3], 100.0)
    np.testing.assert_allclose(run.diagnostics["compression"], cell.largest_compression(solution.unknowns), rtol=2e-3)
