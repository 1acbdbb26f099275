"""The shape of study.yaml, version 1. These objects never leave `studies`."""

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    model_validator,
)

from strandline.errors import InvalidStudy
from strandline.interface import is_condition
from strandline.studies.scalars import (
    MOST,
    MOST_VALUES,
    VARIANCES,
    Count,
    Name,
    Number,
    Seconds,
    Seed,
    Text,
    Unit,
    Whole,
)
from strandline.studies.study_file_failures import Failures

__all__ = ["SCHEMA_VERSION", "SEVERAL", "StudyFile"]

SCHEMA_VERSION = 1
ONE, SEVERAL = "[one]", "[several]"
"""Branches of `observation`, as pydantic names them in the place of a mistake."""


Options = dict[str, Any]
Choice = Annotated[dict[str, Options | None], Field(min_length=1, max_length=1)]
"""One named variant with its options: ``{currents: {width: 0.005}}``."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Quantity(_Strict):
    """A known input with its unit."""

    value: Number
    unit: Unit


def _symbol(value: str) -> str:
    """Refuse a label that no line of a figure can hold."""
    if not value.strip() or len(value) > 30 or not value.isprintable():
        raise ValueError("a symbol of 1 to 30 characters on one line, e.g. ν")
    return value.strip()


class Input(_Strict):
    """An unknown input."""

    prior: Annotated[dict[str, list[Number]], Field(min_length=1, max_length=1)]
    unit: Unit | None = None
    box: tuple[Number, Number] | None = None
    nuisance: Annotated[bool, Field(strict=True)] = False
    label: Annotated[str, AfterValidator(_symbol)] | None = None


class ObservationNoise(_Strict):
    """Noise on the node coordinates of a synthetic observation."""

    sd: Annotated[Number, Field(gt=0)]
    seed: Seed | None = None


class ObservationFile(_Strict):
    """Where the observed interface comes from: a file, or a run of the model itself.

    What stands between `unit` and `synthetic` is how the file is read; `strandline.readers` checks it.
    """

    file: str | None = None
    unit: Literal["mm", "um", "µm", "m"] | None = None
    columns: Any = None
    delimiter: Any = None
    decimal: Any = None
    sort: Any = None
    field: Any = None
    time: Any = None
    block: Any = None
    cells: Any = None
    points: Any = None
    select: Any = None
    near: Any = None
    keep: Any = None
    start: Any = None
    plane: Any = None
    count: Any = None
    synthetic: dict[str, Number] | None = None
    noise: ObservationNoise | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ObservationFile":
        if (self.file is None) == (self.synthetic is None):
            raise ValueError("either `file` with its `unit`, or `synthetic`")
        if self.file is None and self.reading:
            raise ValueError(f"`{next(iter(self.reading))}` beside a `file` only, which it says how to read")
        if self.file is not None and self.unit is None:
            raise ValueError("the unit of the coordinates too: `unit: mm` (or um, m)")
        if self.file is not None and self.noise is not None:
            raise ValueError(
                "`noise` with `synthetic` only: a file holds its own; σ_N stands under the study's `noise`"
            )
        return self

    @property
    def reading(self) -> Options:
        """How the file is to be read."""
        others = {"file", "unit", "synthetic", "noise", "condition"}
        return {name: value for name, value in self if name not in others and value is not None}


def _condition(name: str) -> str:
    """Refuse a name that no condition can have."""
    if not name or not is_condition(name):
        raise ValueError("a short name without slashes")
    return name


class ConditionFile(ObservationFile):
    """The observed interface of one of several conditions."""

    condition: Annotated[str, AfterValidator(_condition)]

    @model_validator(mode="after")
    def _no_synthetic(self) -> "ConditionFile":
        if self.synthetic is not None:
            raise ValueError("a `file` for each condition; `observation: {synthetic: …}` observes all of them")
        return self


def _conditions(value: list[ConditionFile]) -> list[ConditionFile]:
    """Refuse a condition that is observed twice."""
    names = [item.condition for item in value]
    if len(set(names)) < len(names):
        raise ValueError("each condition once")
    return value


def _branch(value: Any) -> str:
    return SEVERAL if isinstance(value, list) else ONE


Observed = Annotated[
    Annotated[ObservationFile, Tag(ONE)]
    | Annotated[list[ConditionFile], Field(min_length=1), AfterValidator(_conditions), Tag(SEVERAL)],
    Discriminator(_branch),
]


class ConditionNoise(_Strict):
    """σ_N² or σ_N of one condition."""

    variance: Annotated[Number, Field(gt=0)] | None = None
    sd: Annotated[Number, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> "ConditionNoise":
        if (self.variance is None) == (self.sd is None):
            raise ValueError("either `variance` or `sd`")
        low, high = VARIANCES
        if not low <= self.squared <= high:
            raise ValueError(f"a σ_N² from {low:g} to {high:g}, the square of σ_N: the likelihood overflows beyond")
        return self

    @property
    def squared(self) -> float:
        """σ_N²; infinite where the square of σ_N is no number."""
        if self.variance is not None:
            return self.variance
        return float(self.sd) ** 2 if self.sd is not None and self.sd < 1e150 else float("inf")


def _others_apart(value: Any) -> Any:
    """Return a mapping whose keys ``module:name`` stand under `other`."""
    if not isinstance(value, dict):
        return value
    others = {name: options for name, options in value.items() if isinstance(name, str) and ":" in name}
    return {name: options for name, options in value.items() if name not in others} | (
        {"other": others} if others else {}
    )


class Noise(ConditionNoise):
    """σ_N² or σ_N of the likelihood, of every condition that has none of its own."""

    conditions: dict[str, ConditionNoise] = {}


class Sobol(_Strict):
    """Consecutive points of one Sobol sequence."""

    runs: Count
    scramble: Seed | None = None


class Refine(_Strict):
    """Further runs where the posterior lies."""

    rounds: Count = 3
    runs: Count
    temperature: Annotated[Number, Field(gt=0, le=1)] = 0.4


class ActiveFile(_Strict):
    """Batches chosen as the posterior takes shape; `strandline.design.active` checks the numbers."""

    runs: Count
    initial: Count | None = None
    scramble: Seed | None = None
    batch: Count | None = None
    explore: Number | None = None
    criterion: str | None = None
    check: Count | None = None
    change: Number | None = None
    shift: Number | None = None
    k_hat: Number | None = None
    effective: Number | None = None
    patience: Number | None = None


class Design(_Strict):
    """The design of experiments."""

    sobol: Sobol | None = None
    refine: Refine | None = None
    active: ActiveFile | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "Design":
        if (self.sobol is None) == (self.active is None):
            raise ValueError("either `sobol: {runs: …}` or `active: {runs: …}`")
        if self.refine is not None and self.active is not None:
            raise ValueError("`refine` with `sobol` only; an active design refines itself")
        return self


class LogLikelihood(_Strict):
    """A Gaussian process of the log-likelihood."""

    kernel: str | None = None


class InterfaceField(_Strict):
    """A surrogate of the interface as a field."""


class Surrogate(_Strict):
    """The surrogate: one of the two; by default what the design wants."""

    log_likelihood: LogLikelihood | None = None
    field: InterfaceField | None = None

    @model_validator(mode="after")
    def _one_surrogate(self) -> "Surrogate":
        if self.log_likelihood is not None and self.field is not None:
            raise ValueError("one of `log_likelihood`, `field`")
        return self


class SMC(_Strict):
    """Adaptive tempered Sequential Monte Carlo."""

    particles: Annotated[Whole, Field(ge=10, le=MOST)] = 5000
    rejuvenation_steps: Count = 15
    zeta: Annotated[Number, Field(gt=0, lt=1)] = 0.5


class CutReading(_Strict):
    """The cut reading of the posterior under uncertainty."""

    values: Annotated[Whole, Field(ge=2, le=MOST_VALUES)] = 32


class Sampler(_Strict):
    """The sampler."""

    smc: SMC = SMC()
    cut: CutReading = CutReading()


def _quoted(value: Any) -> Any:
    """Refuse a number: YAML 1.1 reads 4:00:00 without quotes as one, in base 60."""
    if value is not None and not isinstance(value, str):
        raise ValueError('a time in quotes, "04:00:00"')
    return value


Walltime = Annotated[Text, BeforeValidator(_quoted)]


class InProcess(_Strict):
    """One run after the other in the driver itself."""


class Local(_Strict):
    """Worker processes on this machine."""

    workers: Count | None = None
    timeout: Seconds | None = None


class DaskJobs(_Strict):
    """The jobs that are the workers of a Dask cluster."""

    cores: Count = 1
    memory: Text
    walltime: Walltime
    queue: Text | None = None
    account: Text | None = None
    interface: Text | None = None
    extra: list[Text] = []
    prologue: list[Text] = []


class Dask(_Strict):
    """A Dask cluster."""

    cluster: Literal["local", "slurm", "pbs"] | None = None
    address: Text | None = None
    workers: Count | None = None
    minimum: Annotated[Whole, Field(ge=0, le=MOST)] | None = None
    maximum: Count | None = None
    timeout: Seconds | None = None
    jobs: DaskJobs | None = None


class SlurmArray(_Strict):
    """Jobs of SLURM arrays, one for each run."""

    timeout: Seconds | None = None
    walltime: Walltime | None = None
    partition: Text | None = None
    account: Text | None = None
    cpus: Count | None = None
    memory: Text | None = None
    max_running: Count | None = None
    max_jobs: Count | None = None
    extra: list[Text] = []
    poll: Seconds = 5.0


class ExecutorChoice(_Strict):
    """Where forward runs are made: one place."""

    in_process: InProcess | None = None
    local: Local | None = None
    dask: Dask | None = None
    slurm_array: SlurmArray | None = None
    other: Annotated[Choice | None, Field(exclude=True)] = None
    """An executor that the study names by ``module:name``; no key of its own."""

    @model_validator(mode="before")
    @classmethod
    def _by_module(cls, value: Any) -> Any:
        return _others_apart(value)

    @model_validator(mode="after")
    def _one_place(self) -> "ExecutorChoice":
        if len(self.model_fields_set) > 1:
            known = [name for name, field in type(self).model_fields.items() if not field.exclude]
            raise ValueError(f"one of {', '.join(known)}")
        return self


class StudyFile(_Strict):
    """The whole of study.yaml."""

    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
    model: Choice
    fixed: dict[Name, Number | Quantity] = {}
    inputs: Annotated[dict[Name, Input], Field(min_length=1)]
    observation: Observed
    discrepancy: Choice | Annotated[list[Choice], Field(min_length=1)]
    noise: Noise
    design: Design
    surrogate: Surrogate = Surrogate()
    sampler: Sampler = Sampler()
    executor: ExecutorChoice = ExecutorChoice()
    failures: Failures = Failures()
    sensitivities: Annotated[bool, Field(strict=True)] = False
    reuse: list[str] = []
    seed: Seed = 1

    @model_validator(mode="after")
    def _fitting_surrogate(self) -> "StudyFile":
        if self.design.active is not None and self.surrogate.log_likelihood is not None:
            raise _unfit(
                "an active design with a surrogate of the log-likelihood",
                "`surrogate: {field: {}}` for an active design, or `design: {sobol: {runs: …}}`",
            )
        if self.design.refine is not None and self.surrogate.field is not None:
            raise _unfit(
                "rounds of refinement with a surrogate of the field",
                "`design: {active: …}` to refine a surrogate of the field",
            )
        return self


def _unfit(value: str, expected: str) -> InvalidStudy:
    what = "study.yaml: design and surrogate do not fit together"
    return InvalidStudy(what, value=value, expected=expected, remedy="Change one of the two keys.")
