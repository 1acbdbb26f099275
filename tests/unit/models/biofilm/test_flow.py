"""Other flow cells than the study's: fluids, inflows and tops; layers, parts, several bodies, partly held feet.

Against developed flow, similarity, equilibrium at rest, mirror images, balances and differences.
"""

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import PAIR, SOLID, coarse, largest, moved, rough, sensitivity_error
from verification.validation.analytic import force_imbalance, mass_imbalance
from verification.validation.generality import BOTTOM, layer, velocities

from strandline.models.biofilm.cells.cell import FlowCell, Setting
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.mesh.geometry import MeshSize, Partition
from strandline.models.biofilm.mesh.outline import Channel, Outline
from strandline.models.biofilm.model import _flow_cell

FLUID = dict.fromkeys(("viscosity", "density", "force_x", "force_y"), "unknown")


def test_fluid_at_rest_under_a_vertical_force_has_the_hydrostatic_pressure():
    fields = layer(fluid={"force_y": -9810.0}).fields({"E": 1e10, "nu": 0.3, "V_in": 0.0})
    fluid = fields.points[:, 1] > BOTTOM + 1e-6
    np.testing.assert_allclose(fields.velocity, 0.0, atol=1e-5)
    np.testing.assert_allclose(fields.pressure[fluid], 9.81 * (1 - fields.points[fluid, 1]), atol=1e-6)


BETWEEN_WALLS = (lambda y: 0.5 * (y - BOTTOM) * (1 - y)), (lambda h: h**3 / 12)
BELOW_A_SLIPPERY_TOP = (lambda y: (y - BOTTOM) * (1 - BOTTOM - 0.5 * (y - BOTTOM))), (lambda h: h**3 / 3)


@pytest.mark.parametrize(
    ("options", "drive", "profile"),
    [
        ({"inflow": "pressure", "fluid": {"viscosity": 4e-3, "force_x": 500.0}}, {"p_drop": 11.0}, BETWEEN_WALLS),
        ({"inflow": "pressure", "channel": {"top": "symmetry"}}, {"p_drop": 6.0}, BELOW_A_SLIPPERY_TOP),
        ({"channel": {"top": "slip"}}, {"V_in": 20.0}, BELOW_A_SLIPPERY_TOP),
        ({"inflow": "plug", "length": 4.0}, {"V_in": 20.0}, BETWEEN_WALLS),
    ],
)
def test_developed_flow_is_that_of_its_pressure_gradient(options, drive, profile):
    """V = G/μ · shape(y), of rate G/μ · integral; lengths in mm, so that Pa / (Pa s) is 1/s and V is in mm²/s.

    The force of 500 N/m³ is 0.5 Pa per mm.
    """
    model, (shape, integral) = layer(**options), profile
    y, v = velocities(model, drive, model.channel.length)
    if "V_in" in drive:
        expected = drive["V_in"] / integral(1 - BOTTOM) * shape(y)
    else:
        expected = (drive["p_drop"] / 2.0 + model.fluid.force_x / 1e3) / model.fluid.viscosity * shape(y)
    np.testing.assert_allclose(v, expected, atol=(1e-3 if options.get("inflow") == "plug" else 1e-6) * expected.max())


def test_plug_table_and_function_enter_with_the_given_rate(own):
    table = ((0.0, 5.0), (BOTTOM, 0.0), (1.0, 8.0), (1.5, 8.0))
    for inflow in (table, f"{own}:profile"):
        y, found = velocities(layer(inflow=inflow), {"V_in": 30.0}, 0.0)
        expected = 30.0 * 2 * (y - BOTTOM) / (1 - BOTTOM) ** 2
        np.testing.assert_allclose(found, expected, atol=1e-5 * expected.max())
    y, found = velocities(layer(inflow="plug"), {"V_in": 20.0}, 0.0)
    np.testing.assert_allclose(found[np.abs(y - BOTTOM) > 1e-6], 20.0 / (1 - BOTTOM), rtol=1e-6)


def test_the_interface_depends_on_dimensionless_groups_alone():
    """Viscosity, density and E twice as large, at the same velocity: the same Reynolds number and load over E."""
    model = rough(fluid={"viscosity": "unknown", "density": "unknown"})
    water = SOLID | {"V_in": 100.0, "viscosity": 1e-3, "density": 1000.0}
    twice = water | {"E": 800.0, "viscosity": 2e-3, "density": 2000.0}
    usual = moved(model, water)
    np.testing.assert_allclose(usual, moved(model, twice), atol=1e-9)
    np.testing.assert_allclose(usual, moved(rough(), water), atol=1e-9)
    creeping, inert = (np.abs(moved(model, water | {"density": d}) - usual).max() for d in (0.0, 999.0))
    assert creeping > 100 * inert > 0


FREE = {"V_in": 100.0, "viscosity": 1.5e-3, "density": 900.0, "force_x": 100.0, "force_y": -200.0}
DRIVEN = {"p_drop": 4.0, "viscosity": 1e-3, "force_x": 600.0, "force_y": -500.0}


@pytest.mark.parametrize(("inflow", "fluid", "more"), [("parabola", {}, FREE), ("pressure", {"density": 1e3}, DRIVEN)])
def test_sensitivities_by_every_quantity_of_the_fluid(inflow, fluid, more):
    model = rough(material="neo_hookean", inflow=inflow, fluid=FLUID | fluid)
    assert [item.name for item in model.inputs] == ["E", "nu", *more]
    assert sensitivity_error(model, SOLID | more) < 1e-6


SOFT = {"material": "neo_hookean"}
SLOW = {"E": 400.0, "nu": 0.3, "V_in": 50.0}
EACH = 12
"""Nodes of each of two bodies."""


def pair(inlet="left", **options):
    channel = {"length": 4.0, "inlet": inlet}
    return rough(**SOFT, channel=channel, outline={"points": PAIR, "nodes": 2 * EACH}, **options)


def test_parts_of_equal_material_are_one_body_and_each_part_is_its_own():
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


def test_layer_is_sheared_downstream_by_the_wall_shear_stress():
    """Far from its ends a flat layer is in simple shear: u(top) = τ H/G with τ = 6 μ V/h², h the free height."""
    H, E, nu, V, height = 0.1, 1e5, 0.3, 100.0, 1.2
    layer = Outline(((0.0, H), (2.0, H), (4.0, H)), spline=False, nodes=41)
    options = {"channel": Channel(4.0, height), "partition": Partition(), "law": LAWS["saint_venant_kirchhoff"]}
    shift = (
        FlowCell(layer.interface(), MeshSize(0.2, 0.1, 0.1, 0.5), **options).solve(Setting([E], [nu], V)).displacement
    )
    np.testing.assert_allclose(shift[[0, -1]], 0.0)
    shear = 6e-3 * V / (height - H) ** 2  # μ = 1e-3 Pa s, V in mm²/s, lengths in mm: Pa
    np.testing.assert_allclose(shift[20, 0], shear * H / (E / (2 * (1 + nu))), rtol=0.02)


def test_two_bodies_in_flow_from_the_right_are_the_mirror_image_and_their_forces_balance():
    left, right = pair("left"), pair("right")
    shift = moved(left, SLOW)
    mirrored = moved(right, SLOW)[::-1] * [-1, 1]
    np.testing.assert_allclose(mirrored, shift, atol=4e-2 * np.abs(shift).max())
    assert np.abs(shift[:EACH] - shift[EACH:]).max() > 0.1 * np.abs(shift).max()
    cell = _flow_cell(left._geometry)
    cell.solve(Setting([400.0], [0.3], 50.0))
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


def test_the_less_is_held_the_more_it_moves_and_a_free_foot_slides_along_the_floor():
    usual, stretches = moved(rough(**SOFT), SLOW), ([0.54, 1.391], [0.6, 1.3], [0.85, 1.05])
    shapes = [moved(rough(**SOFT, clamped=[stretch]), SLOW) for stretch in stretches]
    np.testing.assert_allclose(shapes[0], usual, atol=1e-3 * np.abs(usual).max())
    np.testing.assert_allclose(shapes[0][[0, -1]], 0.0, atol=1e-15)
    sizes = [largest(shape) for shape in shapes]
    assert sizes == sorted(sizes)
    assert sizes[-1] > 1.3 * sizes[0]
    feet = shapes[-1][[0, -1]]
    np.testing.assert_allclose(feet[:, 1], 0.0, atol=1e-15)
    assert (feet[:, 0] > 1e-3).all()
