"""Counting of the failure map, on outcomes of a made-up solid whose fold is known."""

import numpy as np
import pytest
from verification.validation.failure_map import (
    BAND,
    FOLD_RATIOS,
    WIDTH,
    band_table,
    box_inputs,
    critical_moduli,
    tables_of,
)

from strandline.interface import Interface
from strandline.runs import RunRecord

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


def test_outcomes_over_the_box_are_counted():
    """Points between the folds of two meshes are the band."""
    critical = np.array([fold(nu) for nu in FOLD_RATIOS])
    tables = tables_of(
        {"default": made_up(INPUTS, shift=SHIFT), "fine": made_up(INPUTS)},
        {"default": list(60.0 / E), "fine": list(60.0 / E)},
        FOLD_RATIOS,
        {"coarse": critical - 3.0, "default": (1 - SHIFT) * critical, "fine": critical},
        fold,
    )
    tables = {table.name: table for table in tables}
    for row, shift in enumerate((SHIFT, 0.0)):
        failed = (1 - shift) * fold(NU) >= E
        counted = cells(tables["failures"], row)
        assert (counted["points"], counted["solved"]) == (1024, (~failed).sum())
        assert counted["`limit_point`"] == (failed & (NUMBER % 2 == 1)).sum()
    between = (fold(NU) >= E) & ((1 - SHIFT) * fold(NU) < E)
    row = cells(tables["two_meshes"])
    assert (row["solved on default only"], row["failed on default only"]) == (between.sum(), 0)
    assert row[f"of them beyond {BAND:g} %"] == 0
    both = fold(NU) < E
    np.testing.assert_allclose(cells(tables["two_interfaces"])["largest, µm"], 1e4 * SHIFT / E[both].min(), rtol=1e-9)


@pytest.mark.parametrize("wrong_on", ["default", "fine"])
def test_a_planted_wrong_success_is_beyond_the_band(wrong_on):
    victim = int(np.argmin(E / fold(NU)))
    default = made_up(INPUTS, shift=SHIFT, solved=[victim] if wrong_on == "default" else [])
    fine = made_up(INPUTS, solved=[victim] if wrong_on == "fine" else [])
    assert cells(band_table(default, fine, fold))[f"of them beyond {BAND:g} %"] == 1


def test_the_fold_is_found_by_bisection():
    found = critical_moduli(made_up, FOLD_RATIOS)
    np.testing.assert_allclose(found, [fold(nu) for nu in FOLD_RATIOS], atol=0.5 * WIDTH)
