"""What the analyses of all specimens share: the surrogate of the interface, and the first draws of the prior."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.surrogate.field import FieldPrediction

__all__ = ["Start"]

DRAWS, MANY_INPUTS_DRAWS = 1024, 4096
"""Draws of the prior for up to three unknown inputs and for more."""
FEW_INPUTS = 3
SCRAMBLE = 0
"""Seed that scrambles their Sobol sequence."""


@dataclass(frozen=True, eq=False)
class Start:
    """The surrogate of the interface with draws of the prior, whose predicted interfaces are kept, for the inputs of a
    study of which some are `given`: known for a specimen.
    """

    knowledge: Knowledge
    space: ParameterSpace
    given: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def columns(self) -> Int[np.ndarray, " unknown"]:
        return np.array([i for i, name in enumerate(self.space.names) if name not in self.given])

    @cached_property
    def unknown(self) -> ParameterSpace:
        return ParameterSpace(tuple(self.space.parameters[i] for i in self.columns))

    @cached_property
    def points(self) -> Float[np.ndarray, "draw unknown"]:
        number = DRAWS if self.unknown.dim <= FEW_INPUTS else MANY_INPUTS_DRAWS
        return self.unknown.prior_quantiles(sobol(number, self.unknown.dim, scramble=SCRAMBLE))

    @cached_property
    def predicted(self) -> FieldPrediction:
        return self.predict(self.points)

    @cached_property
    def log_densities(self) -> Float[np.ndarray, " draw"]:
        """Log prior density of these draws, as far as runs succeed there."""
        return self.log_density(self.points)

    def whole(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point dim"]:
        """Return the values of all inputs, for values of the unknown ones."""
        out = np.tile([self.given.get(name, 0.0) for name in self.space.names], (len(x), 1))
        out[:, self.columns] = x
        return out

    def predict(self, x: Float[np.ndarray, "point unknown"]) -> FieldPrediction:
        return self.knowledge.surrogate.predict(self.whole(x))

    def mean(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point mode"]:
        return self.knowledge.surrogate.mean(self.whole(x))

    def log_density(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, " point"]:
        """Return the log prior density of unknown inputs plus the log probability that a run succeeds there."""
        return np.asarray(self.unknown.log_prior(x) + self.knowledge.log_feasibility(self.whole(x)))

    def with_given(self, given: Mapping[str, float]) -> "Start":
        """Return the start of a specimen with other known inputs.

        Raises:
            InvalidInput: A value lies outside its box, or no unknown input is left.
        """
        if dict(given) == dict(self.given):
            return self
        for name, value in given.items():
            low, high = self.space[name].interval
            if not low <= value <= high:
                raise InvalidInput(
                    f"known value of {name}",
                    value=value,
                    expected=f"a number from {low:g} to {high:g}, where the runs were made",
                    remedy="Correct it, or widen the prior of this input in study.yaml and run the study again.",
                )
        if len(given) == self.space.dim:
            what, expected = "known inputs of a specimen", "at least one input left to infer"
            raise InvalidInput(what, value=", ".join(given), expected=expected, remedy="Remove a column of the table.")
        return replace(self, given=dict(given))
