"""The forward model of the study: a biofilm on the floor of a flow cell, bent by the flow over it."""

import contextlib
import dataclasses
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from strandline.foundations import ForwardModelError, imported, require, unfit
from strandline.interface import Interface
from strandline.models.biofilm.cells.anchors import AnchoredCell, Box, Ranges, as_ranges, check_ranges
from strandline.models.biofilm.cells.cell import FlowCell, Setting, Solution
from strandline.models.biofilm.cells.creeping_cell import CreepingCell
from strandline.models.biofilm.cells.fields import FlowFields, flow_fields
from strandline.models.biofilm.cells.transient import TransientCell
from strandline.models.biofilm.equations import flow
from strandline.models.biofilm.equations.memory import MOST_BRANCHES, Branch, branch_inputs
from strandline.models.biofilm.linear import linear_solver
from strandline.models.biofilm.materials import LAWS, IsotropicLaw, SolidInputs, law_named
from strandline.models.biofilm.mesh.course import QUASI_STATIC, TRANSIENT, Course
from strandline.models.biofilm.mesh.geometry import FINER, MESHES, MeshSize, Partition, is_adapted, subdivide
from strandline.models.biofilm.mesh.outline import Channel, Outline, Pairs, check_clamped, check_inside, check_outline
from strandline.models.identity import fingerprint as fingerprint_of
from strandline.models.protocol import Factors, Gradient, ModelInput, Simulation
from strandline.parameters import Support

__all__ = ["Biofilm"]

REVISION = 2
"""Raised whenever the results of the model change by more than 1e-4 µm."""
SIZES = 1
"""Raised whenever the rule changes that shrinks elements in narrow gaps and at sharp bends of the outline."""
OF_CELL = ("channel", "partition", "fluid", "inflow", "clamped")
"""Options of the model that its flow cell takes as they are."""
SMALLEST_BUDGET = 3
LEAVE_OUT = "Leave one of the two out."


@dataclass(frozen=True)
class Biofilm:
    """Quasi-steady fluid–structure interaction of a soft solid on the floor of a channel, plane strain.

    Water enters with a parabolic profile of volume rate V_in and leaves on the other side. The output is the deformed
    interface, mm, at the nodes of the outline from left to right. The result is reproducible to the bit.

    Args:
        mesh: ``coarse`` (488 elements with the study's outline), ``default`` (1194) or ``fine`` (3454).
        material: Law of the solid: ``saint_venant_kirchhoff``, ``neo_hookean``, ``mooney_rivlin``, ``yeoh`` or
            ``fung``; or ``module:name`` of your own.
        channel: A `Channel`; by default 2 mm × 1 mm, inlet left, horizontal outflow.
        outline: An `Outline`; the study's by default.
        partition: A `Partition` of the solid into parts, each with its own E and ν.
        fluid: A `Fluid`, water by default; its ``unknown`` quantities are inputs.
        inflow: Profile of the inflow over the inlet, scaled to V_in: ``parabola``, ``plug``, ``module:name`` or pairs
            (y, v), y in mm, in a study ``{table: [[y, v], …]}``; or ``pressure``: the pressure drop `p_drop` is an
            input in place of V_in.
        clamped: Stretches (from, to) of the floor, mm, where the base is held; elsewhere it slides along the floor
            without friction and does not lift. By default all of the base is held.
        inflow_rates: Inflow rate of each of several experiments with the same specimen, mm²/s, by the name of the
            condition, in a study ``{slow: 50, fast: 100}``; V_in is no longer an input.
        pressure_drops: Likewise with ``inflow: pressure``: the drop of each experiment, Pa, in place of p_drop.
        course: A `Course` of the inflow with time: V_in is scaled by it, and each time observed is a condition.
        branches: Number of Maxwell branches of a solid that creeps, 0 to 3; E is then the modulus of the relaxed
            solid, and each branch adds the inputs ratio and tau. Needs a quasi-static course.
        sensitivities: Whether runs return d(interface)/d(input) as well.
        failure_budget: Number of Jacobians after which a run gives up its search for a steady state, so that a failure
            costs about three median runs; 0: no limit, every failed run is followed around its limit point (about
            five).
        anchors: (name, lowest, highest value) of each input, in a study ``{E: [100, 800], V_in: 100}``. Runs in this
            box start from states that are solved beforehand, and most need no Jacobian. The states are kept on disk
            for later campaigns.

    Raises:
        InvalidInput: an option that cannot be used; a degenerate outline, with the place; a linear solver that the
            environment requests but that is not installed.

    A run raises ForwardModelError with kind ``limit_point``, ``continuation_stalled``, ``inverted_elements``,
    ``unbalanced``, ``nonfinite_residual`` or ``linear_solve``, and with the load reached as evidence; a run through
    time also ``time_step``, with the time reached.
    """

    mesh: str = "default"
    material: str = "saint_venant_kirchhoff"
    channel: Channel = Channel()
    outline: Outline = Outline()
    partition: Partition = Partition()
    fluid: flow.Fluid = flow.WATER
    inflow: str | Pairs = field(default=flow.PARABOLA, metadata={"read": flow.as_inflow})
    clamped: Pairs = ()
    inflow_rates: tuple[tuple[str, float], ...] = field(default=(), metadata={"read": flow.as_inflow_rates})
    pressure_drops: tuple[tuple[str, float], ...] = field(default=(), metadata={"read": flow.as_pressure_drops})
    course: Course | None = None
    branches: int = 0
    sensitivities: bool = False
    failure_budget: int = 5
    anchors: Ranges = field(default=(), metadata={"read": as_ranges})
    failure_kinds: ClassVar[tuple[str, ...]] = (
        "limit_point", "continuation_stalled", "newton_stalled", "newton_maxit", "inverted_elements", "unbalanced",
        "nonfinite_residual", "linear_solve", "mesh", "time_step",
    )  # fmt: skip

    def __post_init__(self) -> None:
        if self.mesh not in MESHES:
            raise unfit("mesh of the biofilm model", self.mesh, f"one of {', '.join(MESHES)}")
        law_named(self.material)
        _check_budget(self.failure_budget)
        flow.check_loads(self.inflow_rates, self.pressure_drops, self.inflow)
        several, sensitivities = bool(self._loads), self.sensitivities
        _check_course(self.course, several=several, branches=self.branches, sensitivities=sensitivities)
        reference = self.outline.interface()
        check_inside(self.outline.points, self.channel)
        check_outline(reference, self.channel)
        subdivide(reference, self.channel, self.partition)
        check_clamped(self.clamped, reference)
        check_ranges(self.anchors, self.inputs, steady=self.course is None)
        if self.inflow != flow.PRESSURE:
            flow.entering(self.inflow, flow.inlet_bottom(reference, self.channel), self.channel.height)
        linear_solver()

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """E, nu, the law's further ones, or E1, nu1, …, E2, … of parts; V_in or p_drop; the fluid's; the branches'."""
        branches = (item for pair in branch_inputs(self.branches) for item in pair)
        return (*self._solid.all, *self._drive, *self.fluid.inputs, *branches)

    @property
    def _loads(self) -> tuple[tuple[str, float], ...]:
        """Inflow rates or pressure drops of several experiments, by condition; empty if there is one."""
        return self.inflow_rates or self.pressure_drops

    @property
    def _drive(self) -> tuple[ModelInput, ...]:
        return () if self._loads else (self._driven_by,)

    @property
    def _driven_by(self) -> ModelInput:
        return flow.DROP if self.inflow == flow.PRESSURE else flow.RATE

    @property
    def _solid(self) -> SolidInputs:
        return SolidInputs(law_named(self.material), max(1, len(self.partition.markers)))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the experiments or times, one interface each; a single unnamed one if there are none."""
        return tuple(name for name, _ in self._loads or (self.course.times if self.course else ())) or ("",)

    @property
    def fingerprint(self) -> str:
        """Text that identifies the model in a ledger.

        Sensitivities do not change the interface and do not count. The rule for element sizes counts only if it takes
        effect for the outline, so the ledgers of other outlines, including the study's, stay valid.
        """
        chosen = [
            f"{one.name}={getattr(self, one.name)!r}"
            for one in dataclasses.fields(self)
            if one.name not in ("mesh", "sensitivities") and getattr(self, one.name) != one.default
        ]
        if _is_adapted(self.outline, self.mesh, self.channel):
            chosen.append(f"sizes={SIZES}")
        if self.material not in LAWS:
            chosen.append(f"law={fingerprint_of(cast(Any, law_named(self.material)))}")
        if isinstance(self.inflow, str) and ":" in self.inflow:
            chosen.append(f"profile={fingerprint_of(imported(self.inflow, 'inflow'))}")
        digest = ":" + hashlib.sha256("|".join(chosen).encode()).hexdigest()[:16] if chosen else ""
        return f"biofilm:r{REVISION}:mesh={self.mesh}{digest}"

    def __call__(self, inputs: Mapping[str, Any], workdir: Path | None = None) -> Simulation:
        """Return the deformed interface at E [Pa], nu and V_in [mm²/s]; one for each condition."""
        cell, anchored = self._cell()
        interfaces, sensitivities, solutions = {}, {}, {}
        figures: dict[str, float] = {}
        for name, solution in self._solutions(cell, inputs, self.failure_budget, anchored=anchored):
            interfaces[name] = Interface.polyline(cell.outline.points + solution.displacement)
            solutions[name] = solution
            end = f"_{name}" if name else ""
            figures |= {key + end: value for key, value in solution.diagnostics().items()}
            if self.sensitivities:
                found = cell.sensitivities(solution, [q.name for q in self.fluid.inputs])
                sensitivities[name] = self._by_input(found, name)
        figures["mkl"] = float(linear_solver() == "pardiso")
        vjp = partial(self._pulled_back, dict(inputs), solutions) if self.offers_vjp else None
        return Simulation(interfaces, figures, sensitivities, vjp)

    @property
    def offers_vjp(self) -> bool:
        """Whether runs can be differentiated: not through inertia or creep, which depend on the past."""
        return not (self.branches or (self.course and self.course.is_transient))

    def _pulled_back(self, inputs: Mapping[str, Any], solutions: Mapping[str, Solution], factors: Factors) -> Gradient:
        """Return d(Σ factors · coordinates)/d(input) at the solutions of a run, by an adjoint solution for each."""
        cell, _ = self._cell()
        gradient: dict[str, Any] = {}
        for name, load in self._loads_at(inputs):
            if np.any(factors[name]):
                cell.hold(self._setting({**inputs, self._driven_by.name: load}))
                found = cell.pulled_back(solutions[name], factors[name][None], [q.name for q in self.fluid.inputs])
                by_input = self._by_input([one[0] for one in found], name)
                gradient = {of: gradient.get(of, 0.0) + value for of, value in by_input.items()}
        zeros = {item.name: 0.0 * np.asarray(inputs[item.name], float) for item in self.inputs}
        return gradient or zeros

    @property
    def preparation(self) -> str:
        """What `prepare_runs` solves."""
        return "anchors" if self.anchors else ""

    def is_prepared(self, inputs: Mapping[str, float]) -> bool:
        with contextlib.suppress(ForwardModelError):
            _, anchored = self._cell()
            loads = ({**inputs, self._driven_by.name: load} for _, load in self._loads_at(inputs))
            return anchored is not None and any(anchored.serves(at) for at in loads)
        return False

    def prepare_runs(self) -> None:
        """Solve the anchors, if there are any, unless they are on disk."""
        with contextlib.suppress(ForwardModelError):  # each run reports it
            self._cell()

    def undeformed(self) -> Interface:
        """Return the interface without flow, mm."""
        return self.outline.interface()

    def fields(self, inputs: Mapping[str, float], condition: str = "") -> FlowFields:
        """Return velocity, pressure and displacement of the solved state.

        Args:
            inputs: Inputs of the run by name.
            condition: Name of one of the inflow rates, pressure drops or times; by default the one with the largest
                inflow or pressure drop, the last of these.
        """
        cell, anchored = self._cell()
        wanted = condition or max(reversed(self._loads_at(inputs)), key=lambda load: load[1])[0]
        solutions = self._solutions(cell, inputs, 0, only=wanted, anchored=anchored)
        next(name for name, _ in solutions if name == wanted)
        return flow_fields(cell.system, cell.part)

    def on_finer_mesh(self, inputs: Mapping[str, Any]) -> dict[str, Interface]:
        """Return the deformed interfaces by condition on the next finer mesh, at the same nodes, to check the accuracy.

        Raises:
            ForwardModelError: The run fails.
        """
        cell = _new_cell(self._geometry, FINER[self.mesh], self._solid_density, creeps=self.branches > 0)
        return {
            name: Interface.polyline(cell.outline.points + solution.displacement)
            for name, solution in self._solutions(cell, inputs, self.failure_budget)
        }

    def _solutions(
        self,
        cell: FlowCell,
        inputs: Mapping[str, Any],
        budget: int,
        *,
        only: str | None = None,
        anchored: AnchoredCell | None = None,
    ) -> Iterator[tuple[str, Solution]]:
        """Yield each condition with its state, which the cell holds meanwhile; of steady ones, `only` that if given."""
        if self.course and isinstance(cell, TransientCell | CreepingCell):
            yield from cell.through(self.course, self._setting(inputs), budget)
            return
        for name, load in self._loads_at(inputs):
            if only in (None, name):
                at = {**inputs, self._driven_by.name: load}
                yield name, anchored.solve(at, budget) if anchored else cell.solve(self._setting(at), budget)

    def field_support(self, name: str) -> Support:
        """Return the points at which a run takes a field: for E the mesh's vertices in the solid.

        Raises:
            InvalidInput: Another input, several parts, a solid that creeps, anchors, or a law that is not isotropic.
        """
        self._require_field(name)
        points, areas = self._cell()[0].vertices_of_solid
        return Support(points, areas)

    def _require_field(self, name: str) -> None:
        against = {"partition": self.partition.markers, "branches": self.branches, "anchors": self.anchors}
        against["material"] = not isinstance(law_named(self.material), IsotropicLaw)
        beside = ", ".join(key for key, there in against.items() if there)
        if name != "E" or beside:
            expected = "E, of a model without partition, branches and anchors, and with an isotropic law"
            value = f"{name} with {beside}" if beside else name
            raise unfit("field of the biofilm model", value, expected, "Give this input a prior in place of a field.")

    def with_field(self, name: str, points: np.ndarray) -> "Biofilm":
        """Return the model itself; refuse a field as `field_support`, and other points than its own."""
        own = self.field_support(name).points
        same = points.shape == own.shape and np.allclose(points, own, rtol=0, atol=1e-9)
        found, expected = f"{len(points)} points", f"the {len(own)} points of field_support({name!r}), `at: solid`"
        require(same, f"points of the field {name}", found, expected, "Take these.")
        return self

    def _setting(self, inputs: Mapping[str, Any]) -> Setting:
        """Return what a run at these inputs is made with, among them what drives the flow.

        With a field as E, the typical modulus is its geometric mean.
        """
        if isinstance(field := inputs.get("E"), np.ndarray):
            self._require_field("E")
            typical = float(np.exp(np.log(field).mean()))
            return dataclasses.replace(self._setting({**inputs, "E": typical}), profile=field / typical)
        young, poisson, *further = self._solid.values(inputs)
        rate, fluid = float(inputs[self._driven_by.name]), self.fluid.at(inputs)
        pairs = branch_inputs(self.branches)
        branches = tuple(Branch(float(inputs[ratio.name]), float(inputs[tau.name])) for ratio, tau in pairs)
        return Setting(young, poisson, rate, tuple(further), fluid, branches)

    def _cell(self) -> tuple[FlowCell, AnchoredCell | None]:
        """Return the flow cell, and itself with its anchors if there are any."""
        loads = [load for _, load in self._loads if load > 0]
        if not self.anchors or (self._loads and not loads):
            return _flow_cell(self._geometry, self._solid_density, creeps=self.branches > 0), None
        drive = ((self._driven_by.name, min(loads), max(loads)),) if loads else ()
        anchored = _anchored_cell(self._geometry, Box((*self.anchors, *drive)))
        return anchored.cell, anchored

    @cached_property
    def _geometry(self) -> "Biofilm":
        """The model reduced to what affects mesh and forms."""
        kept = {name: getattr(self, name) for name in ("mesh", "material", "outline", *OF_CELL)}
        return Biofilm(**kept, failure_budget=0)

    @property
    def _solid_density(self) -> float | None:
        """Density of the solid in a transient run; None: no inertia."""
        return self.course.solid_density if self.course and self.course.is_transient else None

    def _loads_at(self, inputs: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
        """Return the conditions with their inflow rates or pressure drops."""
        if self._loads:
            return self._loads
        shares = self.course.shares() if self.course else {"": 1.0}
        return tuple((name, share * float(inputs[self._drive[0].name])) for name, share in shares.items())

    def _by_input(self, found: Sequence[Any], condition: str) -> dict[str, Any]:
        """Return the derivatives of a `FlowCell` by the name of the input; that by V_in, if any, times its share."""
        share = self.course.shares()[condition] if self.course else 1.0
        by_name = dict(zip([*self._solid.names, "", *(item.name for item in self.fluid.inputs)], found, strict=True))
        by_drive = by_name.pop("")
        return by_name | {item.name: share * by_drive for item in self._drive}


@lru_cache(maxsize=2)
def _flow_cell(model: Biofilm, solid_density: float | None = None, *, creeps: bool = False) -> FlowCell:
    return _new_cell(model, MESHES[model.mesh], solid_density, creeps=creeps)


@lru_cache(maxsize=2)
def _anchored_cell(model: Biofilm, box: Box) -> AnchoredCell:
    """Return the cell with anchors; a model reduced to its geometry."""
    return AnchoredCell.kept(_flow_cell(model), box, model._setting, model.fingerprint)


def _new_cell(model: Biofilm, size: MeshSize, solid_density: float | None, *, creeps: bool) -> FlowCell:
    given = {name: getattr(model, name) for name in OF_CELL} | {"law": law_named(model.material)}
    if solid_density is not None:
        return TransientCell(model.outline.interface(), size, solid_density=solid_density, **given)
    return (CreepingCell if creeps else FlowCell)(model.outline.interface(), size, **given)


@lru_cache(maxsize=16)
def _is_adapted(outline: Outline, mesh: str, channel: Channel) -> bool:
    return is_adapted(outline.interface(), MESHES[mesh], channel)


def _check_budget(budget: object) -> None:
    """Refuse a number of Jacobians that is neither 0 nor large enough."""
    if isinstance(budget, bool) or not isinstance(budget, int) or (budget != 0 and budget < SMALLEST_BUDGET):
        expected = f"a whole number of Jacobians, at least {SMALLEST_BUDGET}, or 0 for no limit"
        raise flow.refused("failure_budget", budget, expected)


def _check_course(course: Course | None, *, several: bool, branches: object, sensitivities: bool) -> None:
    """Refuse a course, or Maxwell branches, with what does not go with them, such as loads of `several` experiments."""
    if isinstance(branches, bool) or branches not in range(MOST_BRANCHES + 1):
        raise flow.refused("branches", branches, f"a whole number from 0 to {MOST_BRANCHES}")
    if branches and (course is None or course.is_transient):
        found = f"branches: {branches} with {'no course' if course is None else f'motion: {TRANSIENT}'}"
        expected = f"a course with motion: {QUASI_STATIC}, in which the solid creeps"
        raise flow.refused("branches", found, expected, "Add such a course, or remove the branches.")
    if branches and sensitivities:
        expected = "no branches, or no sensitivities: a solid that creeps offers none"
        raise flow.refused("sensitivities", f"sensitivities with branches: {branches}", expected, LEAVE_OUT)
    if course is not None and several:
        found = "a course with inflow_rates or pressure_drops"
        remedy = "Remove one of the two; V_in or p_drop is an input of a model with a course."
        raise flow.refused("course", found, "one of the two", remedy)
    if course is not None and sensitivities and course.is_transient:
        expected = f"motion: {QUASI_STATIC}, or no sensitivities: a transient run offers none"
        raise flow.refused("sensitivities", f"sensitivities with motion: {TRANSIENT}", expected, LEAVE_OUT)
