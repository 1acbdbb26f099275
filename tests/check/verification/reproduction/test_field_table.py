"""The table against a closed form with a fold, and a handful of runs of the coarse biofilm."""

from dataclasses import replace

import numpy as np
import pytest
from verification.reproduction.field_table import FieldTable, LoadCoordinates, tabulate, withheld

from strandline.errors import InvalidInput, NumericsError
from strandline.models.biofilm.model import Biofilm
from strandline.runs import InProcess, Ledger, LocalProcesses
from strandline.testing.folding import Folding

LIMITS = [
    (120.0, -0.3, 94.02), (60.0, -0.3, 64.61), (120.0, 0.1, 72.43), (60.0, 0.1, 49.15), (20.0, 0.1, 25.10),
    (120.0, 0.5, 64.17), (60.0, 0.5, 42.56), (20.0, -0.8, 65.07), (60.0, -0.8, 116.90), (2.0, -0.8, 9.38),
    (0.3, -0.72, 0.9737), (0.3, -0.55, 0.6423),
]  # fmt: skip
"""E, ν and the rate of the fold, found by following the load to its limit."""


def somewhere(box, number=40, seed=0):
    return box.from_box(np.random.default_rng(seed).uniform(-1, 1, (number, 3)))


def exact(model, x):
    bulge = np.array([model.bulge(*row) for row in x.tolist()])
    abscissa = np.linspace(0, 1, model.nodes)
    return np.stack(np.broadcast_arrays(abscissa, bulge[:, None] * np.sin(np.pi * abscissa)), axis=-1)


def test_coordinates_go_there_and_back_and_outside_is_outside():
    box = LoadCoordinates()
    z = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    np.testing.assert_allclose(box.to_box(box.from_box(z)), z, atol=1e-12)
    assert box.inside(box.from_box(z)).all()
    x = np.array([[400, 0.3, 100], [250, 0.3, 100], [400, 0.51, 100], [400, 0.3, 111], [400, 0.3, 0]], float)
    assert box.inside(x).tolist() == [True, False, False, False, True]


def test_box_of_the_biofilm_ends_before_the_folds():
    """The cubic fit must not come nearer than 10 % to the folds at V = 100, nor end far before any where E can be."""
    box = LoadCoordinates()
    for nu, young in box.fold:
        assert 1.1 * young < float(box.softest(np.array([nu]), box.fold_rate)[0]) < 1.17 * young
    for young, nu, rate in LIMITS:
        share = float(box.load(np.array([young, nu, rate])))
        assert share > 0.92
        assert share < 1.2 or young < 100


def test_interfaces_between_the_nodes_are_the_closed_form(table, model):
    x = somewhere(table.coordinates)
    assert np.abs(table.at(x) - exact(model, x)).max() < 2e-8
    still = table.at(np.array([[400.0, 0.3, 0.0], [100.0, -0.8, 0.0]]))
    np.testing.assert_allclose(still, np.broadcast_to(model.undeformed().points, still.shape), atol=1e-15)
    assert table.runs == 12 * 7 * 3  # none without load


def test_error_falls_geometrically_with_the_intervals(make_table, model):
    x = somewhere(make_table((4, 6, 2)).coordinates)
    errors = [np.abs(make_table((n, 6, 2)).at(x) - exact(model, x)).max() for n in (2, 4, 6)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2] > 0


def test_grid_scattered_points_and_the_nested_table_agree(table, make_table):
    axes = [np.array([-1.0, 0.2, 1.0]), np.array([-0.5, 0.7]), np.array([0.1])]
    z = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    scattered = table.at(table.coordinates.from_box(z)[2:])
    np.testing.assert_allclose(table.on_grid(*axes).reshape(6, -1, 2)[2:], scattered, atol=1e-14)
    x = somewhere(table.coordinates)
    np.testing.assert_allclose(table.halved().at(x), make_table((6, 3, 1)).at(x), atol=1e-14)


def test_coefficients_tell_in_which_coordinate_nodes_are_missing(table):
    """The bulge is a product of polynomials of degrees 1 in V and about 1 in ν, but not in s."""
    s, nu, rate = table.coefficients()
    assert rate[2:].max() < 1e-12 < rate[1]
    assert s[2] > 1e3 * s[10]
    assert nu[1] > 1e3 * nu[6]


def test_withheld_runs_see_a_table_with_swapped_axes_and_runs_are_kept(make_table, model, ledger):
    table = make_table((6, 6, 2))
    before = ledger.counts().total
    make_table((6, 6, 2))
    assert ledger.counts().total == before
    x = somewhere(table.coordinates, 10)
    good = withheld(table, model, x, ledger=ledger, executor=InProcess())
    swapped = table.values.swapaxes(0, 1)[: len(table.axes[0])]
    wrong = FieldTable(table.coordinates, table.reference, table.axes, swapped, table.runs)
    bad = withheld(wrong, model, x, ledger=ledger, executor=InProcess())
    assert good.distance.max() < 1e-4 < 0.01 < bad.distance.max()
    np.testing.assert_allclose(good.simulated, exact(model, x), atol=1e-15)


def test_nodes_beyond_the_fold_and_points_outside_are_refused(table, model, ledger, tmp_path):
    soft, box = Folding(softness=1.2), LoadCoordinates(fold=Folding.FOLD, inertia=None)
    with Ledger.open(tmp_path / "ledger.sqlite", model=soft) as own, pytest.raises(NumericsError, match="its reach"):
        tabulate(soft, soft.undeformed(), intervals=(4, 2, 2), ledger=own, executor=InProcess(), coordinates=box)
    with pytest.raises(InvalidInput, match="outside"):
        withheld(table, model, np.array([[50.0, 0.5, 100.0]]), ledger=ledger, executor=InProcess())
    with pytest.raises(InvalidInput, match="reach"):
        replace(LoadCoordinates(), reach=1.0)


@pytest.mark.long
def test_table_of_the_coarse_biofilm_at_one_rate(tmp_path):
    """42 runs of a table at V = 110, and 3 that it does not know: a micrometre, where the largest move is 100."""
    biofilm = Biofilm(mesh="coarse")
    executor = LocalProcesses(workers=2)
    with Ledger.open(tmp_path / "ledger.sqlite", model=biofilm) as ledger:
        table = tabulate(biofilm, biofilm.undeformed(), intervals=(6, 6, 0), ledger=ledger, executor=executor)
        x = np.array([[420, 0.3, 110], [400, -0.1, 110], [600, 0.45, 110]], float)
        errors = withheld(table, biofilm, x, ledger=ledger, executor=executor)
    moved = np.linalg.norm(errors.simulated - table.reference, axis=-1).max()
    assert errors.distance.max() < 1e-3 < 0.03 < moved
