"""Other fluids, inflows and top walls against developed flow, similarity, equilibrium at rest, and differences."""

import sys
from pathlib import Path

import numpy as np
import pytest
from verification.validation.generality import sensitivity_errors

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition
from strandline.models.protocol import fingerprint

SOLID = {"E": 400.0, "nu": 0.3}
STIFF = {"E": 1e10, "nu": 0.3}
BOTTOM = 0.2
"""Height of a flat layer, mm."""
MU = 1e-3
"""Viscosity of water, Pa s."""
OWN = """
import numpy as np

def linear(y, bottom, top):
    return y - bottom

def wrong(y, bottom, top):
    return np.ones(3)
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of a third party's module of profiles."""
    (tmp_path / "our_profiles.py").write_text(OWN, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "our_profiles", raising=False)
    return "our_profiles"


def layer(length: float = 2.0, **options) -> Biofilm:
    """Return a flat layer on the floor of a channel."""
    channel = {"length": length} | options.pop("channel", {})
    outline = {"points": [[0, BOTTOM], [length / 2, BOTTOM], [length, BOTTOM]], "spline": False, "nodes": 21}
    return Biofilm.from_options(mesh="coarse", material="neo_hookean", outline=outline, channel=channel, **options)


def velocities(model: Biofilm, inputs: dict[str, float], x: float) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and horizontal velocities of the nodes at x in the fluid, mm/s."""
    fields = model.fields(inputs)
    at = (np.abs(fields.points[:, 0] - x) < 1e-6) & (fields.points[:, 1] > BOTTOM - 1e-6)
    assert at.sum() > 4
    return fields.points[at, 1], fields.velocity[at, 0]


def moved(model: Biofilm, inputs: dict[str, float]) -> np.ndarray:
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


@pytest.mark.parametrize("viscosity", [1e-3, 4e-3])
def test_a_pressure_drop_drives_poiseuille_flow(viscosity):
    """V = p h³ / 12 μ L between two walls; lengths in mm, so that Pa / (Pa s) is 1/s and V is in mm²/s."""
    model = layer(inflow="pressure", fluid={"viscosity": viscosity})
    free, drop = 1 - BOTTOM, 3.0
    for x in (0.0, 2.0):
        y, v = velocities(model, STIFF | {"p_drop": drop}, x)
        expected = drop / (2 * viscosity * 2.0) * (y - BOTTOM) * (1 - y)
        np.testing.assert_allclose(v, expected, atol=1e-6 * expected.max())
    rate = drop * free**3 / (12 * viscosity * 2.0)
    assert expected.max() == pytest.approx(1.5 * rate / free, rel=0.1)


@pytest.mark.parametrize("top", ["slip", "symmetry"])
@pytest.mark.parametrize("inflow", ["pressure", "parabola"])
def test_a_top_without_friction_makes_half_a_parabola(top, inflow):
    free, drop = 1 - BOTTOM, 1.0
    rate = drop * free**3 / (3 * MU * 2.0)
    drive = {"p_drop": drop} if inflow == "pressure" else {"V_in": rate}
    y, v = velocities(layer(inflow=inflow, channel={"top": top}), STIFF | drive, 2.0)
    s = (y - BOTTOM) / free
    expected = 3 * rate / free * s * (1 - s / 2)
    np.testing.assert_allclose(v, expected, atol=1e-6 * expected.max())


def test_half_a_channel_with_symmetry_is_the_whole_channel():
    """A layer below a channel of twice the free height is loaded by the same shear stress and pressure."""
    soft = {"E": 30.0, "nu": 0.3}
    half = moved(layer(channel={"height": 0.7, "top": "symmetry"}), soft | {"V_in": 25.0})
    whole = moved(layer(channel={"height": 1.2}), soft | {"V_in": 50.0})
    assert np.abs(half).max() > 5e-3
    np.testing.assert_allclose(half, whole, atol=2e-2 * np.abs(whole).max())  # the whole one may flow across its middle


def test_a_force_along_the_channel_is_a_pressure_gradient():
    """V = (p + f L) h³ / 12 μ L; 1 N/m³ is 1e-3 Pa per mm."""
    model = layer(inflow="pressure", fluid={"force_x": 500})
    y, v = velocities(model, STIFF | {"p_drop": 1.0}, 2.0)
    expected = (1.0 + 0.5 * 2.0) / (2 * MU * 2.0) * (y - BOTTOM) * (1 - y)
    np.testing.assert_allclose(v, expected, atol=1e-6 * expected.max())


def test_fluid_at_rest_under_a_vertical_force_has_the_hydrostatic_pressure():
    fields = layer(fluid={"force_y": -9810}).fields(STIFF | {"V_in": 0.0})
    fluid = fields.points[:, 1] > BOTTOM + 1e-6
    np.testing.assert_allclose(fields.velocity, 0.0, atol=1e-5)
    np.testing.assert_allclose(fields.pressure[fluid], 9.81 * (1 - fields.points[fluid, 1]), atol=1e-6)


def test_a_plug_develops_into_a_parabola():
    model = layer(4.0, inflow="plug")
    free, rate = 1 - BOTTOM, 20.0
    y, v = velocities(model, STIFF | {"V_in": rate}, 0.0)
    np.testing.assert_allclose(v[np.abs(y - BOTTOM) > 1e-6], rate / free, rtol=1e-6)
    y, v = velocities(model, STIFF | {"V_in": rate}, 4.0)
    expected = 6 * rate / free**3 * (y - BOTTOM) * (1 - y)
    np.testing.assert_allclose(v, expected, atol=1e-3 * expected.max())


def test_a_table_and_a_function_enter_with_the_given_rate(own):
    points = [[0.0, 5.0], [BOTTOM, 0.0], [1.0, 8.0], [1.5, 8.0]]
    y, by_table = velocities(layer(inflow={"table": points}), STIFF | {"V_in": 30.0}, 0.0)
    expected = 30.0 * 2 * (y - BOTTOM) / (1 - BOTTOM) ** 2
    np.testing.assert_allclose(by_table, expected, atol=1e-6 * expected.max())
    y, by_function = velocities(layer(inflow=f"{own}:linear"), STIFF | {"V_in": 30.0}, 0.0)
    np.testing.assert_allclose(by_function, expected, atol=1e-5 * expected.max())


def test_flow_from_the_right_is_the_mirror_image():
    shift = {inlet: moved(layer(inflow="plug", channel={"inlet": inlet}), SOLID | {"V_in": 50.0})[:, 0].mean()
             for inlet in ("left", "right")}  # fmt: skip
    np.testing.assert_allclose(shift["left"], -shift["right"], rtol=0.02)
    assert shift["left"] > 0


def test_the_interface_depends_on_dimensionless_groups_alone():
    """Viscosity, density and E twice as large, at the same velocity: the same Reynolds number and load over E."""
    fluid = {"viscosity": "unknown", "density": "unknown"}
    model = Biofilm.from_options(mesh="coarse", fluid=fluid)
    water = SOLID | {"V_in": 100.0, "viscosity": 1e-3, "density": 1000.0}
    twice = water | {"E": 800.0, "viscosity": 2e-3, "density": 2000.0}
    np.testing.assert_allclose(moved(model, water), moved(model, twice), atol=1e-9)
    np.testing.assert_allclose(moved(model, water), moved(Biofilm(mesh="coarse"), water), atol=1e-9)
    creeping, inert = (np.abs(moved(model, water | {"density": d}) - moved(model, water)).max() for d in (0.0, 999.0))
    assert creeping > 100 * inert > 0


FLUID = {"viscosity": "unknown", "density": "unknown", "force_x": "unknown", "force_y": "unknown"}


@pytest.mark.parametrize(
    ("options", "more"),
    [
        (
            {"fluid": FLUID},
            {"V_in": 100.0, "viscosity": 1.5e-3, "density": 900.0, "force_x": 100.0, "force_y": -200.0},
        ),
        ({"inflow": "pressure", "fluid": FLUID | {"density": 1000}},
         {"p_drop": 4.0, "viscosity": 1e-3, "force_x": 600.0, "force_y": -500.0}),
        ({"inflow": "plug", "channel": {"top": "slip"}}, {"V_in": 100.0}),
    ],
)  # fmt: skip
def test_sensitivities_by_every_quantity_of_the_fluid(options, more):
    model = Biofilm.from_options(mesh="coarse", material="neo_hookean", **options)
    assert [item.name for item in model.inputs] == ["E", "nu", *more]
    errors = sensitivity_errors(model, SOLID | more)
    assert set(errors) == set(SOLID | more)
    assert max(errors.values()) < 1e-6


@pytest.mark.parametrize("inflow", ["parabola", "pressure"])
def test_the_load_path_takes_all_loads_along(inflow):
    """The derivative by the load, against differences, with an inflow or a pressure, and a force."""
    cell = FlowCell(
        Outline(nodes=34).interface(),
        MESHES["coarse"],
        channel=Channel(),
        partition=Partition(),
        law=LAWS["neo_hookean"],
        fluid=Fluid(force_x=300.0, force_y=-400.0),
        inflow=inflow,
    )
    found = cell.solve([400.0], [0.3], 60.0 if inflow == "parabola" else 3.0)
    x = found.unknowns
    cell.factorise(x, 0.7)
    exact = cell.by_load()
    difference = (cell.residual(x, 0.71) - cell.residual(x, 0.69)) / 0.02
    np.testing.assert_allclose(difference, exact, atol=1e-5 * np.abs(exact).max())


def test_a_soft_specimen_under_pressure_fails_with_the_pressure_it_reached():
    model = Biofilm(mesh="coarse", inflow="pressure")
    with pytest.raises(ForwardModelError) as caught:
        model({"E": 20.0, "nu": 0.3, "p_drop": 10.0})
    assert 0 < caught.value.evidence["load_reached"] < 10
    assert " Pa" in caught.value.message
    assert "p_drop" in caught.value.message


def test_the_source_of_a_third_partys_profile_counts_in_the_fingerprint(own, tmp_path):
    before = fingerprint(Biofilm(inflow=f"{own}:linear"))
    (tmp_path / "our_profiles.py").write_text(OWN + "\n# another comment\n", "utf-8")
    assert fingerprint(Biofilm(inflow=f"{own}:linear")) != before


def test_known_quantities_of_the_fluid_are_no_inputs_and_count_in_the_fingerprint(own):
    models = [
        Biofilm(),
        Biofilm.from_options(fluid={"viscosity": 0.9e-3}),
        Biofilm.from_options(fluid={"viscosity": "unknown"}),
        Biofilm.from_options(inflow="plug"),
        Biofilm.from_options(inflow=f"{own}:linear"),
        Biofilm.from_options(inflow={"table": [[0, 1], [1, 1]]}),
        Biofilm.from_options(inflow="pressure"),
        Biofilm.from_options(channel={"top": "slip"}),
    ]
    assert len({fingerprint(model) for model in models}) == len(models)
    assert [item.name for item in models[1].inputs] == ["E", "nu", "V_in"]
    assert Biofilm.from_options(fluid={"viscosity": 1e-3, "density": 1000}).fingerprint == Biofilm().fingerprint


def test_several_pressure_drops_are_the_single_runs():
    model = Biofilm.from_options(
        mesh="coarse", inflow="pressure", pressure_drops={"low": 4, "high": 8}, sensitivities=True
    )
    assert model.conditions == ("low", "high")
    assert [item.name for item in model.inputs] == ["E", "nu"]
    found = model({"E": 400.0, "nu": 0.3})
    single = Biofilm(mesh="coarse", inflow="pressure", sensitivities=True)
    for name, drop in (("low", 4.0), ("high", 8.0)):
        alone = single({"E": 400.0, "nu": 0.3, "p_drop": drop})
        np.testing.assert_array_equal(found.interfaces[name].points, alone.interface.points)
        assert set(found.sensitivities[name]) == {"E", "nu"}
        np.testing.assert_array_equal(found.sensitivities[name]["E"], alone.sensitivities[""]["E"])
    assert model.fingerprint != single.fingerprint
    low, high = (model.fields({"E": 400.0, "nu": 0.3}, name).displacement for name in ("low", "high"))
    assert np.abs(low).max() < 0.7 * np.abs(high).max()


def test_several_rates_share_an_unknown_viscosity():
    model = Biofilm.from_options(
        mesh="coarse", sensitivities=True, fluid={"viscosity": "unknown"}, inflow_rates={"slow": 50, "fast": 100}
    )
    assert [item.name for item in model.inputs] == ["E", "nu", "viscosity"]
    found = model(SOLID | {"viscosity": 1e-3})
    assert {name: set(slopes) for name, slopes in found.sensitivities.items()} == {
        name: {"E", "nu", "viscosity"} for name in ("slow", "fast")
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fluid": {"viscosity": 0}}, r"viscosity of the fluid: got 0.*a number in \(0, inf\), in Pa s"),
        ({"fluid": {"viscosity": -1e-3}}, "viscosity of the fluid: got -0.001"),
        ({"fluid": {"density": -1}}, "density of the fluid: got -1"),
        ({"fluid": {"density": "unknwon"}}, "got unknwon"),
        ({"fluid": {"force_y": float("nan")}}, "force_y of the fluid: got nan"),
        ({"fluid": {"viscosty": 1e-3}}, "Did you mean viscosity"),
        ({"inflow": "plugg"}, "Did you mean plug"),
        ({"inflow": {"profile": "plug"}}, "inflow of the biofilm model"),
        ({"inflow": {"table": [[0, 1], [0.5, 2], [0.5, 1], [1, 0]]}}, "y = 0.5 mm after 0.5 mm"),
        ({"inflow": {"table": [[0.1, 1], [1, 1]]}}, "covers the inlet, from 0 to 1 mm"),
        ({"inflow": {"table": [[0, 1], [0.9, 1]]}}, "covers the inlet, from 0 to 1 mm"),
        ({"inflow": {"table": [[0, 0], [1, 0]]}}, "no net inflow"),
        ({"inflow": {"table": [[0, 0], [0.5, -2], [1, 0]]}}, r"got -2 at y = 0.5 mm.*velocities that enter"),
        ({"inflow": {"table": [[0, 1, 2], [1, 1, 1]]}}, "at least two pairs"),
        ({"inflow": "our_profiles:wrong"}, r"one velocity for each height"),
        ({"inflow": "our_profiles:missing"}, "a name defined in our_profiles"),
        ({"inflow": "pressure", "inflow_rates": {"slow": 1}}, "or give `pressure_drops` by condition"),
        ({"pressure_drops": {"low": 5}}, "got low: 5.0 without inflow: pressure; expected"),
        ({"inflow": "pressure", "pressure_drops": {"low": -5}}, "pressure drop 'low' of the biofilm model: got -5"),
        ({"inflow": "pressure", "pressure_drops": [5, 10]}, r"pressure drops in Pa by the name.*{slow: 5, fast: 10}"),
        ({"channel": {"top": "open"}}, "no_slip, slip, symmetry"),
    ],
)
def test_flows_that_cannot_be_are_refused_in_one_line(own, options, words):
    with pytest.raises(InvalidInput, match=words) as caught:
        Biofilm.from_options(**options)
    assert "\n" not in str(caught.value)
