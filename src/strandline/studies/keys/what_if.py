"""The key `what_if` of study.yaml: other assumptions, whose posteriors are compared with that of the study."""

from typing import Annotated, Any

from pydantic import Field, model_validator

from strandline.studies.keys.scalars import Name, Number, Unit
from strandline.studies.keys.section import Choice, Section

__all__ = ["WhatIf"]

CHANGES = ("prior", "noise", "measure", "fix", "without")


class WhatIf(Section):
    """Another assumption: one change of the study, or several together."""

    name: Unit | None = None
    """of an [alternative](../how-to/what-if.md): what it is called in the table; default: what it changes"""
    prior: dict[Name, Annotated[dict[str, list[Number]], Field(min_length=1, max_length=1)]] = {}
    """other [priors](#priors) by input, in the same box"""
    noise: dict[str, Any] | None = None
    """another `noise`, with the keys of that section"""
    measure: Annotated[str, Field(min_length=1)] | Choice | None = None
    """another [measure](#measures) with its options, or the name of one"""
    fix: dict[Name, Number] = {}
    """values of inputs that are taken as known"""
    without: list[str] = []
    """conditions that are left out"""

    @model_validator(mode="after")
    def _any_change(self) -> "WhatIf":
        if not any(getattr(self, name) for name in CHANGES):
            raise ValueError(f"at least one of {', '.join(CHANGES)}")
        return self
