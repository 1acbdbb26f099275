"""The keys `design`, `surrogate` and `sampler` of study.yaml."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, model_validator

from strandline.design.active import Active
from strandline.design.refinement import Refinement
from strandline.smc import SMCSettings
from strandline.studies.keys.options import Options
from strandline.studies.keys.scalars import MOST, MOST_VALUES, Count, Seed, Whole
from strandline.studies.keys.section import Section

__all__ = ["Design", "Sampler", "Surrogate"]

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

    @model_validator(mode="after")
    def _one_surrogate(self) -> "Surrogate":
        if self.log_likelihood is not None and self.field is not None:
            raise ValueError("one of `log_likelihood`, `field`")
        return self


SMC = Options(SMCSettings, without=("resample_below", "maximum_steps"), also={"particles": (Particles, 5000)})


class CutReading(Section):
    """The cut reading of the posterior under uncertainty."""

    values: Annotated[Whole, Field(ge=2, le=MOST_VALUES)] = 32
    """nuisance values in the [cut reading](../how-to/uncertain-experiment.md), representing their prior, at least 2"""


class Sampler(Section):
    """The sampler."""

    smc: Annotated[Mapping[str, Any], SMC] = Field(default_factory=dict, validate_default=True)
    cut: CutReading = CutReading()
