"""The problem, the settings and the result of a calibration; its progress, also below the cell of a notebook."""

import html
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Literal

import numpy as np
from jaxtyping import Float

from strandline import posterior as posteriors
from strandline.calibration.misfit import Misfit
from strandline.calibration.sampler_check import SamplerCheck
from strandline.design import SETTLING, Active, BatchReport, Certificate, FieldOutcome, Refinement, Round, SetAside
from strandline.discrepancy import Discrepancy
from strandline.foundations import html_table, is_finite, named, require, require_types
from strandline.interface import Observation
from strandline.models import ForwardModel
from strandline.parameters import ParameterSpace
from strandline.runs import FailurePolicy, Progress, RunRecord
from strandline.smc import SMCResult, SMCSettings, StepInfo
from strandline.surrogate import MANY_INPUTS, LogLikelihoodSurrogate, fit_named, kernel_named


@dataclass(frozen=True)
class Problem:
    """The problem to solve: the simulator, its unknown inputs with their priors, its known inputs by name, the observed
    interface of each observed condition with its noise, and measures by name.

    The first measure defines the posterior; the others get a surrogate for comparison.
    """

    model: ForwardModel
    space: ParameterSpace
    fixed: Mapping[str, float]
    observations: tuple[Observation, ...]
    discrepancies: Mapping[str, Discrepancy]

    def __post_init__(self) -> None:
        seen, measures = self.observations, self.discrepancies
        all_seen = isinstance(seen, tuple | list) and all(isinstance(one, Observation) for one in seen)
        measured = isinstance(measures, Mapping) and measures and all(map(callable, measures.values()))
        known = isinstance(self.fixed, Mapping) and all(map(is_finite, self.fixed.values()))
        for what, value, right, expected in (
            ("model", self.model, callable(self.model), "a function (inputs, workdir) or a model"),
            ("inputs", self.space, isinstance(self.space, ParameterSpace), "a ParameterSpace of Parameters"),
            ("known inputs", self.fixed, known, "numbers by name, e.g. {} or {'load': 1.0}"),
            ("observations", seen, all_seen, "a tuple of Observations, one per condition"),
            ("measures", measures, measured, "discrepancies by name, the main one first"),
        ):
            found = f"{type(value).__name__}: {value!r}"
            require(right, f"{what} of the problem", found, expected, f"Give {expected}.")
        both = [name for name in self.fixed if name in self.space.names]
        remedy = "Leave it out of one of them."
        require(not both, "inputs of the problem that are known too", ", ".join(both), "one of the two", remedy)
        object.__setattr__(self, "observations", tuple(seen))

    @property
    def measure(self) -> Discrepancy:
        """The measure that defines the posterior."""
        return next(iter(self.discrepancies.values()))


@dataclass(frozen=True)
class Settings:
    """How the problem is solved; the defaults are the study's.

    Args:
        runs: Number of runs of the Sobol design, or of the first ones of an active design.
        scramble: Seed of the design's scrambling, None for the plain sequence.
        refine: Further runs where the posterior lies; none by default.
        kernel: Name of the Gaussian process's kernel.
        fit: Function that learns the log-likelihood in place of the Gaussian process, ``module:name``; None if unused.
        particles: Number of particles of the sampler.
        smc: Other settings of the sampler.
        seed: Seed of every random number after the design.
        nuisance_values: Number of values of the nuisance inputs, if there are any, that represent their prior in the
            cut reading of the posterior under uncertainty.
        failures: Policy for forward runs that fail.
        surrogate: Quantity that the surrogate predicts: the log-likelihood, as in the study, or the interface
            as a ``field``.
        active: Further runs chosen as the posterior takes shape; only with a surrogate of the field.
        draft: A first look, in a fraction of the time: whether the model explains the observation is judged from few
            draws, an active design carries few particles, there are no sensitivity indices and no surrogates of the
            log-likelihood beside a field, and figures are coarse.

    Raises:
        InvalidInput: No such kernel or function; no number of runs; an active design without a surrogate of the field.
    """

    runs: int = 1000
    scramble: int | None = None
    refine: Refinement = field(default_factory=Refinement)
    kernel: str = "matern32"
    fit: str | None = None
    particles: int = 5000
    smc: SMCSettings = field(default_factory=SMCSettings)
    seed: int = 1
    nuisance_values: int = 32
    failures: FailurePolicy = field(default_factory=FailurePolicy)
    surrogate: Literal["log_likelihood", "field"] = "log_likelihood"
    active: Active | None = None
    draft: bool = False

    def __post_init__(self) -> None:
        require_types(self)
        least = {"runs": 0, "particles": 2, "seed": 0, "scramble": 0, "nuisance_values": 2}
        for name, low in least.items():
            value = getattr(self, name)
            require(value is None or value >= low, name, value, f"a whole number, {low} or above", "Change it.")
        kernel_named(self.kernel)
        if self.fit is not None:
            fit_named(self.fit)
        field_or_no_design = self.active is None or self.surrogate == "field"
        remedy = 'Add surrogate="field", or leave out active.'
        require(field_or_no_design, "surrogate of an active design", self.surrogate, "field", remedy)
        if self.active is not None:
            first = self.active.initial in (None, self.runs)
            remedy = "State one of the two, or the same number in both."
            require(first, "runs of the settings, the first ones", self.runs, f"initial={self.active.initial}", remedy)
            with named(f"active design after the first {self.runs} runs"):
                object.__setattr__(self, "active", replace(self.active, initial=self.runs))

    @property
    def planned_runs(self) -> int:
        """Runs of the Sobol design and of all rounds of refinement; for an active design, the most that it may make."""
        return self.runs + self.refine.total if self.active is None else self.active.runs


@dataclass(frozen=True)
class Calibration:
    """Problem, settings and all results; the runs of each round of refinement follow the earlier ones.

    With nuisance inputs, `posterior` is that of all inputs, `under_uncertainty` that of the calibrated ones, and
    `cut_quadrature` has one result for each value of the nuisance inputs; else these two are None. With a surrogate of
    the field, `field` describes it; `surrogates`, of the log-likelihood, are then for comparison, or empty. `no_field`
    is the reason why there is no field although it was requested. `set_aside` are runs that ended ok but were not used;
    unless only one measure cannot use them, they are invalid in `records`. `turned` are the conditions whose
    observation ran against the runs; in `problem` it is turned round. `misfit` tells whether the model explains the
    observations within the noise; None if this was not judged. `sampler_check` compares two independent halves of the
    particles; None up to three inputs. `made` are all runs as they were made, if `records` hold corrected ones of a
    cheaper model; else it is empty.
    """

    problem: Problem
    settings: Settings
    records: tuple[RunRecord, ...]
    training: Float[np.ndarray, "run dim"]
    log_likelihoods: Mapping[str, Float[np.ndarray, " run"]]
    surrogates: Mapping[str, LogLikelihoodSurrogate]
    sampling: SMCResult
    posterior: posteriors.Posterior
    gaussian: posteriors.GaussianApproximation
    laplace: posteriors.LaplaceApproximation
    quadrature: posteriors.QuadratureResult | None
    seconds: Mapping[str, float]
    under_uncertainty: posteriors.UnderUncertainty | None = None
    cut_quadrature: tuple[posteriors.QuadratureResult, ...] | None = None
    rounds: tuple[Round, ...] = ()
    sensitivity: posteriors.SobolIndices | None = None
    field: FieldOutcome | None = None
    no_field: str | None = None
    set_aside: tuple[SetAside, ...] = ()
    turned: tuple[str, ...] = ()
    misfit: Misfit | None = None
    sampler_check: SamplerCheck | None = None
    made: tuple[RunRecord, ...] = ()

    @property
    def all_runs(self) -> tuple[RunRecord, ...]:
        """All runs as they were made; with a cheaper model, `records` holds its corrected ones instead."""
        return self.made or self.records

    def __repr__(self) -> str:
        ok = sum(record.ok for record in self.all_runs)
        doubt = "not converged; " if self.certificate and not self.certificate.converged else ""
        return f"<Calibration {self.posterior.line}; {doubt}{ok} of {len(self.all_runs)} runs ok>"

    def _repr_html_(self) -> str:
        ok = sum(record.ok for record in self.all_runs)
        measure = next(iter(self.problem.discrepancies))
        facts = [("runs", f"{ok} of {len(self.all_runs)} ok"), ("measure", html.escape(measure))]
        facts += [("log evidence", f"{self.posterior.log_evidence:.4g}"), ("ESS", f"{self.posterior.ess:.0f}")]
        facts += [("surrogate", "log-likelihood" if self.field is None else "interface as a field")]
        return self.posterior._repr_html_() + html_table(("calibration", ""), facts)

    @property
    def certificate(self) -> Certificate | None:
        """The grounds for trusting the posterior of an active design; None for another design."""
        return None if self.field is None else self.field.certificate

    @property
    def surrogate(self) -> LogLikelihoodSurrogate:
        """The surrogate of the log-likelihood under the first measure."""
        return next(iter(self.surrogates.values()))


@dataclass(frozen=True)
class Observer:
    """Functions to call as the work goes on; by default they do nothing.

    `draws` receives the inputs of each round of refinement before they are run, `batch` the posterior after each batch
    of an active design, `part` how many parts of a stage without runs are done, `note` what a person should know.
    """

    stage: Callable[[str], None] = lambda name: None
    draws: Callable[[Sequence[Mapping[str, float]]], None] = lambda inputs: None
    run: Callable[[RunRecord, Progress], None] = lambda record, progress: None
    step: Callable[[StepInfo], None] = lambda info: None
    note: Callable[[str], None] = lambda text: None
    part: Callable[[Progress], None] = lambda progress: None
    batch: Callable[[BatchReport], None] = lambda report: None


class Stopwatch:
    """Seconds by stage, summed if a stage is repeated; a stage inside another one does not count there."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.within: list[str] = []

    @contextmanager
    def __call__(self, stage: str, observer: Observer) -> Iterator[None]:
        observer.stage(stage)
        self.within.append(stage)
        begun = time.perf_counter()
        try:
            yield
        finally:
            taken = time.perf_counter() - begun
            self.within.pop()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + taken
            if self.within:
                outer = self.within[-1]
                self.seconds[outer] = self.seconds.get(outer, 0.0) - taken
                observer.stage(outer)


STAGES = {
    "forward": "forward runs",
    "draws": "runs at draws",
    "refinement": "draws for a round",
    "choice": "next batch",
    "cut": "cut reading",
    "check": "checks",
    "candidates": "runs of candidates",
    "gains": "information gains",
    "report": "figures and report",
}
"""Stages whose names in words differ from those in the program."""
MANY = 30
"""Inputs above which only a design with sensitivities can learn; second derivatives and Sobol indices take too long."""
KERNEL = "ZMQInteractiveShell"  # shell of a Jupyter kernel; others have a terminal


def require_learnable(dim: int, *, active: Active | None, sensitivities: bool, cheaper: bool) -> None:
    """Refuse more unknown inputs than can be learnt, unless an active design has sensitivities by them, `exact` draws
    where no chains are made, and `differences` that are of no use.
    """
    exact, differences = (False, False) if active is None else (active.exact, active.differences)
    expected = f"at most {MANY}, or an active design with sensitivities (`sensitivities: true`, or `differences: true`)"
    right = dim <= MANY or (active is not None and (sensitivities or differences))
    require(right, "unknown inputs", dim, expected, "Add both, or leave out inputs, such as modes of a field.")
    many, remedy = dim >= MANY_INPUTS and not cheaper, "Leave it out, or change these."
    value = f"true with {dim} inputs{', a cheaper model' if cheaper else ''}"
    value += f" and {'' if sensitivities else 'no '}sensitivities"
    expected = f"{MANY_INPUTS} unknown inputs or more, no cheaper model, and "
    slopes = "sensitivities (`sensitivities: true`, or `differences: true`)"
    require((many and (sensitivities or differences)) or not exact, "exact", value, expected + slopes, remedy)
    alone = many and not sensitivities
    require(alone or not differences, "differences", value, expected + "no sensitivities of the model", remedy)
    if active is not None and differences:
        least = 3 + dim + SETTLING
        words = f"at least {least}: {3 + dim} to begin with and {SETTLING} draws"
        require(active.runs >= least, "runs", active.runs, words, "Allow more runs.")


def run_note(state: Progress) -> str:
    """Return how many runs have ended well, how many not, and the time left, or that a server is waited for."""
    rest = ", waiting for the model's server" if state.waiting else _left(state)
    return f"{state.ok} ok, {state.failed} failed{rest}"


def part_note(state: Progress) -> str:
    """Return how many parts are done, and the time left."""
    return f"{state.finished} of {state.total}{_left(state)}"


def _left(state: Progress) -> str:
    remaining = state.remaining_seconds
    return "" if remaining is None or state.finished == state.total else f", {_duration(remaining)} left"


def step_note(info: StepInfo) -> str:
    """Return the tempering exponent, the effective sample size and the share of accepted moves."""
    return f"tempering exponent {info.temperature:.4f}, ESS {info.ess:.0f}, accepted {info.acceptance:.0%}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def observer_or_default(observer: Observer | None) -> Observer:
    """Return `observer`; if there is none, one that shows the progress in a notebook, and nothing elsewhere."""
    if observer is not None:
        return observer
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if type(shell).__name__ != KERNEL:
        return Observer()
    display = import_module("IPython.display")
    handle = display.display(display.HTML(""), display_id=True)
    return cell_observer(lambda text: handle.update(display.HTML(text)))


def cell_observer(show: Callable[[str], None]) -> Observer:
    """Return an observer that shows the stages so far as HTML, one a line, with how far each has got."""
    lines: list[list[str]] = []

    def refresh() -> None:
        rows = "<br>".join(f"{html.escape(stage)} {html.escape(note)}" for stage, note in lines)
        show(f'<div role="status" style="font-size: 90%">{rows}</div>')

    def stage(name: str) -> None:
        words = STAGES.get(name, name)
        if not lines or lines[-1][0] != words:
            lines.append([words, "…"])
        refresh()

    def noted(text: str) -> None:
        if lines:
            lines[-1][1] = text
            refresh()

    return Observer(
        stage=stage,
        run=lambda record, state: noted(f"{state.finished}/{state.total}: {run_note(state)}"),
        step=lambda info: noted(step_note(info)),
        part=lambda state: noted(part_note(state)),
        batch=lambda report: noted(report.line),
        note=noted,
    )
