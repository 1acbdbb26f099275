"""Other specimens than the study's: parts, several bodies, partly held feet, layers, larger channels."""

import numpy as np
from tests.unit.models.biofilm.cells import (
    INPUTS,
    coarse,
    largest,
    mirrored,
    moved,
    rough,
    sensitivity_error,
)
from verification.validation.analytic import force_imbalance, mass_imbalance

from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MeshSize
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm, _flow_cell
from strandline.models.biofilm.outline import Outline, bodies
from strandline.models.biofilm.subdivision import Partition

FIRST = [[0.8, 0.0], [0.9, 0.3], [1.0, 0.3], [1.1, 0.0]]
SECOND = [[2.9, 0.0], [3.0, 0.3], [3.1, 0.3], [3.2, 0.0]]
LONG = {"length": 4.0}
SLOW = {"E": 400.0, "nu": 0.3, "V_in": 50.0}
EACH = 12
"""Nodes of each of two bodies."""


def soft(**options) -> Biofilm:
    return rough(material="neo_hookean", **options)


def pair(**options) -> Biofilm:
    outline = {"points": [*FIRST, *SECOND], "nodes": 2 * EACH}
    return soft(channel=LONG | options.pop("channel", {}), outline=outline, **options)


# --- parts


def test_parts_of_equal_material_are_one_body_and_each_part_is_its_own():
    """The interface moves most where the part on the ground is softer, which bears the others."""
    three, one = coarse(material="fung", partition="three_parts"), {"E": 400.0, "nu": 0.3, "exponent": 1.0}
    equal = {f"{name}{k}": value for k in (1, 2, 3) for name, value in one.items()} | {"V_in": 100.0}
    assert [item.name for item in three.inputs] == list(equal)
    base = moved(three, equal)
    single = moved(coarse(material="fung"), one | {"V_in": 100.0})
    assert np.abs(base - single).max() < 3e-4  # two coarse meshes, each 0.15 µm from the truth
    for name, value, least in (("exponent", 6.0, 1e-6), ("E", 300.0, 1e-3)):
        shapes = [moved(three, {**equal, f"{name}{k}": value}) for k in (1, 2, 3)]
        changes = [np.abs(shape - base).max() for shape in shapes]
        assert min(changes) > least
        assert len({round(change, 7) for change in changes}) == 3
    sizes = [largest(shape) for shape in shapes]
    assert largest(base) < sizes[1] < sizes[0] < sizes[2]


# --- channels and layers


def test_a_larger_channel_loads_less_and_an_open_outlet_counts_only_near_it():
    usual = moved(rough(), INPUTS)
    assert np.abs(moved(rough(channel={"height": 1.5, "length": 3.0}), INPUTS)).max() < 0.5 * np.abs(usual).max()
    horizontal, opened = (moved(rough(channel=LONG | more), INPUTS) for more in ({}, {"outlet": "traction_free"}))
    assert 0 < np.abs(opened - horizontal).max() < 1e-2 * np.abs(horizontal).max()


def test_layer_is_sheared_downstream_by_the_wall_shear_stress():
    """Far from its ends a flat layer is in simple shear: u(top) = τ H/G with τ = 6 μ V/h², h the free height."""
    H, E, nu, V = 0.1, 1e5, 0.3, 100.0
    layer = Outline(((0.0, H), (2.0, H), (4.0, H)), spline=False, nodes=41)
    options = {"channel": Channel(length=4.0), "partition": Partition(), "law": LAWS["saint_venant_kirchhoff"]}
    shift = FlowCell(layer.interface(), MeshSize(0.2, 0.1, 0.1, 0.5), **options).solve([E], [nu], V).displacement
    np.testing.assert_allclose(shift[[0, -1]], 0.0)
    shear = 6e-3 * V / (1 - H) ** 2  # μ = 1e-3 Pa s, V in mm²/s, lengths in mm: Pa
    np.testing.assert_allclose(shift[20, 0], shear * H / (E / (2 * (1 + nu))), rtol=0.02)


# --- several bodies


def test_an_outline_of_two_bodies_keeps_their_feet_and_shares_its_nodes():
    points = Outline(tuple(map(tuple, FIRST + SECOND)), nodes=60).interface().points
    first, second = (points[body] for body in bodies(points))
    assert len(first) == len(second) == 30
    for body, given in ((first, FIRST), (second, SECOND)):
        np.testing.assert_array_equal(body[[0, -1]], [given[0], given[-1]])
        assert (body[1:-1, 1] > 0).all()
        np.testing.assert_allclose(body[:, 1].max(), 0.3, rtol=0.15)
    kept = Outline(tuple(map(tuple, FIRST + SECOND)), spline=False, nodes=None).interface().points
    np.testing.assert_array_equal(kept, FIRST + SECOND)


def test_two_bodies_in_flow_from_the_right_are_the_mirror_image_and_their_forces_balance():
    left, right = (pair(channel={"inlet": inlet}) for inlet in ("left", "right"))
    shift = moved(left, SLOW)
    np.testing.assert_allclose(mirrored(moved(right, SLOW)), shift, atol=4e-2 * np.abs(shift).max())
    assert np.abs(shift[:EACH] - shift[EACH:]).max() > 0.1 * np.abs(shift).max()
    cell = _flow_cell(left._geometry)
    cell.solve([400.0], [0.3], 50.0)
    assert max(force_imbalance(cell)) < 1e-8
    assert mass_imbalance(cell) < 1e-9


def test_markers_give_each_body_its_own_material():
    model = pair(partition={"lines": [], "markers": [[0.95, 0.1], [3.05, 0.1]]})
    names = [item.name for item in model.inputs]
    assert names == ["E1", "nu1", "E2", "nu2", "V_in"]
    equal, one = dict(zip(names, (400.0, 0.3, 400.0, 0.3, 50.0), strict=True)), moved(pair(), SLOW)
    np.testing.assert_allclose(moved(model, equal), one, atol=1e-9)
    assert np.abs(moved(model, equal | {"E2": 200.0})[EACH:]).max() > 1.5 * np.abs(one[EACH:]).max()
    assert sensitivity_error(model, equal | {"E2": 300.0}) < 1e-6


# --- feet that are held in part


def test_the_less_is_held_the_more_it_moves_and_a_free_foot_slides_along_the_floor():
    whole = [[0.54, 1.391]]
    usual, held = moved(soft(), SLOW), moved(soft(clamped=whole), SLOW)
    np.testing.assert_allclose(held, usual, atol=1e-3 * np.abs(usual).max())
    np.testing.assert_allclose(held[[0, -1]], 0.0, atol=1e-15)
    shapes = [held, *(moved(soft(clamped=[one]), SLOW) for one in ([0.6, 1.3], [0.85, 1.05]))]
    sizes = [largest(shape) for shape in shapes]
    assert sizes == sorted(sizes)
    assert sizes[-1] > 1.3 * sizes[0]
    feet = shapes[-1][[0, -1]]
    np.testing.assert_allclose(feet[:, 1], 0.0, atol=1e-15)
    assert (feet[:, 0] > 1e-3).all()


def test_a_partly_held_foot_has_its_mirror_image():
    points = [[0.5, 0], [0.8, 0.35], [1.2, 0.35], [1.5, 0]]
    left = moved(soft(outline={"points": points}, clamped=[[0.6, 0.9]]), SLOW)
    right = moved(soft(outline={"points": points}, clamped=[[1.1, 1.4]], channel={"inlet": "right"}), SLOW)
    np.testing.assert_allclose(mirrored(right), left, atol=2e-2 * np.abs(left).max())
    assert left[:, 0].mean() > 0
