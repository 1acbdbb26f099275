"""The batches of an active design, chosen as a campaign asks for them, with reports on them and the certificate."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.design.active.active_design import ActiveDesign, Batch, Step
from strandline.design.active.chains import chain_state
from strandline.design.active.choice import Active
from strandline.design.active.coverage_runs import MOST_SEEN, SURE, least_found
from strandline.design.active.exact_draws import ExactDraws
from strandline.design.active.fidelities import Fidelities, FidelityReport
from strandline.design.active.informed_design import InformedDesign
from strandline.design.active.posterior_check import NONE, SimulatorNoise
from strandline.design.active.state import Knowledge, State, hidden_shift, learn, posterior_state
from strandline.design.run_filter import RunFilter
from strandline.discrepancy import Discrepancy
from strandline.foundations import NoCommonPoints, TooFewRuns, html_table, one_thread, with_sd
from strandline.models import by_cheaper
from strandline.parameters import ParameterSpace
from strandline.runs import PlainBatch, RunRecord
from strandline.smc import StepInfo

NEXT = {
    "batch": "a batch",
    "check": "check",
    "trial": "the correction is tried again",
    "exact": "draws of the true posterior",
    "done": "done, converged",
    "stop": "stop, not converged",
}
FAR = 0.5  # share of draws still effective below which a posterior has moved too far to say by how much
SHOWN = 3  # inputs whose mean and standard deviation a line has room for
Points = Float[np.ndarray, "run dim"]
AFRESH = 1  # keeps the random numbers of a posterior that is sampled afresh apart from those of the one before


@dataclass(frozen=True, eq=False)
class VarianceEffect:
    """Effect of the field's uncertainty on the posterior: expected likelihood compared with the plug-in one.

    It has the shift of the means, in standard deviations, the ratio of the standard deviations, and the effective
    sample size of the weights between the two, as a share.
    """

    shift: Float[np.ndarray, " dim"]
    sd_ratio: Float[np.ndarray, " dim"]
    effective: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """Grounds for trusting the posterior of an active design.

    It `converged` if it stopped because its tolerances were met; else `reasons` say why not, in words. `steps` are the
    posterior after each of the `batches`; the result is computed from the last one, and `checked` is the one with the
    last check. `found` is the smallest share of the prior's mass such that 95 % of all compact regions with this share
    hold a run; None for more than ten inputs. `fidelities` tells what a cheaper model was used for, `scattered` whether
    the simulator's own scatter keeps it from converging, `drawn` how many draws of the true posterior there are, in
    words, if there are any, `overlooks` whether the runs were too few to find a region as small as `Active.unseen`.
    """

    converged: bool
    reasons: tuple[str, ...]
    steps: tuple[Step, ...]
    batches: tuple[Batch, ...]
    checked: Step | None
    found: float | None = 1.0
    fidelities: FidelityReport | None = None
    scattered: bool = False
    drawn: str = ""
    overlooks: bool = False

    @property
    def statement(self) -> str:
        """What the runs have seen of the prior, in words."""
        if self.found is None:
            return "With so many inputs, the runs cannot tell whether another region fits."
        if self.found >= 1:
            return "The runs are too few to say whether another region fits."
        return (
            f"With {SURE:.0%} probability, the runs would have found any other compact region that fits, if it holds "
            f"{self.found:.0%} or more of the prior's mass. A smaller or a narrow one may have been missed."
        )

    def __repr__(self) -> str:
        runs = self.steps[-1].runs if self.steps else 0
        state = "converged" if self.converged else "not converged: " + "; ".join(self.reasons)
        return f"<Certificate after {runs} runs: {state}>"

    def _repr_html_(self) -> str:
        moved = ["" if step.moved is None else f"{step.moved.shift:.2g}" for step in self.steps]
        rows = [(str(step.runs), step.kind, by) for step, by in zip(self.steps, moved, strict=True)]
        return html_table(("runs", "batch", "posterior moved by, sd"), rows, caption=repr(self)[1:-1])


@dataclass(frozen=True, eq=False)
class FieldOutcome:
    """Results of a calibration by a surrogate of the field besides the posterior.

    `effect` is that of the surrogate's variance on the posterior, `feasible` the posterior mean of the probability that
    a run succeeds, relative to the safest one. A fixed design has no `certificate`. `compared` are means and standard
    deviations of the posterior from the log-likelihood surrogate of the same runs, `without_error` those for a model
    that does not err, if an error was allowed for. `scatter` is the simulator's own, and what it does to the
    log-likelihood.
    """

    knowledge: Knowledge
    effect: VarianceEffect
    feasible: float
    certificate: Certificate | None = None
    compared: Mapping[str, Float[np.ndarray, " dim"]] | None = None
    without_error: Mapping[str, Float[np.ndarray, " dim"]] | None = None
    scatter: SimulatorNoise = NONE

    @property
    def by_chains(self) -> bool:
        """Whether the posterior was sampled by Hamiltonian chains, as that of many inputs is."""
        return self.knowledge.surrogate.shares_kernel

    def __repr__(self) -> str:
        return f"<FieldOutcome {self.certificate or 'of a fixed design'!r}>"


@dataclass(frozen=True)
class BatchReport:
    """The posterior after a batch, the first design being number 1, and what comes next.

    `posterior` has mean and standard deviation of each calibrated input by its symbol, as text. `moved` is how far it
    has moved, in standard deviations: infinite if it is too far to say; None if there is none to compare with.
    `objection` is that of a check, `dropped` why a cheaper model is not used any more, both in words; empty if there is
    none, or if it was told before.
    """

    number: int
    posterior: tuple[str, ...]
    moved: float | None
    next: str
    objection: str = ""
    dropped: str = ""

    @property
    def line(self) -> str:
        """``batch 3: E 396 ± 31, moved 0.05 sd; next: check``."""
        shown = ", ".join(self.posterior[:SHOWN]) + (", …" if len(self.posterior) > SHOWN else "")
        moved = ""
        if self.moved is not None:
            moved = ", moved too far to say by how much" if math.isinf(self.moved) else f", moved {self.moved:.2f} sd"
        objection = f"; check: {self.objection}" if self.objection else ""
        dropped = f"; the cheaper model is no longer used: {self.dropped}" if self.dropped else ""
        return f"batch {self.number}: {shown}{moved}{objection}{dropped}; next: {NEXT[self.next]}"


def report_batch(design: ActiveDesign, space: ParameterSpace) -> BatchReport:
    """Return the report on the last step of `design`, which has decided what comes next."""
    step: Step = design.steps[-1]
    coming = "done" if design.converged else "stop"
    if not design.converged and not design.reasons:
        kind = design.batches[-1].kind
        coming = kind if kind in NEXT else "batch"
    shown = [(one.shown, i) for i, one in enumerate(space) if not one.nuisance and one.name in space.scalars]
    posterior = tuple(f"{name} {with_sd(float(step.mean[i]), float(step.sd[i]))}" for name, i in shown)
    posterior += tuple(f"{one.name}: field of {one.count} modes" for one in space.fields)
    objection = "" if step.check is None or not step.check.reasons else step.check.reasons[0]
    moved = None if step.moved is None else step.moved.shift if step.moved.effective >= FAR else math.inf
    return BatchReport(len(design.steps), posterior, moved, coming, objection)


@dataclass
class ActiveRuns:
    """Choose the batches of a campaign for `run_batches`, and keep a record of them.

    `batch` is the number of runs chosen together, `scramble` the seed of the Sobol sequence of the first runs, None for
    the plain one. `judge` decides which runs can be used; `aside` returns a context in which each batch is chosen,
    `inputs` all inputs by name, given the unknown ones. `on_step` is called after each tempering step of the sampling
    that begins each choice, `told` with a report of each batch once the posterior is updated. By default, there are as
    many `particles` as the number of inputs needs. An `informed` design is that of many inputs with sensitivities.
    """

    active: Active
    space: ParameterSpace
    discrepancy: Discrepancy
    batch: int
    seed: int
    scramble: int | None
    judge: RunFilter
    aside: Callable[[], Any]
    inputs: Callable[[Points], list[dict[str, float]]]
    fidelities: Fidelities | None = None
    on_step: Callable[[StepInfo], None] | None = None
    told: Callable[[BatchReport], None] = lambda report: None
    particles: int | None = None
    informed: bool = False
    design: ActiveDesign = field(init=False)
    _given: int = field(init=False, default=0)
    _told_dropped: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        sampling: dict[str, Any] = {"on_step": self.on_step, "particles": self.particles}

        def state(x: Points, records: Sequence[RunRecord]) -> State:
            of = self.judge.observations, self.discrepancy
            known = learn(x, records, self.space, *of, shared=self.active.differences)
            seed = self.seed, len(x)
            if self.informed and known.surrogate.shares_kernel:
                return chain_state(known, self.space, seed, self.design.state)
            return posterior_state(known, self.space, seed, before=self.design.state, **sampling)

        def afresh(state: State) -> State:
            seed = self.seed, len(state.knowledge.x), AFRESH
            return posterior_state(state.knowledge, self.space, seed, **sampling)

        kind = InformedDesign if self.informed else ActiveDesign
        self.design = kind(
            self.active,
            self.space,
            batch=self.batch,
            learn=state,
            afresh=afresh,
            log_likelihood=self._true,
            seed=self.seed,
            scramble=self.scramble,
            doubts=lambda state: () if self.fidelities is None else self.fidelities.doubts(),
            another_trial=lambda: self.fidelities is not None and self.fidelities.correction is not None,
        )

    def _hidden(self, state: State | None) -> float:
        """Return the shift of an interface that the noise hides, mm."""
        return hidden_shift(self.judge.observations, self.discrepancy) if state is None else state.knowledge.hidden

    def _true(self, record: RunRecord) -> float:
        """Return the log-likelihood of a run, with the noise as it is known so far."""
        state = self.design.state
        inferred = None if state is None else state.knowledge.likelihood.inferred
        if inferred is None:
            return self.judge.value(self.judge.first, record)
        return inferred.likelihood.one(record.interfaces)

    def points(self, records: Sequence[RunRecord]) -> Points:
        return np.array([[record.inputs[name] for name in self.space.names] for record in records], float)

    def __call__(self, records: Sequence[RunRecord]) -> Sequence[Mapping[str, float]]:
        """Return the inputs of the next batch, none to stop; more of the first design if too few runs succeeded."""
        with self.aside(), one_thread():
            if self.fidelities is not None:
                self.fidelities.tolerated = self.active.shift * self._hidden(self.design.state)
                self.fidelities.learn(records)
                if lacking := self.fidelities.lacking:
                    return lacking
                self._use(self.fidelities)
                given = self.design.batches[-1].kind == "given"
                self._given = self.fidelities.by_both if given else self._given
                self.design.besides = self.fidelities.by_both - self._given
                records = self.fidelities.records
            try:
                before = len(self.design.steps)
                batch = self._next(records)
                if len(self.design.steps) > before:
                    self.told(self._report())
            except TooFewRuns:
                batch = self.design.more_of_the_first()
                if batch is None:
                    raise
        if self.exact is not None and batch is not None:
            return PlainBatch(self.inputs(batch.points))
        return [] if batch is None else self._runs(batch)

    def _report(self) -> BatchReport:
        """Return the report on the last batch; it tells once that a cheaper model is dropped."""
        report = report_batch(self.design, self.space)
        if self.fidelities is None or self.fidelities.dropped is None or self._told_dropped:
            return report
        self._told_dropped = True
        return replace(report, dropped=self.fidelities.dropped)

    def _use(self, fidelities: Fidelities) -> None:
        """Drop a cheaper model of which too few runs succeeded."""
        if fidelities.correction is None and fidelities.dropped is None:
            fidelities.drop("there are too few inputs at which both models succeed")

    def _runs(self, batch: Batch) -> list[dict[str, float]]:
        """Return the runs of a batch: of the model, or of a cheaper one, and of both where they are compared."""
        both, inputs = self.fidelities, self.inputs(batch.points)
        if both is not None and batch.kind not in ("check", "trial"):
            both.no_check()
        if both is None or both.dropped is not None:
            return inputs
        pairs = 0
        if batch.kind == "posterior":
            pairs = int(both.pays(self.design.steps[-1].error))
        elif batch.kind == "trial" or (batch.kind == "check" and self.design.batches[-2].kind != "check"):
            pairs = len(both.try_at(batch.points))
        return [by_cheaper(entry) for entry in inputs] + inputs[:pairs]

    def _next(self, records: Sequence[RunRecord]) -> Batch | None:
        """Return the next batch; the design stays unchanged if the runs do not define a field yet.

        Draws of the true posterior are many, and nothing is learnt from them: the last ones are enough.
        """
        if self.exact is not None:
            records = records[-len(self.design.batches[-1].points) :]
        points = self.points(records)
        while True:
            try:
                return self.design.next(points, self.judge.usable(records))
            except NoCommonPoints as error:
                self.judge.without_exceptions(records, error)

    @property
    def _looked(self) -> Points:
        """Inputs of the runs that count: those of a cheaper model do not once it is dropped."""
        return self.asked if self.fidelities is None else self.fidelities.points

    @property
    def asked(self) -> Points:
        return np.concatenate([batch.points for batch in self.design.batches])

    @property
    def exact(self) -> ExactDraws | None:
        """Draws of the true posterior, if there are any."""
        return self.design.exact if isinstance(self.design, InformedDesign) else None

    @property
    def certificate(self) -> Certificate:
        """Grounds for trusting the posterior."""
        design = self.design
        checks = [step for step in design.steps if step.check is not None]
        return Certificate(
            converged=design.converged,
            reasons=design.reasons,
            steps=tuple(design.steps),
            batches=tuple(design.batches),
            checked=checks[-1] if checks else None,
            found=least_found(self._looked, self.space) if self.space.dim <= MOST_SEEN else None,
            overlooks=design.converged and design.overlooks(self._looked),
            fidelities=None if self.fidelities is None else self.fidelities.report(self._hidden(design.state)),
            scattered=design.scattered,
            drawn="" if self.exact is None else self.exact.words,
        )
