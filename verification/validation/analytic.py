"""Closed forms: homogeneous deformations, a manufactured solution, Poiseuille flow, balances of force and mass.

The reference stresses are derived independently from the energies (`energies.py`); the laws under test are the model's.
"""

from collections.abc import Callable
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float
from netgen.geom2d import SplineGeometry
from scipy.optimize import brentq
from verification.validation.biofilm_mesh import flow_cell
from verification.validation.energies import FURTHER, isochoric_piola, shear_modulus, symbolic_piola, volume_piola
from verification.validation.tables import Table, observed_orders, table

from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.cell import FlowCell, Setting
from strandline.models.biofilm.equations.flow import STRESS_SCALE
from strandline.models.biofilm.equations.system import BoundaryNames, CoupledSystem
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.mesh.geometry import MESHES, MeshSize, Partition
from strandline.models.biofilm.mesh.outline import Channel, Outline

Tensor = Float[np.ndarray, "2 2"]
YOUNG = 3.0
RATIOS = (-0.9, -0.3, 0.0, 0.3, 0.49, 0.5)
STRETCH, SHEAR = 1.3, 0.4
VISCOSITY = 0.01
"""Scaled viscosity of water."""
SETTINGS = newton.NewtonSettings(tolerance=1e-12, maximum_jacobians=40, smallest_damping=1e-3)


def homogeneous(kind: str, law: str, poisson: float, amount: float) -> tuple[Tensor, Tensor]:
    """Return F and first Piola–Kirchhoff stress of ``uniaxial`` stretch with free sides, or simple ``shear``.

    A share `amount` in [0, 1] of it is applied. The stress pₛ is λ tr E (Saint-Venant–Kirchhoff) or λ ln J. At ν = ½
    it follows from equilibrium; if the law's constraint excludes simple shear (tr E = 0 of Saint-Venant–Kirchhoff), the
    height shrinks to satisfy it.
    """
    free = poisson == 0.5
    F = np.eye(2)
    if kind == "shear":
        F[0, 1] = amount * SHEAR
        if free and law == "saint_venant_kirchhoff":
            F[1, 1] = np.sqrt(1 - F[0, 1] ** 2)
        pressure = 0.2 * YOUNG * amount if free else _lame(poisson) * _volume_change(law, F)
    else:
        F[0, 0] = 1 + amount * (STRETCH - 1)
        F[1, 1] = _free_side(law, F[0, 0], poisson)
        pressure = _pressure_of_free_side(law, F, poisson)
    P = isochoric_piola(law, F, shear_modulus(YOUNG, poisson)) + np.asarray(volume_piola(law, F, float(pressure)))
    return F, P


def _pressure_of_free_side(law: str, F: Tensor, poisson: float) -> float:
    """Return pₛ at P₂₂ = 0, where F is diagonal."""
    share = F[1, 1] if law == "saint_venant_kirchhoff" else 1 / F[1, 1]
    return float(-isochoric_piola(law, F, shear_modulus(YOUNG, poisson))[1, 1] / share)


def _free_side(law: str, stretch: float, poisson: float) -> float:
    """Return the other stretch at P₂₂ = 0: (1-ν) E₂₂ = -ν E₁₁, or the root s of ν ln(stretch·s) = pₛ ν/λ."""
    if law == "saint_venant_kirchhoff":
        return float(np.sqrt(1 - poisson / (1 - poisson) * (stretch**2 - 1)))
    share = (1 + poisson) * (1 - 2 * poisson) / YOUNG  # ν/λ
    lowest = max(0.5, np.sqrt(-min(0.0, poisson) / (1 - 2 * min(0.0, poisson))))  # above this the left side increases

    def left(s: float) -> float:
        pressure = _pressure_of_free_side(law, np.diag([stretch, s]), poisson)
        return float(poisson * np.log(stretch * s) - share * pressure)

    return float(brentq(left, lowest, 2.0, xtol=1e-15))


def _volume_change(law: str, F: Tensor) -> float:
    return float(0.5 * np.trace(F.T @ F - np.eye(2)) if law == "saint_venant_kirchhoff" else np.log(np.linalg.det(F)))


def _lame(poisson: float) -> float:
    return YOUNG * poisson / ((1 + poisson) * (1 - 2 * poisson))


class LoadedSolid:
    """A block without fluid under dead loads: the coupled system, with a load vector subtracted from its residual."""

    def __init__(self, mesh: Any, law: str, poisson: float, fixed: str, *, remembers: bool = False) -> None:
        names = BoundaryNames(no_slip="", inlet="", fixed=fixed)
        self.coupled = CoupledSystem(mesh, names, viscosity=1.0, density=1.0, law=LAWS[law], remembers=remembers)
        self.coupled.set_material([YOUNG], [poisson], *([value] for value in FURTHER[law]))
        self.load: Float[np.ndarray, " unknown"] = np.zeros(len(self.coupled.free))

    def set_load(self, integrand: Callable[[Any], Any]) -> None:
        """Set the load from its virtual work, an integral over the test displacement."""
        form = ng.LinearForm(self.coupled.space)
        form += integrand(self.coupled.space.TestFunction()[2])
        form.Assemble()
        self.load = np.array(form.vec.FV().NumPy())[self.coupled.free]

    def residual(self, x: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        return self.coupled.residual(x) - self.load

    def factorise(self, x: Float[np.ndarray, " unknown"]) -> Any:
        return self.coupled.factorise(x)

    def prescribe(self, displacement: Any, boundary: str) -> None:
        """Set the displacement on a boundary; the unknowns do not change."""
        kept = np.array(self.coupled.values[self.coupled.free])
        part = self.coupled.state.components[2]
        part.Set(displacement, definedon=self.coupled.mesh.Boundaries(boundary))
        self.coupled.set_unknowns(kept)

    def solve(self) -> None:
        """Solve for equilibrium, starting from the present state."""
        x = np.array(self.coupled.values[self.coupled.free])
        self.coupled.set_unknowns(newton.solve(self, x, weights=np.ones(len(x)), settings=SETTINGS).x)


def square(size: float) -> Any:
    """Return the unit square with material ``solid`` and boundaries bottom, right, top and left."""
    geometry = SplineGeometry()
    geometry.AddRectangle((0, 0), (1, 1), bcs=("bottom", "right", "top", "left"))
    geometry.SetMaterial(1, "solid")
    return ng.Mesh(geometry.GenerateMesh(maxh=size))


def block_error(kind: str, law: str, poisson: float) -> tuple[float, float]:
    """Return the largest errors of displacement and, relative to E, of stress in a block held at its bottom.

    The other sides carry the traction of the closed form, applied in ten steps.
    """
    block = LoadedSolid(square(0.3), law, poisson, "bottom")
    for amount in np.linspace(0.1, 1.0, 10):
        F, P = homogeneous(kind, law, poisson, amount)
        G, P = F - np.eye(2), ng.CF(tuple(P.ravel()), dims=(2, 2))
        moved = ng.CF(tuple(G[i, 0] * ng.x + G[i, 1] * ng.y for i in range(2)))
        traction = P * ng.specialcf.normal(2)
        block.set_load(lambda test, t=traction: t * test * ng.ds("right|top|left"))
        block.prescribe(moved, "bottom")
        block.solve()
    d, pressure = block.coupled.state.components[2:]
    off = _largest(d - moved, block.coupled.mesh)
    mixed = LAWS[law](d, pressure, YOUNG, poisson, *FURTHER[law])
    stress = (ng.Id(2) + ng.Grad(d)) * mixed.second_piola - P
    return off, _largest(stress, block.coupled.mesh) / YOUNG


def _largest(function: Any, mesh: Any) -> float:
    rule = ng.IntegrationRule(ng.TRIG, 4)
    return float(np.abs(np.asarray(function(mesh.MapToAllElements(rule, ng.VOL)))).max())


def manufactured_errors(law: str, poisson: float, sizes: tuple[float, ...]) -> list[tuple[float, float]]:
    """Return L² errors of displacement and pₛ on meshes of the unit square for a chosen smooth displacement.

    The load is the divergence of the stress of this displacement, differentiated symbolically.
    """
    stream = 0.006 * (ng.sin(np.pi * ng.x) * ng.sin(np.pi * ng.y)) ** 2 * (1 + ng.x)
    exact = ng.CF((stream.Diff(ng.y), -stream.Diff(ng.x)))  # a swirl: the volume changes only to second order
    gradient = ng.CF(tuple(exact[i].Diff(s) for i in range(2) for s in (ng.x, ng.y)), dims=(2, 2))
    F = ng.Id(2) + gradient
    volume = 0.5 * ng.Trace(F.trans * F - ng.Id(2)) if law == "saint_venant_kirchhoff" else ng.log(ng.Det(F))
    pressure = _lame(poisson) * volume
    P = symbolic_piola(law, F, shear_modulus(YOUNG, poisson)) + volume_piola(law, F, pressure)
    force = -ng.CF(tuple(P[i, 0].Diff(ng.x) + P[i, 1].Diff(ng.y) for i in range(2)))
    errors = []
    for size in sizes:
        block = LoadedSolid(square(size), law, poisson, "bottom|right|top|left")
        block.set_load(lambda test: ng.InnerProduct(force, test) * ng.dx(bonus_intorder=6))
        block.coupled.state.components[2].Set(exact)  # a start near the root; Newton's method still has to find it
        block.solve()
        d, p = block.coupled.state.components[2:]
        errors.append(tuple(_l2(a - b, block.coupled.mesh) for a, b in ((d, exact), (p, pressure))))
    return errors


def _l2(difference: Any, mesh: Any) -> float:
    return float(np.sqrt(ng.Integrate(ng.InnerProduct(difference, difference), mesh, order=10)))


def poiseuille_error() -> tuple[float, float]:
    """Return the largest errors of velocity (share of the mean) and pressure (share of its drop) without a body."""
    geometry = SplineGeometry()
    geometry.AddRectangle((0, 0), (2, 1), bcs=("floor", "outlet", "top", "inlet"))
    geometry.SetMaterial(1, "fluid")
    mesh = ng.Mesh(geometry.GenerateMesh(maxh=0.25))
    names = BoundaryNames("floor|top", "inlet", "floor|top|inlet|outlet", "outlet")
    system = CoupledSystem(mesh, names, viscosity=VISCOSITY, density=1.0, solids=())
    exact = 6 * ng.y * (1 - ng.y)
    velocity, pressure = system.state.components[:2]
    velocity.Set(ng.CF((exact, 0)), definedon=mesh.Boundaries("inlet"))
    start = np.array(system.values[system.free])
    system.set_unknowns(newton.solve(system, start, weights=np.ones(len(start)), settings=SETTINGS).x)
    drop = 12 * VISCOSITY * 2
    off = velocity - ng.CF((exact, 0)), (pressure - 12 * VISCOSITY * (2 - ng.x)) / drop
    return _largest(off[0], mesh), _largest(off[1], mesh)


def layer_error() -> float:
    """Return the largest error of velocity (share of the mean) above a flat layer too stiff to move."""
    top = 0.2
    outline = Outline(((0.0, top), (1.0, top), (2.0, top)), spline=False, nodes=21).interface()
    size = MeshSize(far=0.2, interface=0.1, foot=0.1, grading=0.5)
    law = LAWS["neo_hookean"]
    cell = FlowCell(outline, size, channel=Channel(), partition=Partition(), law=law)
    cell.solve(Setting([1e9 * STRESS_SCALE], [0.3], 100.0))
    s = (ng.y - top) / (1 - top)
    exact = ng.IfPos(ng.y - top, 6 * s * (1 - s) / (1 - top), 0.0)
    return _largest(cell.system.state.components[0] - ng.CF((exact, 0)), cell.mesh)


def force_imbalance(cell: FlowCell) -> tuple[float, float]:
    """Return |force of fluid on interface - reaction at base| after a solve, x and y, relative to the force.

    Both are consistent residuals, tested with a field that is 1 on the boundary.
    """
    system = cell.system
    residual = system.full_residual()
    sums = []
    for component, name in ((0, "interface"), (2, "base")):
        part = system.space.Range(component)
        on = sorted({v.nr for e in system.mesh.Elements(ng.BND) if e.mat == name for v in e.vertices})
        rows = residual[part.start : part.stop].reshape(2, -1)[:, on]
        sums.append(rows.sum(axis=1))
    off = np.abs(sums[0] - sums[1]) / np.linalg.norm(sums[0])
    return float(off[0]), float(off[1])


def mass_imbalance(cell: FlowCell) -> float:
    """Return |outflow / inflow - 1| after a solve."""
    velocity = cell.system.state.components[0]
    rates = [ng.Integrate(velocity[0], cell.mesh, definedon=cell.mesh.Boundaries(n)) for n in ("inlet", "outlet")]
    return float(abs(rates[1] / rates[0] - 1))


def tables() -> list[Table]:
    """Return the tables of homogeneous states, manufactured solutions and balances."""
    kinds = ("uniaxial", "shear")
    blocks = [(kind, law, nu, *block_error(kind, law, nu)) for kind in kinds for law in LAWS for nu in RATIOS]
    heading = "deformation | law | ν {g} | error of displacement {.0e} | error of stress / E {.0e}"
    return [table("homogeneous", "Homogeneous deformations", heading, blocks), _manufactured_table(), _balance_table()]


def _manufactured_table() -> Table:
    sizes, rows = (0.2, 0.1, 0.05), []
    for law in LAWS:
        for poisson in (-0.5, 0.3, 0.49):
            errors = np.array(manufactured_errors(law, poisson, sizes))
            columns = [c for k in range(2) for c in (errors[:, k].tolist(), observed_orders(sizes, errors[:, k]))]
            rows += [(law, poisson, *row) for row in zip(sizes, *columns, strict=True)]
    heading = "law | ν {g} | h {g} | L² error of d {.2e} | order {.2f} | L² error of pₛ {.2e} | order of pₛ {.2f}"
    return table("manufactured", "Manufactured solution", heading, rows)


def _balance_table() -> Table:
    velocity, pressure = poiseuille_error()
    cell = flow_cell(MESHES["coarse"])
    cell.solve(Setting([400.0], [0.3], 100.0))
    x, y = force_imbalance(cell)
    rows = {
        "Poiseuille flow: velocity / mean": velocity,
        "Poiseuille flow: pressure / drop": pressure,
        "Poiseuille flow above a flat, stiff layer: velocity / mean": layer_error(),
        "force of the fluid on the biofilm against reaction at its base, x": x,
        "force of the fluid on the biofilm against reaction at its base, y": y,
        "outflow against inflow past the deformed biofilm": mass_imbalance(cell),
    }
    return table("balances", "Poiseuille flow and balances", "what | relative error {.0e}", rows.items())
