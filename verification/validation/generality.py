"""Exact sensitivities against differences, and their cost; those of other flow cells; developed flow."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.benchmarks.figures import medians, timed
from verification.validation.energies import FURTHER
from verification.validation.tables import Table, table

from strandline.models.biofilm.equations.flow import Fluid
from strandline.models.biofilm.materials import LAWS, further_parameters
from strandline.models.biofilm.mesh.geometry import Partition
from strandline.models.biofilm.mesh.outline import Channel, Outline
from strandline.models.biofilm.model import Biofilm

Points = Float[np.ndarray, "node 2"]
SPECIMENS = (
    {"E": 400.0, "nu": 0.3, "V_in": 100.0},
    {"E": 600.0, "nu": 0.499, "V_in": 100.0},
    {"E": 300.0, "nu": -0.5, "V_in": 80.0},
    {"E": 2000.0, "nu": 0.0, "V_in": 150.0},
    {"E1": 300.0, "E2": 500.0, "E3": 800.0, "nu1": 0.2, "nu2": 0.35, "nu3": -0.3, "V_in": 100.0},
)
"""Inputs of the study's specimens, the homogeneous one and the one with three parts."""
BOTTOM = 0.2
"""Height of a flat layer, mm."""
STEPS = (4e-2, 2e-2, 1e-2)
"""Steps, as shares of a value; see `_scale`."""


def specimen(inputs: Mapping[str, float], mesh: str) -> Biofilm:
    """Return the study's specimen that has these inputs."""
    return Biofilm(mesh=mesh, partition=Partition.PRESETS["three_parts"] if "E1" in inputs else Partition())


def extrapolated(function: Callable[[float], Points], at: float, steps: Sequence[float]) -> Points:
    """Return the derivative to sixth order from central differences with three steps, each half of the one before."""
    d = [(function(at + h) - function(at - h)) / (2 * h) for h in steps]
    once = [(4 * d[i + 1] - d[i]) / 3 for i in range(2)]
    return (16 * once[1] - once[0]) / 15


def cost(model: Biofilm, inputs: Mapping[str, float], *, repeats: int = 5) -> float:
    """Return the time by which all sensitivities prolong a run as a share of its time, by medians."""
    whole = replace(model, sensitivities=True)
    more, less = medians([(timed(whole, inputs), timed(model, inputs)) for _ in range(repeats)])
    return more / less - 1.0


def law_inputs(law: str) -> dict[str, float]:
    """Return inputs of the study's specimen with another law."""
    names = (item.name for item in further_parameters(LAWS[law]))
    further = dict(zip(names, FURTHER[law], strict=True))
    return {"E": 250.0 if further else 400.0, "nu": 0.3, **further, "V_in": 100.0}


def sensitivity_errors(model: Biofilm, inputs: Mapping[str, float]) -> dict[str, float]:
    """Return max |exact - difference| / max |exact| over the interface, by input.

    The differences are central with three steps, extrapolated to sixth order.
    """
    exact, found = replace(model, sensitivities=True)(inputs).sensitivities[""], {}
    for name, value in inputs.items():
        steps = [share * _scale(name, value) for share in STEPS]
        difference = extrapolated(lambda x, name=name: model({**inputs, name: x}).interface.points, value, steps)
        found[name] = float(np.abs(exact[name] - difference).max() / np.abs(exact[name]).max())
    return found


def _scale(name: str, value: float) -> float:
    """Return the size that steps of an input are shares of.

    It is small for ν, which the interface depends on steeply, above all near ½, and large for inputs that change it
    little: Newton's tolerance would show in small differences.
    """
    if name.startswith("nu"):
        return 0.05 * min(1.0, 200 * (0.5 - value))
    return abs(value) if name.startswith(("E", "V_in", "p_drop", "viscosity", "density")) else 8 * abs(value)


def layer(length: float = 2.0, **options: Any) -> Biofilm:
    """Return the model of a flat layer in a channel of this length, mm."""
    channel = {"length": length} | options.pop("channel", {})
    points = ((0.0, BOTTOM), (length / 2, BOTTOM), (length, BOTTOM))
    return _biofilm("coarse", outline={"points": points, "spline": False, "nodes": 21}, channel=channel, **options)


def _biofilm(mesh: str, **options: Any) -> Biofilm:
    """Return a neo-Hookean biofilm; options of its parts are mappings."""
    kinds: dict[str, Any] = {"channel": Channel, "outline": Outline, "fluid": Fluid}
    made = {name: kinds[name](**value) if name in kinds else value for name, value in options.items()}
    return Biofilm(mesh=mesh, material="neo_hookean", **made)


def velocities(model: Biofilm, drive: Mapping[str, float], x: float) -> tuple[np.ndarray, np.ndarray]:
    """Return heights and horizontal velocities [mm/s] of the fluid's nodes at x above a stiff layer."""
    fields = model.fields({"E": 1e10, "nu": 0.3, **drive})
    at = (np.abs(fields.points[:, 0] - x) < 1e-6) & (fields.points[:, 1] > BOTTOM - 1e-6)
    return fields.points[at, 1], fields.velocity[at, 0]


def developed_flow_errors() -> dict[str, float]:
    """Return the largest error of the velocity at the outlet above a stiff layer, as a share of the largest one.

    Between walls v = G (y - b) (h - y) / 2μ, below a top without friction v = G (y - b) (h - b - (y - b)/2) / μ, with
    the pressure gradient G, the layer's height b and the channel's height h.
    """
    wall, free = (lambda y: 0.5 * (y - BOTTOM) * (1 - y)), (lambda y: (y - BOTTOM) * (1 - BOTTOM - 0.5 * (y - BOTTOM)))
    rate = 20.0
    by_rate, half_rate = 12 * 1e-3 * rate / (1 - BOTTOM) ** 3, 3 * 1e-3 * rate / (1 - BOTTOM) ** 3
    thick = {"viscosity": 4e-3}
    cases: dict[str, tuple[Biofilm, dict[str, float], float, float, Any]] = {
        "pressure drop, water": (layer(inflow="pressure"), {"p_drop": 3.0}, 1.5, 1e-3, wall),
        "pressure drop, viscosity 4e-3 Pa s": (layer(inflow="pressure", fluid=thick), {"p_drop": 3.0}, 1.5, 4e-3, wall),
        "pressure drop and force along the channel": (
            layer(inflow="pressure", fluid={"force_x": 500.0}), {"p_drop": 1.0}, 1.0, 1e-3, wall,
        ),
        "pressure drop, symmetry at the top": (
            layer(inflow="pressure", channel={"top": "symmetry"}), {"p_drop": 1.0}, 0.5, 1e-3, free,
        ),
        "parabola, slip at the top": (layer(channel={"top": "slip"}), {"V_in": rate}, half_rate, 1e-3, free),
        "plug, 4 mm downstream": (layer(4.0, inflow="plug"), {"V_in": rate}, by_rate, 1e-3, wall),
    }  # fmt: skip
    found = {}
    for name, (model, drive, gradient, viscosity, profile) in cases.items():
        y, v = velocities(model, drive, model.channel.length)
        expected = gradient / viscosity * profile(y)
        found[name] = float(np.abs(v - expected).max() / expected.max())
    return found


def _flow_cells(mesh: str) -> dict[str, tuple[Biofilm, dict[str, float]]]:
    """Return a model and inputs for each law, and for each quantity of the fluid."""
    cells = {law: (Biofilm(mesh=mesh, material=law), law_inputs(law)) for law in LAWS}
    unknown = dict.fromkeys(("viscosity", "density", "force_x", "force_y"), "unknown")
    values = {"viscosity": 1.5e-3, "density": 900.0, "force_x": 100.0, "force_y": -200.0}
    solid = {"E": 400.0, "nu": 0.3}
    neo_hookean = partial(_biofilm, mesh)
    return cells | {
        "fluid": (neo_hookean(fluid=unknown), {**solid, "V_in": 100.0, **values}),
        "pressure drop": (neo_hookean(inflow="pressure"), {**solid, "p_drop": 10.0}),
        "plug, slip at the top": (neo_hookean(inflow="plug", channel={"top": "slip"}), {**solid, "V_in": 100.0}),
    }


def _of_specimens() -> list[tuple]:
    rows = []
    for inputs in SPECIMENS:
        model = specimen(inputs, "default")
        young, poisson = (", ".join(f"{inputs[k]:g}" for k in inputs if k.startswith(kind)) for kind in ("E", "nu"))
        share = 100 * cost(model, inputs)
        for name, error in sensitivity_errors(model, inputs).items():
            own = (name.replace("nu", "ν"), error, share if name == "V_in" else None)
            rows.append((f"{young}; {poisson}", inputs["V_in"], *own))
    return rows


def tables() -> list[Table]:
    """Return the tables of sensitivities, on the default mesh for the study's specimens, and of developed flow."""
    studied = "E, Pa; ν | V_in, mm²/s {g} | derivative by | relative difference {.1e} | cost of all, % of a solve {.0f}"
    rows = []
    for name, (model, inputs) in _flow_cells("coarse").items():
        rows += [(name, key, inputs[key], error) for key, error in sensitivity_errors(model, inputs).items()]
    heading = "flow cell | derivative by | at {g} | relative difference {.1e}"
    developed = "flow above a stiff layer | error of the velocity / its maximum {.0e}"
    return [
        table("sensitivities", "Exact sensitivities against central differences", studied, _of_specimens()),
        table("generality_sensitivities", "Sensitivities of other flow cells", heading, rows),
        table("generality_flow", "Developed flow", developed, developed_flow_errors().items()),
    ]
