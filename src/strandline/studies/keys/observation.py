"""The keys `observation` and `noise` of study.yaml."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from strandline.interface import is_condition
from strandline.studies.keys.scalars import VARIANCES, Number, Seed
from strandline.studies.keys.section import Section

__all__ = ["ONE", "SEVERAL", "ConditionFile", "Noise", "ObservationFile", "Observed"]

ONE, SEVERAL = "[one]", "[several]"
"""Branches of `observation`, as pydantic names them in the location of an error."""


class ObservationNoise(Section):
    """Noise on the node coordinates of a synthetic observation."""

    sd: Annotated[Number, Field(gt=0)]
    """standard deviation of noise added to each node coordinate of a `synthetic` observation, mm, above 0"""
    seed: Seed | None = None
    """its seed; default: the study's `seed`"""


class ObservationFile(Section):
    """Where the observed interface comes from: a file, or a run of the model itself.

    `strandline.readers` checks the keys between `unit` and `synthetic`.
    """

    file: str | None = None
    """observed [interface](#files), relative to the study folder"""
    unit: Literal["mm", "um", "µm", "m"] | None = None
    """unit of length: `mm`, `um`, `µm` or `m`; required with `file`"""
    columns: Any = None
    """this key to `observation.reader`: [how to read the file](#files)"""
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
    reader: Any = None
    synthetic: dict[str, Number] | None = None
    """instead of `file`: a value for each input; the model makes the observation"""
    noise: ObservationNoise | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ObservationFile":
        if (self.file is None) == (self.synthetic is None):
            raise ValueError("either `file` with its `unit`, or `synthetic`")
        if self.file is None and self.reading:
            raise ValueError(f"`{next(iter(self.reading))}` only with a `file`, since it says how to read it")
        if self.file is not None and self.unit is None:
            raise ValueError("the unit of the coordinates too: `unit: mm` (or um, m)")
        if self.file is not None and self.noise is not None:
            raise ValueError(
                "`noise` with `synthetic` only: a file holds its own; σ_N stands under the study's `noise`"
            )
        return self

    @property
    def reading(self) -> dict[str, Any]:
        """How to read the file."""
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
    """in a list only: the condition of this `file`"""

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


class ConditionNoise(Section):
    """σ_N² or σ_N of one condition."""

    variance: Annotated[Number, Field(gt=0)] | None = None
    """σ_N² of the condition NAME, instead of the study's"""
    sd: Annotated[Number, Field(gt=0)] | None = None
    """instead of `variance`: its σ_N"""

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
        """σ_N²; infinite if σ_N is missing or its square overflows."""
        if self.variance is not None:
            return self.variance
        return float(self.sd) ** 2 if self.sd is not None and self.sd < 1e150 else float("inf")


class Noise(ConditionNoise):
    """σ_N² or σ_N of the likelihood, for every condition without its own."""

    variance: Annotated[Number, Field(gt=0)] | None = None
    """σ_N², in the unit of d² (mm²)"""
    sd: Annotated[Number, Field(gt=0)] | None = None
    """instead of `variance`: σ_N"""
    conditions: dict[str, ConditionNoise] = {}
