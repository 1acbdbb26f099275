"""The whole of study.yaml, version 1. These objects never leave `studies`.

First the keys `design`, `surrogate`, `sampler`, `executor` and `failures`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from strandline.design import FEWEST_POINTS, Active, Refinement
from strandline.parameters import GaussianField
from strandline.runs import DaskCluster, InProcess, LocalProcesses, SlurmArray
from strandline.smc import SMCSettings
from strandline.studies.keys import schema
from strandline.studies.keys.observation import Observed, StudyNoise

Particles = Annotated[schema.Whole, Field(ge=10, le=schema.MOST, description="at least 10")]


class Sobol(schema.Section):
    """Consecutive points of one Sobol sequence."""

    runs: schema.Count
    """forward runs, at least two more than inputs"""
    scramble: schema.Seed | None = None
    """seed of an Owen scrambling; default: none"""


REFINE = schema.Options(Refinement, also={"rounds": (schema.Count, 3), "runs": (schema.Count, ...)})
Scramble = Annotated[schema.Seed | None, Field(description="seed of their Owen scrambling; default: none")]
ACTIVE = schema.Options(Active, also={"scramble": (Scramble, None)})


class Design(schema.Section):
    """The design of experiments."""

    sobol: Sobol | None = None
    refine: Annotated[Mapping[str, Any], REFINE] | None = None
    active: Annotated[Mapping[str, Any], ACTIVE] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "Design":
        if (self.sobol is None) == (self.active is None):
            raise ValueError("either `sobol: {runs: …}` or `active: {runs: …}`")
        if self.refine is not None and self.active is not None:
            raise ValueError("`refine` with `sobol` only; an active design refines itself")
        return self


class LogLikelihood(schema.Section):
    """A Gaussian process of the log-likelihood."""

    kernel: str | None = None
    """[kernel](#kernels) of the Gaussian process, or [`module:name`](../how-to/extend.md#a-kernel); default:
    `matern32`"""
    fit: str | None = None
    """function that learns another surrogate, [`module:name`](../how-to/extend.md#a-surrogate); default: the Gaussian
    process"""

    @model_validator(mode="after")
    def _one_way(self) -> "LogLikelihood":
        if self.kernel is not None and self.fit is not None:
            raise ValueError("one of `kernel`, `fit`")
        return self


class InterfaceField(schema.Section):
    """A surrogate of the interface as a field."""


class Surrogate(schema.Section):
    """The surrogate: one of the two; by default the one that fits the design."""

    log_likelihood: LogLikelihood | None = None
    field: InterfaceField | None = None
    """[a surrogate of the interface](../explanation/surrogates.md), which has no options"""

    @model_validator(mode="after")
    def _one_surrogate(self) -> "Surrogate":
        if self.log_likelihood is not None and self.field is not None:
            raise ValueError("one of `log_likelihood`, `field`")
        return self


SMC = schema.Options(SMCSettings, without=("resample_below", "maximum_steps"), also={"particles": (Particles, 5000)})


class CutReading(schema.Section):
    """The cut reading of the posterior under uncertainty."""

    values: Annotated[schema.Whole, Field(ge=2, le=schema.MOST_VALUES)] = 32
    """nuisance values in the [cut reading](../how-to/experiment.md#an-uncertain-quantity), representing their prior, at
    least 2"""


class Sampler(schema.Section):
    """The sampler."""

    smc: Annotated[Mapping[str, Any], SMC] = Field(default_factory=dict, validate_default=True)
    cut: CutReading = CutReading()


def _quoted(value: Any) -> Any:
    """Refuse a number: YAML 1.1 reads 4:00:00 without quotes as one, in base 60."""
    if value is not None and not isinstance(value, str):
        raise ValueError('a time in quotes, "04:00:00"')
    return value


Walltime = Annotated[schema.Text, BeforeValidator(_quoted)]


class DaskJobs(schema.Section):
    """The jobs that are the workers of a Dask cluster."""

    cores: schema.Count = 1
    """simultaneous runs per job"""
    memory: schema.Text
    """per job, `16GB`"""
    walltime: Walltime
    """per job, `"HH:MM:SS"` or `"D-HH:MM:SS"`, in quotes"""
    queue: schema.Text | None = None
    """queue or partition"""
    account: schema.Text | None = None
    """account to charge"""
    interface: schema.Text | None = None
    """network interface between nodes and driver"""
    extra: list[schema.Text] = []
    """further job directives, `["--qos=long"]`"""
    prologue: list[schema.Text] = []
    """shell lines before the worker starts, `["module load gcc"]`"""


DASK = schema.Options(DaskCluster, also={"jobs": (DaskJobs | None, None)})
SLURM_ARRAY = schema.Options(
    SlurmArray, without=("folder", "command", "detach"), also={"walltime": (Walltime | None, None)}
)


class ExecutorChoice(schema.Section):
    """Where forward runs are made: one place; or an executor ``module:name`` with its options."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, dict[str, Any] | None]
    in_process: Annotated[Mapping[str, Any], schema.Options(InProcess)] | None = None
    """one run after the other, in the process of strandline; it has no options"""
    local: Annotated[Mapping[str, Any], schema.Options(LocalProcesses)] | None = None
    dask: Annotated[Mapping[str, Any], DASK] | None = None
    slurm_array: Annotated[Mapping[str, Any], SLURM_ARRAY] | None = None

    @model_validator(mode="after")
    def _one_place(self) -> "ExecutorChoice":
        if len(self.model_fields_set) > 1:
            raise ValueError(f"one of {', '.join(type(self).model_fields)}, or module:name")
        return self


def _action(value: Any) -> Any:
    if value in ("continue", "abort"):
        return value
    times = value.get("retry") if isinstance(value, dict) and len(value) == 1 else None
    if isinstance(times, int) and not isinstance(times, bool) and 1 <= times <= schema.MOST_RETRIES:
        return times
    raise ValueError(f"continue, abort, or {{retry: N}} with N from 1 to {schema.MOST_RETRIES}")


class Stop(schema.Section):
    """When a campaign is stopped because nearly all of its runs fail."""

    share: Annotated[schema.Number, Field(gt=0, le=1)] = 0.95
    """share of failed runs that stops the study, above 0, at most 1; never: `failures: {stop: never}`"""
    after: schema.Count = 20
    """… once this many are done"""


class Failures(schema.Section):
    """What is done about forward runs that fail, by kind or state."""

    kinds: dict[str, Annotated[str | int, BeforeValidator(_action)]] = {}
    """by kind or state of a [failed run](../how-to/when-runs-fail.md): `continue`, `abort` or `{retry: N}`"""
    stop: Stop | Literal["never"] = Stop()


class SpecimensFile(schema.Section):
    """Outlines of many specimens."""

    files: Annotated[str, Field(min_length=1)]
    """files of the outlines, or pictures of them, relative to the study folder: `specimens/*.csv`; or this alone,
    `specimens: specimens/*.csv`"""
    given: str | None = None
    """a table of [known inputs](../how-to/specimens.md#known-inputs): a column `file` and one for each of them"""
    read: dict[str, Any] | None = None
    """how to read the files, with the keys of `observation`: `{unit: mm}`, or `{image: {…}}` for pictures; default: as
    `observation`"""

    @model_validator(mode="before")
    @classmethod
    def _files_alone(cls, given: Any) -> Any:
        return {"files": given} if isinstance(given, str) else given


CHANGES = ("prior", "noise", "measure", "fix", "without")


Share = Annotated[schema.Number, Field(ge=0, le=1)]
Points = Annotated[schema.Whole, Field(ge=FEWEST_POINTS, le=schema.MOST)]


def _ordered(part: tuple[float, float]) -> tuple[float, float]:
    if not part[0] < part[1]:
        raise ValueError("two numbers, the lower one first, e.g. [0, 0.5]")
    return part


class Next(schema.Section):
    """Candidates for the next experiment: values of quantities, each a key, and what of the interface is observed."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[list[schema.Number], Field(min_length=1)]]
    condition: Annotated[list[str | list[str]], Field(min_length=1)] | None = None
    """of the [candidates for the next experiment](../how-to/next.md), which also list values of known
    quantities by name: conditions to observe, `[slow, fast]`, or `[[slow, fast]]` for both"""
    part: Annotated[list[Annotated[tuple[Share, Share], AfterValidator(_ordered)]], Field(min_length=1)] | None = None
    """where on the interface to look, as shares of the observed length: `[[0, 0.5], [0.5, 1]]`"""
    points: Annotated[list[Points | None], Field(min_length=1)] | None = None
    """how many points to observe, at equal distances: `[20, 100]`"""
    sd: Annotated[list[Annotated[schema.Number, Field(gt=0)] | None], Field(min_length=1)] | None = None
    """standard deviation of each point, in `next.unit`"""
    unit: Literal["mm", "um", "µm", "m"] | None = None
    """of `next.sd`"""
    together: Annotated[schema.Whole, Field(ge=1, le=3)] = 1
    """how many experiments may be made together, up to 3"""

    @model_validator(mode="after")
    def _in_a_unit(self) -> "Next":
        if self.sd is not None and self.unit is None:
            raise ValueError("the unit of `sd` too: `unit: um` (or mm, m)")
        return self


class WhatIf(schema.Section):
    """Another assumption: one change of the study, or several together."""

    name: schema.Unit | None = None
    """of an [alternative](../how-to/what-if.md): what it is called in the table; default: what it changes"""
    prior: dict[schema.Name, Annotated[dict[str, list[schema.Number]], Field(min_length=1, max_length=1)]] = {}
    """other [priors](#priors) by input, in the same box"""
    noise: dict[str, Any] | None = None
    """another `noise`, with the keys of that section"""
    measure: Annotated[str, Field(min_length=1)] | schema.Choice | None = None
    """another [measure](#measures) with its options, or the name of one"""
    fix: dict[schema.Name, schema.Number] = {}
    """values of inputs that are taken as known"""
    without: list[str] = []
    """conditions that are left out"""

    @model_validator(mode="after")
    def _any_change(self) -> "WhatIf":
        if not any(getattr(self, name) for name in CHANGES):
            raise ValueError(f"at least one of {', '.join(CHANGES)}")
        return self


SCHEMA_VERSION = 1


class Quantity(schema.Section):
    """A known input with its unit."""

    value: schema.Number
    """or as `{value: …, unit: …}`: the number"""
    unit: schema.Unit
    """its unit, which is checked"""


def _symbol(value: str) -> str:
    if not value.strip() or len(value) > 30 or not value.isprintable():
        raise ValueError("a symbol of 1 to 30 characters on one line, e.g. ν")
    return value.strip()


Prior = Annotated[dict[str, list[schema.Number]], Field(min_length=1, max_length=1)]


class FieldPoints(schema.Section):
    """Where a simulator without points of its own takes a field."""

    file: schema.Text | None = None
    """where the simulator takes it; by default `at: solid`, the points of the built-in cell; else a table of points,
    relative to the study folder, separated by commas: a first line `x,y` or `x,y,z`, and a column `weight` if they
    stand for different areas"""
    unit: Literal["mm", "um", "µm", "m"] | None = None
    """unit of length in the `file`: `mm`, `um`, `µm` or `m`"""
    interval: Annotated[tuple[schema.Number, schema.Number], AfterValidator(_ordered)] | None = None
    """instead of `file`: `{interval: [0, 1], points: 200}`, mm, the middles of equal parts"""
    points: Annotated[schema.Whole, Field(ge=2, le=2000)] | None = None
    """how many parts"""

    @model_validator(mode="after")
    def _one_kind(self) -> "FieldPoints":
        if self.model_fields_set not in ({"file", "unit"}, {"interval", "points"}):
            raise ValueError("{file: points.csv, unit: mm} or {interval: [0, 1], points: 200}")
        return self


FIELD = schema.Options(
    GaussianField,
    also={
        "sd": (schema.Number | Prior, ...),
        "length": (schema.Number | Prior, ...),
        "at": (
            Annotated[
                Literal["solid"] | FieldPoints,
                Field(description="where the simulator takes it: `solid` (the built-in cell), or points"),
            ],
            "solid",
        ),
    },
)


class Input(schema.Section):
    """An unknown input."""

    prior: Prior | None = None
    """a [distribution](#priors) with its numbers; required without `field`"""
    field: Annotated[Mapping[str, Any], FIELD] | None = None
    """instead of `prior`: the input varies from point to point, as a Gaussian field"""
    unit: schema.Unit | None = None
    """the model's unit, a label: nothing is converted; omit for a pure number"""
    box: tuple[schema.Number, schema.Number] | None = None
    """[low, high] of forward runs; default: prior's support"""
    nuisance: schema.Switch = False
    """[uncertain, but not calibrated](../how-to/experiment.md#an-uncertain-quantity): the result is averaged over it"""
    label: Annotated[str, AfterValidator(_symbol)] | None = None
    """symbol in figures, report and tables, e.g. `V̇_in`: one line of up to 30 characters; an underscore starts a
    subscript; default: the name"""

    @model_validator(mode="after")
    def _one_kind(self) -> "Input":
        if (self.prior is None) == (self.field is None):
            raise ValueError("either `prior: {uniform: [low, high]}` or `field: {mean: …, sd: …, length: …}`")
        if self.field is not None and not self.model_fields_set <= {"field", "unit"}:
            raise ValueError("`field` with `unit` only")
        return self


class Correlation(schema.Section):
    """A correlation between two inputs."""

    between: tuple[schema.Name, schema.Name]
    """a list, `correlation: [{between: [E, nu], value: -0.5}]`: two inputs that are correlated a priori, no
    coefficients of a field; their own priors stay"""
    value: Annotated[schema.Number, Field(gt=-1, lt=1)]
    """correlation of the normal quantiles of their priors (a Gaussian copula), between -1 and 1"""


class StudyFile(schema.Section):
    """The whole of study.yaml."""

    version: Literal[1]
    """1"""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
    """letters, digits, `_`, `.`, `-`; starts with a letter or digit"""
    model: schema.Choice
    """a [simulator](#models) with its options"""
    fidelities: Annotated[list[str | dict[str, Any]], Field(min_length=1, max_length=1)] = []
    """[a cheaper model](../how-to/cheaper-model.md), for most runs of an active design: the options in which it differs
    from `model`, with `cost`, or the name of its mesh"""
    fixed: dict[schema.Name, schema.Number | Quantity] = {}
    """a known input: a number in the model's unit"""
    inputs: Annotated[dict[schema.Name, Input], Field(min_length=1)]
    correlation: list[Correlation] = []
    observation: Observed
    discrepancy: schema.Choice | Annotated[list[schema.Choice], Field(min_length=1)]
    """a [measure](#measures) with its options, or a list of them"""
    noise: StudyNoise
    design: Design
    surrogate: Surrogate = Surrogate()
    sampler: Sampler = Sampler()
    executor: ExecutorChoice = ExecutorChoice()  # type: ignore[call-arg]
    failures: Failures = Failures()
    sensitivities: schema.Switch = False
    """runs also return d(interface)/d(input), kept in the ledger"""
    reuse: list[str] = []
    """other studies' folders, relative to this one, to reuse fitting runs"""
    draft: schema.Switch = False
    """a first look: few draws judge the fit, an active design carries few particles, figures are coarse, and there are
    no sensitivity indices; the report says so"""
    report: Literal["full", "none"] = "full"
    """`none`: no figures and no page"""
    seed: schema.Seed = 1
    """for every random number after the design"""
    next: Next | None = None
    specimens: SpecimensFile | None = None
    """outlines of [many specimens](../how-to/specimens.md), analysed with the runs of this study"""
    what_if: list[WhatIf] = []

    @field_validator("fidelities", mode="before")
    @classmethod
    def _one_in_a_list(cls, given: Any) -> Any:
        if isinstance(given, list):
            return given
        raise ValueError("a list with one cheaper model, `[coarse]` or `[{mesh: coarse, cost: 0.3}]`")

    @field_validator("design")
    @classmethod
    def _chooses_the_model(cls, design: Design, before: Any) -> Design:
        if before.data.get("fidelities") and design.active is None:
            raise ValueError("`active: {runs: …}` beside `fidelities`: it decides which of the two models to run")
        return design

    @field_validator("surrogate")
    @classmethod
    def _fits_the_design(cls, surrogate: Surrogate, before: Any) -> Surrogate:
        design = before.data.get("design", Design.model_construct())
        if design.active is not None and surrogate.log_likelihood is not None:
            raise ValueError("`field: {}` for an active design, or `design: {sobol: {runs: …}}`")
        if design.refine is not None and surrogate.field is not None:
            raise ValueError("`log_likelihood: {}` for rounds of refinement, or `design: {active: {runs: …}}`")
        return surrogate
