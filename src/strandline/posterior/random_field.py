"""What a posterior knows of a random field: its values, where the data inform it, and numbers that follow from it."""

import html
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc

from strandline.foundations import html_table, require, unit_text, with_sd
from strandline.parameters import ParameterSpace, RandomField
from strandline.posterior.weighted import Weighted, generator, systematic_indices

PRIOR_DRAWS = 4096
"""Points of a scrambled Sobol' sequence for the prior: of 14 inputs, eight scramblings gave sds within 0.2 %."""
INTERVAL = 0.9  # probability of the intervals of functionals
UNKNOWN = 0.9  # share of the prior's sd above which a point counts as not known from the data
AXES = "xyz"

Part = Bool[np.ndarray, " point"] | Callable[[Float[np.ndarray, "point xyz"]], Bool[np.ndarray, " point"]]
"""A part of the region of a field: a mask of its points, or a function that makes one of their coordinates, mm."""


@dataclass(frozen=True)
class Functional:
    """A number that follows from a field: its moments and 90 % interval under the posterior and under the prior."""

    unit: str
    mean: float
    sd: float
    low: float
    high: float
    prior_mean: float
    prior_sd: float
    prior_low: float
    prior_high: float


@dataclass(frozen=True, eq=False, repr=False)
class FieldPosterior:
    """A field under weighted draws of its inputs: coefficients, and its sd and length if they are unknown.

    Draws of the prior are `prior_inputs`, by default independent ones. With an unknown length, the values are those of
    `RandomField.values_of_many`. Arrays over points are in the order of `field.support`. Means over the region weigh
    each point by the length or area that it stands for.
    """

    field: RandomField
    inputs: Float[np.ndarray, "draw input"]
    weights: Float[np.ndarray, " draw"]
    prior_inputs: Float[np.ndarray, "prior input"] | None = None

    def __repr__(self) -> str:
        return f"<FieldPosterior {self.line}>"

    def _repr_html_(self) -> str:
        rows = [
            (html.escape(name), html.escape(unit_text(one.unit)), *(f"{value:.4g}" for value in values))
            for name, one in self.functionals.items()
            for values in [(one.mean, one.sd, one.low, one.high, one.prior_mean, one.prior_sd)]
        ]
        head = (self.field.name, "unit", "mean", "sd", "5 %", "95 %", "prior mean", "prior sd")
        return html_table(head, rows) + f"<p>{html.escape(self.statement)}</p>"

    @property
    def line(self) -> str:
        """``E: field of 100 modes, mean 412 ± 18 Pa``."""
        mean, unit = self.functionals["mean"], unit_text(self.field.unit)
        modes = f"{self.field.name}: field of {self.field.count} modes"
        return f"{modes}, mean {with_sd(mean.mean, mean.sd)} {unit}".rstrip()

    @cached_property
    def values(self) -> Weighted:
        """The field of each draw (draw, point), in its unit."""
        return Weighted(self.field.values_of_many(self.inputs), self.weights)

    @cached_property
    def gaussian(self) -> Weighted:
        """The Gaussian field of each draw (draw, point): the logarithm of the values if that is Gaussian."""
        values = self.values.draws
        return Weighted(np.log(values) if self.field.prior.log else values, self.weights)

    @cached_property
    def prior(self) -> "FieldPosterior":
        """The same field under draws of its prior."""
        draws = self.prior_inputs
        if draws is None:
            draws = prior_draws(ParameterSpace(self.field.parameters))
        return FieldPosterior(self.field, draws, np.full(len(draws), 1 / len(draws)))

    @property
    def mean(self) -> Float[np.ndarray, " point"]:
        """Posterior mean at each point, in the unit of the field."""
        return self.values.mean

    @property
    def sd(self) -> Float[np.ndarray, " point"]:
        """Posterior standard deviation at each point, in the unit of the field."""
        return self.values.sd

    @cached_property
    def share_left(self) -> Float[np.ndarray, " point"]:
        """Share of the prior's standard deviation that is left at each point, of the Gaussian field.

        The prior is that of the modes: nothing is learnt about what they leave out. With an unknown sd or length, its
        standard deviation is that of draws of the prior.
        """
        known = np.sqrt((self.field.modes**2).sum(axis=1)) if not self.field.unknown else self.prior.gaussian.sd
        return np.asarray(self.gaussian.sd / known)

    def interval(self, level: float = INTERVAL) -> Float[np.ndarray, "2 point"]:
        """Return the ends of the central interval of this probability at each point, in the unit of the field."""
        require(0 < level < 1, "probability of an interval", level, "between 0 and 1", "Correct it.")
        return _interval(self.values.draws, self.weights, level)

    def draws(self, number: int, seed: Any = 0) -> Float[np.ndarray, "draw point"]:
        """Return draws of the field with equal weights, by systematic resampling, in its unit."""
        return self.field.values(self.inputs[systematic_indices(self.weights, number, generator(seed))])

    def functional(
        self, of: Callable[[Float[np.ndarray, "draw point"]], Float[np.ndarray, " draw"]], unit: str | None = None
    ) -> Functional:
        """Return what is known of any number that follows from a field: a function of values (draw, point)."""
        found = []
        for one in (self, self.prior):
            each = Weighted(of(one.values.draws)[:, None], one.weights)
            ends = _interval(each.draws, one.weights, INTERVAL)
            found += [float(each.mean[0]), float(each.sd[0]), *ends[:, 0].tolist()]
        return Functional(self.field.unit if unit is None else unit, *found)

    def mean_over(self, part: Part | None = None) -> Functional:
        """Return the mean of the field over a part of its region, by default over all of it.

        Raises:
            InvalidInput: A part without points.
        """
        points = self.field.support.points
        mask = part(points) if callable(part) else part
        inside = np.ones(len(points), bool) if mask is None else np.asarray(mask)
        words = "a mask of the points, some of them True", "Choose a larger part."
        right = inside.shape == (len(points),) and bool(inside.any())
        require(right, f"part of the field {self.field.name}", f"{inside.sum()} of {len(points)} points", *words)
        weights = self.field.support.weights * inside
        return self.functional(lambda values: values @ (weights / weights.sum()))

    def share_above(self, value: float) -> Functional:
        """Return the share of the region in which the field is above a value, in its unit."""
        weights = self.field.support.weights / self.field.support.weights.sum()
        return self.functional(lambda values: (values > value) @ weights, "1")

    @cached_property
    def functionals(self) -> dict[str, Functional]:
        """By name: the mean over the region and over each third of it along x, and the share above the prior's mean."""
        x = self.field.support.points[:, 0]
        ends, out = np.linspace(x.min(), x.max(), 4), {"mean": self.mean_over()}
        for low, high in pairwise(ends):
            inside = (x >= low) & (x <= high)
            if 0 < inside.sum() < len(x):
                out[f"mean, x from {low:.3g} to {high:.3g} mm"] = self.mean_over(inside)
        value, unit = self.field.prior.mean, unit_text(self.field.unit)
        return out | {f"share above {value:g} {unit}".rstrip(): self.share_above(value)}

    @property
    def unknown(self) -> int:
        """Number of points at which more than 90 % of the prior's standard deviation is left."""
        return int((self.share_left > UNKNOWN).sum())

    @property
    def statement(self) -> str:
        """What the data know of the field, and where, in plain words."""
        share, of = np.minimum(self.share_left, 1.0), "the logarithm of " if self.field.prior.log else ""
        least, largest = int(share.argmin()), int(share.argmax())
        return (
            f"The outline leaves {share[least]:.0%} of the prior's standard deviation of {of}{self.field.name} at "
            f"{self._place(least)}, where it knows most, and {share[largest]:.0%} at {self._place(largest)}, where it "
            f"knows least. At {self.unknown} of {len(share)} points it leaves more than {UNKNOWN:.0%}."
        )

    def _place(self, point: int) -> str:
        place = self.field.support.points[point]
        return ", ".join(f"{axis} = {value:.3g}" for axis, value in zip(AXES, place, strict=False)) + " mm"


def prior_draws(space: ParameterSpace) -> Float[np.ndarray, "draw dim"]:
    """Return the draws of a prior with which fields are compared."""
    return space.prior_quantiles(qmc.Sobol(space.dim, seed=np.random.default_rng(0)).random(PRIOR_DRAWS))


def _interval(
    values: Float[np.ndarray, "draw point"], weights: Float[np.ndarray, " draw"], level: float
) -> Float[np.ndarray, "2 point"]:
    ends = ((1 - level) / 2, (1 + level) / 2)
    return np.asarray(np.quantile(values, ends, axis=0, weights=weights, method="inverted_cdf"))
