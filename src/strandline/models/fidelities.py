"""A model with a cheaper one beside it, e.g. on a coarser mesh: one simulator of two fidelities.

A run by the cheaper model has the further input `CHEAPER`; a run without it is one by the model itself. So both kinds
are kept in one ledger, and a study that has made runs without a cheaper model keeps them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from strandline.foundations import unfit
from strandline.interface import Interface
from strandline.models import protocol
from strandline.models.identity import fingerprint

CHEAPER = "cheaper_model"
"""Input that marks a run by the cheaper model; its value is 1."""
FIRST_PAIRS = 3
"""Inputs of a first design at which both models are run."""


@dataclass(frozen=True)
class WithCheaper:
    """A model and a cheaper one for the same inputs; in all else it is the model.

    `cost` is that of a run of the cheaper one, as a share of a run of the model; above 0 and below 1.

    Raises:
        InvalidInput: The two are the same, or differ in inputs or conditions; a cost out of range.
    """

    model: protocol.ForwardModel
    cheaper: protocol.ForwardModel
    cost: float

    def __post_init__(self) -> None:
        if not 0 < self.cost < 1:
            expected = "a share of the cost of a run of the model, above 0 and below 1"
            remedy = "Divide the seconds of a run of the cheaper model by those of a run of the model."
            raise unfit("cost of a run of the cheaper model", self.cost, expected, remedy)
        if fingerprint(self.model) == fingerprint(self.cheaper):
            expected = "a model whose runs are cheaper, such as one with a coarser mesh"
            remedy = "Change an option, or remove the cheaper model."
            raise unfit("the cheaper model", "the model itself", expected, remedy)
        names = [sorted(one.name for one in protocol.declared_inputs(model)) for model in (self.model, self.cheaper)]
        conditions = [sorted(protocol.declared_conditions(model)) for model in (self.model, self.cheaper)]
        for what, (own, other) in (("inputs", names), ("conditions", conditions)):
            if own != other:
                expected = f"those of the model: {', '.join(own) or 'none'}"
                remedy = "Let both models take the same inputs and return the same conditions."
                raise unfit(f"{what} of the cheaper model", ", ".join(other) or "none", expected, remedy)

    def __call__(self, inputs: Mapping[str, Any], workdir: Path) -> protocol.Simulation | Interface:
        if is_cheaper(inputs):
            return self.cheaper({name: value for name, value in inputs.items() if name != CHEAPER}, workdir)
        return self.model(inputs, workdir)

    @property
    def fingerprint(self) -> str:
        return fingerprint(self.model)

    @cached_property
    def fingerprint_of_cheaper(self) -> str:
        return fingerprint(self.cheaper)

    @property
    def preparation(self) -> str:
        pair = (self.model, self.cheaper)
        return next((one.preparation for one in pair if isinstance(one, protocol.PreparesRuns) and one.preparation), "")

    def is_prepared(self, inputs: Mapping[str, float]) -> bool:
        """Return whether a run of the model makes use of what it has prepared."""
        return isinstance(self.model, protocol.PreparesRuns) and self.model.is_prepared(inputs)

    def prepare_runs(self) -> None:
        protocol.prepare_runs(self.model)
        protocol.prepare_runs(self.cheaper)

    def __getattr__(self, name: str) -> Any:
        """Return what the model itself offers or declares."""
        if name.startswith("__") or "model" not in self.__dict__:
            raise AttributeError(name)
        return getattr(self.model, name)


def is_cheaper(inputs: Mapping[str, Any]) -> bool:
    """Return whether a run is one by the cheaper model."""
    return CHEAPER in inputs


def by_cheaper(inputs: Mapping[str, float]) -> dict[str, float]:
    """Return the inputs of the run by the cheaper model."""
    return {**inputs, CHEAPER: 1.0}


def run_identity(model: protocol.ForwardModel, own: str, inputs: Mapping[str, float]) -> str:
    """Return the fingerprint of the model that makes a run; `own` is that of the model, or of the pair."""
    return model.fingerprint_of_cheaper if isinstance(model, WithCheaper) and is_cheaper(inputs) else own


def first_runs(model: protocol.ForwardModel, inputs: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Return the runs of a first design at these inputs: all by the cheaper model if there is one, some by both."""
    if not isinstance(model, WithCheaper):
        return [dict(entry) for entry in inputs]
    return [by_cheaper(entry) for entry in inputs] + [dict(entry) for entry in inputs[:FIRST_PAIRS]]
