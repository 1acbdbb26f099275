"""Other fluids, inflows and top walls against developed flow, similarity, equilibrium at rest, and differences."""

from pathlib import Path

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import (
    SOLID,
    failure,
    importable,
    moved,
    rough,
    rough_cell,
    sensitivity_error,
)
from verification.validation.generality import layer

from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.model import Biofilm

BOTTOM = 0.2
"""Height of a flat layer, mm."""
STIFF = {"E": 1e10, "nu": 0.3}
FLUID = {"viscosity": "unknown", "density": "unknown", "force_x": "unknown", "force_y": "unknown"}


def velocities(model: Biofilm, inputs: dict[str, float], x: float) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and horizontal velocities of the nodes at x in the fluid, mm/s."""
    fields = model.fields(inputs)
    at = (np.abs(fields.points[:, 0] - x) < 1e-6) & (fields.points[:, 1] > BOTTOM - 1e-6)
    assert at.sum() > 4
    return fields.points[at, 1], fields.velocity[at, 0]


BETWEEN_WALLS = (lambda y: 0.5 * (y - BOTTOM) * (1 - y)), (lambda h: h**3 / 12)
BELOW_A_SLIPPERY_TOP = (lambda y: (y - BOTTOM) * (1 - BOTTOM - 0.5 * (y - BOTTOM))), (lambda h: h**3 / 3)


@pytest.mark.parametrize(
    ("options", "drive", "profile"),
    [
        ({"inflow": "pressure", "fluid": {"viscosity": 4e-3, "force_x": 500}}, {"p_drop": 11.0}, BETWEEN_WALLS),
        ({"inflow": "pressure", "channel": {"top": "symmetry"}}, {"p_drop": 6.0}, BELOW_A_SLIPPERY_TOP),
        ({"channel": {"top": "slip"}}, {"V_in": 85.0}, BELOW_A_SLIPPERY_TOP),
        ({"inflow": "plug", "length": 4.0}, {"V_in": 20.0}, BETWEEN_WALLS),
    ],
    ids=["pressure and force", "symmetry", "slip", "plug"],
)
def test_developed_flow_is_that_of_its_pressure_gradient(options, drive, profile):
    """V = G/μ · shape(y), of rate G/μ · integral; lengths in mm, so that Pa / (Pa s) is 1/s and V is in mm²/s.

    The force of 500 N/m³ is 0.5 Pa per mm.
    """
    model, (shape, integral) = layer(**options), profile
    y, v = velocities(model, STIFF | drive, model.channel.length)
    if "V_in" in drive:
        expected = drive["V_in"] / integral(1 - BOTTOM) * shape(y)
    else:
        expected = (drive["p_drop"] / 2.0 + model.fluid.force_x / 1e3) / model.fluid.viscosity * shape(y)
    np.testing.assert_allclose(v, expected, atol=(1e-3 if options.get("inflow") == "plug" else 1e-6) * expected.max())


def test_fluid_at_rest_under_a_vertical_force_has_the_hydrostatic_pressure():
    fields = layer(fluid={"force_y": -9810}).fields(STIFF | {"V_in": 0.0})
    fluid = fields.points[:, 1] > BOTTOM + 1e-6
    np.testing.assert_allclose(fields.velocity, 0.0, atol=1e-5)
    np.testing.assert_allclose(fields.pressure[fluid], 9.81 * (1 - fields.points[fluid, 1]), atol=1e-6)


def test_plug_table_and_function_enter_with_the_given_rate(tmp_path: Path, monkeypatch):
    own = importable(tmp_path, monkeypatch, "our_profiles", "def linear(y, bottom, top):\n    return y - bottom\n")
    table = {"table": [[0.0, 5.0], [BOTTOM, 0.0], [1.0, 8.0], [1.5, 8.0]]}
    for inflow in (table, f"{own}:linear"):
        y, found = velocities(layer(inflow=inflow), STIFF | {"V_in": 30.0}, 0.0)
        expected = 30.0 * 2 * (y - BOTTOM) / (1 - BOTTOM) ** 2
        np.testing.assert_allclose(found, expected, atol=1e-5 * expected.max())
    y, found = velocities(layer(inflow="plug"), STIFF | {"V_in": 20.0}, 0.0)
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


@pytest.mark.parametrize(
    ("options", "more"),
    [
        (
            {"fluid": FLUID},
            {"V_in": 100.0, "viscosity": 1.5e-3, "density": 900.0, "force_x": 100.0, "force_y": -200.0},
        ),
        ({"inflow": "pressure", "fluid": FLUID | {"density": 1000}},
         {"p_drop": 4.0, "viscosity": 1e-3, "force_x": 600.0, "force_y": -500.0}),
    ],
)  # fmt: skip
def test_sensitivities_by_every_quantity_of_the_fluid(options, more):
    model = rough(material="neo_hookean", **options)
    assert [item.name for item in model.inputs] == ["E", "nu", *more]
    assert sensitivity_error(model, SOLID | more) < 1e-6


@pytest.mark.parametrize(("inflow", "rate"), [("parabola", 60.0), ("pressure", 3.0)])
def test_the_load_path_takes_all_loads_along(inflow, rate):
    """The derivative by the load, against differences, with an inflow or a pressure, and a force."""
    force = Fluid(force_x=300.0, force_y=-400.0)
    cell = rough_cell("neo_hookean", fluid=force, inflow=inflow)
    x = cell.solve([400.0], [0.3], rate).unknowns
    cell.factorise(x, 0.7)
    exact = cell.by_load()
    difference = (cell.residual(x, 0.71) - cell.residual(x, 0.69)) / 0.02
    np.testing.assert_allclose(difference, exact, atol=1e-5 * np.abs(exact).max())


def test_a_soft_specimen_under_pressure_fails_with_the_pressure_it_reached():
    found = failure(rough(inflow="pressure"), {"E": 20.0, "nu": 0.3, "p_drop": 10.0})
    assert 0 < found.evidence["load_reached"] < 10
    assert " Pa" in found.message
    assert "p_drop" in found.message
