"""What a comparison of the observations with the best prediction finds, and the answer in words."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from strandline.interface import Observation
from strandline.likelihood import ResidualNoise, StatedErrors

FAMILIES = 4  # kinds of p-values, for whose number the least is corrected: all residuals, parts of an arc, waves, d²
LEVEL = 0.01  # a model whose residuals are less likely than this is flagged
DOUBTFUL, RATIO = 0.05, 4.0
"""So is one whose residuals are less likely than this and have more than this many times the s²ℓ that was stated."""
SMALL = 0.995  # a p-value above this means residuals that are small for the stated noise
SMOOTH = 0.08
"""Correlation length, as a share of the observed interface, from which what was taken for noise is an error of the
model: errors of a picture reach over a few pixels."""
STRAINED = 4.5  # shift, rotation, scale or offset, in stated sds, from which it is not what was stated
STRAINS = {"shift": "shifted", "rotation": "turned", "scale": "scaled", "offset": "moved along its normals"}
UNLIKELY = 0.05  # probability of such a shift, rotation, scale or offset below which it is worth a warning
TOWARDS = {
    "above": " (towards larger y)",
    "below": " (towards smaller y)",
    "to the right of": " (towards larger x)",
    "to the left of": " (towards smaller x)",
}
"""A side in the model's axes: in a picture whose y points down, what lies above is lower in the picture."""
LEAST = 0.001  # smallest p-value that is given as a number


@dataclass(frozen=True)
class Region:
    """A part of an observed arc from `begin` to `end`, mm, or a patch of a surface with a mean point `centre`, mm.

    Its residuals have this mean and root mean square, mm, positive on the side of the normals. `side` is where the
    observed interface lies if the mean has one sign: ``above``, ``to the left of`` and the like; on a surface
    ``outside``, the side of the normals, or ``inside``. `excess` is the mean over the standard deviation of such a mean
    of the noise; if the root mean square is more than twice the mean, its ratio to that of the noise instead. `p_value`
    is the probability of such residuals of a right model in any part, corrected for the number of parts.
    """

    begin: float
    end: float
    mean: float
    rms: float
    side: str
    excess: float
    p_value: float
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class ConditionMisfit:
    """The residuals of one observed interface: its signed distance from the best prediction, mm, without global errors.

    `arc_length` is that of each observed point, mm; its number on a `surface`. `stated` are the errors of the points
    that the observation states; `expected` are standard deviation and correlation length of residuals with these
    errors, `found` those of the residuals, mm, on a surface over distances in space. `p_value` is the probability that
    a right model leaves residuals as large, `predictive_p` the posterior-predictive p-value of d²; `regions` are parts
    of the arc, or patches. `removed` are the most probable global errors of the observation, which the residuals do not
    contain: shift and offset, mm, rotation, degrees, and scale, a share; none if none are stated.
    """

    condition: str
    arc_length: Float[np.ndarray, " point"]
    residual: Float[np.ndarray, " point"]
    stated: StatedErrors
    expected: ResidualNoise
    found: ResidualNoise
    p_value: float
    predictive_p: float | None
    regions: tuple[Region, ...] = ()
    removed: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    surface: bool = False

    @property
    def strained(self) -> tuple[str, float, float]:
        """The global error that is largest for what is stated: its name, size and stated standard deviation.

        In mm, degrees, or as a share. ("", 0, 1) if none is stated.
        """
        stated = {name: float(getattr(self.stated.errors, name)) for name in self.removed}
        found = [(name, math.hypot(*sizes), stated[name]) for name, sizes in self.removed.items() if stated[name] > 0]
        return max(found, key=lambda one: one[1] / one[2], default=("", 0.0, 1.0))

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def ratio(self) -> float:
        """Ratio of s²ℓ of the residuals to that of the stated errors; of s²ℓ² on a surface."""
        longer = self.found.length / self.expected.length
        return self.found.level / self.expected.level * (longer if self.surface else 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Misfit:
    """Whether the model explains the observations within the noise, in a sentence; `flagged` if not, None if unknown.

    `p_value` is the probability that a right model leaves residuals as large as those of the best fit; under a right
    model all its values are equally likely. `predictive_p` is the posterior-predictive p-value of d², conservative,
    `smooth_p` the probability that a right model leaves slow waves along the arc as large. They are None if they could
    not be computed, the last one also on surfaces. `notes` say how it was computed, in sentences.
    """

    verdict: str
    flagged: bool | None
    p_value: float | None = None
    predictive_p: float | None = None
    smooth_p: float | None = None
    conditions: tuple[ConditionMisfit, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Misfit {self.verdict}>"

    @property
    def region_p(self) -> float | None:
        """Smallest p-value of a part of an arc; None if there are no parts."""
        return min((region.p_value for one in self.conditions for region in one.regions), default=None)


@dataclass(frozen=True)
class FitVerdict:
    """An answer in one sentence, and whether it means that the model does not explain the observations, if known."""

    text: str
    flagged: bool | None


def verdict_on(
    p_value: float, predictive_p: float, smooth_p: float, conditions: Sequence[ConditionMisfit], *, run_alone: bool
) -> FitVerdict:
    """Return the verdict from the p-values of the best fit's residuals, of d², and of slow waves along the arc.

    With `run_alone`, a single run stands for all inputs; then large residuals prove nothing.
    """
    regions = [region.p_value for one in conditions for region in one.regions]
    ratio = max((one.ratio for one in conditions), default=0.0)
    least = min(1.0, FAMILIES * min(p_value, predictive_p, smooth_p, *regions))
    what = "observation" if len(conditions) == 1 else "observations"
    strain = _strain(conditions)
    if least >= LEVEL and not (ratio > RATIO and p_value < DOUBTFUL) and (run_alone or not strain):
        remark = ", and the residuals are smaller than the noise leads one to expect" if p_value > SMALL else ""
        if least < DOUBTFUL:
            remark = f", but look at the residuals: {FAMILIES} times the smallest p-value is {least:.2g}"
        return FitVerdict(f"The model explains the {what}: {_said(p_value)}{remark}.", flagged=False)
    because = strain or _reason(conditions, ratio, least, smooth=FAMILIES * smooth_p < LEVEL)
    if run_alone:
        return FitVerdict(
            f"The best run does not explain the {what}{because}, but no surrogate could be built to check the inputs "
            "between the runs.",
            flagged=None,
        )
    text = f"The model does not explain the {what}{because}; trust neither mean nor width of the posterior."
    return FitVerdict(text, flagged=True)


def with_fitted_noise(verdict: FitVerdict, observations: Sequence[Observation]) -> FitVerdict:
    """Return the verdict if the noise was inferred from the same residuals, which it then explains in any case."""
    errors = [(one.known, one.interface) for one in observations if one.known]
    noise, seen = max(errors, key=lambda one: one[0].length, default=(None, None))
    if verdict.flagged is not False or noise is None or seen is None:
        return verdict
    said = f"sd {_length(noise.sd)}, correlated over {_length(noise.length)}"
    whole = float(seen.lengths.sum()) if seen.dim == 2 else 0.0
    if whole and noise.length > SMOOTH * whole:
        return FitVerdict(
            f"The model does not explain the observation: its residuals (root mean square {_length(noise.sd)}) are "
            f"smooth over {_length(noise.length)}, as errors of a model are, and not noise; trust neither mean nor "
            "width of the posterior.",
            flagged=True,
        )
    return FitVerdict(
        f"{verdict.text[:-1]}, with noise fitted to its residuals: {said}. An error of the model of this size and "
        "length would be taken for noise: compare them with what you know of the picture.",
        flagged=False,
    )


def unlikely_errors(misfit: Misfit) -> Iterator[str]:
    """Yield a sentence for each shift, rotation, scale or offset of an observation that its stated sd makes unlikely.

    Its most probable size has a smaller probability than `UNLIKELY` of being reached.
    """
    for one in misfit.conditions:
        of = f" of condition {one.condition}" if one.condition else ""
        for name, sizes in one.removed.items():
            stated, size = float(getattr(one.stated.errors, name)), math.hypot(*sizes)
            if stated > 0 and chi2.sf((size / stated) ** 2, len(sizes)) < UNLIKELY:
                by, sd = _of_kind(name, size), _of_kind(name, stated)
                yield (
                    f"The observed interface{of} fits best if it is {STRAINS[name]} by {by}, {_short(size / stated)} "
                    f"times the stated {name} of {sd}: measure the {name} again, or state a larger one."
                )


def _strain(conditions: Sequence[ConditionMisfit]) -> str:
    """Return which global error is far larger than stated, in words; nothing if none is."""
    found = [(one.strained, one.condition) for one in conditions]
    (name, size, sd), condition = max(found, key=lambda one: one[0][1] / one[0][2], default=(("", 0.0, 1.0), ""))
    if size < STRAINED * sd:
        return ""
    of = f" of condition {condition}" if condition else ""
    by, stated = (_of_kind(name, one) for one in (size, sd))
    return (
        f": the observed interface{of} would have to be {STRAINS[name]} by {by}, {_short(size / sd)} times the stated "
        f"{stated}"
    )


def _of_kind(name: str, value: float) -> str:
    if name in ("shift", "offset"):
        return _length(value)
    return f"{_short(value)}°" if name == "rotation" else f"{_short(100 * value)} %"


def _said(p: float) -> str:
    return f"p < {LEAST:g}" if p < LEAST else f"p = {p:.2g}"


def _reason(conditions: Sequence[ConditionMisfit], ratio: float, least: float, *, smooth: bool) -> str:
    """Return the p-value and where the residuals are largest if that is why; else that they are smooth, or s²ℓ."""
    found = [(region.p_value, -region.excess, one.condition, region) for one in conditions for region in one.regions]
    p_value, _, condition, region = min(found, key=lambda one: one[:2], default=(1.0, 0.0, "", None))
    said = f" ({_said(least)})" if least < LEVEL else ""
    if said and region is not None and p_value < DOUBTFUL:
        mine = next(one for one in conditions if one.condition == condition).regions
        everywhere = len(mine) > 1 and all(one.p_value < DOUBTFUL for one in mine)
        if least < FAMILIES * p_value:
            said = f" ({_said(least)} over the whole interface)"
        return f"{said}: {_where(condition, region, everywhere=everywhere)}"
    if smooth:
        return f"{said}: the residuals vary slowly along the observed interface, as noise would not"
    level = "s²ℓ²" if any(one.surface for one in conditions) else "s²ℓ"
    larger = f": {level} of the residuals is {_short(ratio)} times that of the stated noise"
    return said + larger if ratio > RATIO else said


def _where(condition: str, region: Region, *, everywhere: bool) -> str:
    of, times = f" of condition {condition}" if condition else "", _short(region.excess)
    lies = f"lies {_length(abs(region.mean))} {region.side} the prediction{TOWARDS.get(region.side, '')}"
    if not region.side:
        lies = f"departs from the prediction by {_length(abs(region.mean))} on average"
    size = f"{lies}, {times} times the standard deviation of that mean"
    if abs(region.mean) < 0.5 * region.rms:
        size = f"departs from the prediction by {_length(region.rms)}, root mean square, {times} times the noise"
    most = "everywhere, most " if everywhere else ""
    if region.centre is not None:
        return f"{most}near ({', '.join(_place(one) for one in region.centre)}) mm{of} the observed surface {size}"
    where = f"{most}near s = {_place(region.begin)}–{_place(region.end)} mm{of}"
    return f"{where} the observed interface {size}"


def _place(mm: float) -> str:
    return f"{mm:.3g}" if mm < 100 else f"{mm:.0f}"


def _length(mm: float) -> str:
    return f"{_short(mm)} mm" if mm >= 1 else f"{_short(1e3 * mm)} µm"


def _short(number: float) -> str:
    """Return two significant digits, more of a large number, without a power of ten."""
    return f"{number:.0f}" if number >= 10 else f"{number:.2g}"


@dataclass(frozen=True)
class Effort:
    """Numbers of draws and runs; they limit how small a p-value can be.

    The defaults let one part of an arc alone flag a model, after the correction for its two tests and those of the
    other parts: fewest drawn observations in all and for each part, draws of the posterior for the posterior-predictive
    comparison, and most runs that a prediction is learnt from if there is no surrogate of the field.
    """

    draws: int = 4000
    per_part: int = 4 * round(FAMILIES / LEVEL)
    predictive: int = 2 * round(FAMILIES / LEVEL)
    runs: int = 64


DRAFT = Effort(draws=400, per_part=0, predictive=32, runs=16)
"""For a first look: p-values below .0025 cannot be told apart, and one part of an arc alone flags no model."""
