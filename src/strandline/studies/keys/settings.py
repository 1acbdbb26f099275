"""The keys `design`, `surrogate`, `sampler`, `executor` and `failures` of study.yaml."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from strandline.design import Active, Refinement
from strandline.runs import DaskCluster, InProcess, LocalProcesses, SlurmArray
from strandline.smc import SMCSettings
from strandline.studies.keys.scalars import (
    MOST,
    MOST_RETRIES,
    MOST_VALUES,
    Count,
    Number,
    Section,
    Seed,
    Text,
    Whole,
)
from strandline.studies.keys.schema import Options

Particles = Annotated[Whole, Field(ge=10, le=MOST, description="at least 10")]


class Sobol(Section):
    """Consecutive points of one Sobol sequence."""

    runs: Count
    """forward runs, at least two more than inputs"""
    scramble: Seed | None = None
    """seed of an Owen scrambling; default: none"""


REFINE = Options(Refinement, also={"rounds": (Count, 3), "runs": (Count, ...)})
Scramble = Annotated[Seed | None, Field(description="seed of their Owen scrambling; default: none")]
ACTIVE = Options(Active, also={"scramble": (Scramble, None)})


class Design(Section):
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


class LogLikelihood(Section):
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


class InterfaceField(Section):
    """A surrogate of the interface as a field."""


class Surrogate(Section):
    """The surrogate: one of the two; by default the one that fits the design."""

    log_likelihood: LogLikelihood | None = None
    field: InterfaceField | None = None
    """[a surrogate of the interface](../explanation/surrogates.md), which has no options"""

    @model_validator(mode="after")
    def _one_surrogate(self) -> "Surrogate":
        if self.log_likelihood is not None and self.field is not None:
            raise ValueError("one of `log_likelihood`, `field`")
        return self


SMC = Options(SMCSettings, without=("resample_below", "maximum_steps"), also={"particles": (Particles, 5000)})


class CutReading(Section):
    """The cut reading of the posterior under uncertainty."""

    values: Annotated[Whole, Field(ge=2, le=MOST_VALUES)] = 32
    """nuisance values in the [cut reading](../how-to/experiment.md#an-uncertain-quantity), representing their prior, at
    least 2"""


class Sampler(Section):
    """The sampler."""

    smc: Annotated[Mapping[str, Any], SMC] = Field(default_factory=dict, validate_default=True)
    cut: CutReading = CutReading()


def _quoted(value: Any) -> Any:
    """Refuse a number: YAML 1.1 reads 4:00:00 without quotes as one, in base 60."""
    if value is not None and not isinstance(value, str):
        raise ValueError('a time in quotes, "04:00:00"')
    return value


Walltime = Annotated[Text, BeforeValidator(_quoted)]


class DaskJobs(Section):
    """The jobs that are the workers of a Dask cluster."""

    cores: Count = 1
    """simultaneous runs per job"""
    memory: Text
    """per job, `16GB`"""
    walltime: Walltime
    """per job, `"HH:MM:SS"` or `"D-HH:MM:SS"`, in quotes"""
    queue: Text | None = None
    """queue or partition"""
    account: Text | None = None
    """account to charge"""
    interface: Text | None = None
    """network interface between nodes and driver"""
    extra: list[Text] = []
    """further job directives, `["--qos=long"]`"""
    prologue: list[Text] = []
    """shell lines before the worker starts, `["module load gcc"]`"""


DASK = Options(DaskCluster, also={"jobs": (DaskJobs | None, None)})
SLURM_ARRAY = Options(SlurmArray, without=("folder", "command", "detach"), also={"walltime": (Walltime | None, None)})


class ExecutorChoice(Section):
    """Where forward runs are made: one place; or an executor ``module:name`` with its options."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, dict[str, Any] | None]
    in_process: Annotated[Mapping[str, Any], Options(InProcess)] | None = None
    """one run after the other, in the process of strandline; it has no options"""
    local: Annotated[Mapping[str, Any], Options(LocalProcesses)] | None = None
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
    if isinstance(times, int) and not isinstance(times, bool) and 1 <= times <= MOST_RETRIES:
        return times
    raise ValueError(f"continue, abort, or {{retry: N}} with N from 1 to {MOST_RETRIES}")


class Stop(Section):
    """When a campaign is stopped because nearly all of its runs fail."""

    share: Annotated[Number, Field(gt=0, le=1)] = 0.95
    """share of failed runs that stops the study, above 0, at most 1; never: `failures: {stop: never}`"""
    after: Count = 20
    """… once this many are done"""


class Failures(Section):
    """What is done about forward runs that fail, by kind or state."""

    kinds: dict[str, Annotated[str | int, BeforeValidator(_action)]] = {}
    """by kind or state of a [failed run](../how-to/when-runs-fail.md): `continue`, `abort` or `{retry: N}`"""
    stop: Stop | Literal["never"] = Stop()
