"""The likelihood of inputs through a surrogate of the field: the measure is evaluated on the predicted interface."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, cast

import jax
import numpy as np
from jaxtyping import Float, Int
from scipy.stats import qmc

from strandline.discrepancy import (
    Currents,
    Discrepancy,
    JointErrors,
    MeasureKey,
    NormalOffset,
    Snapshot,
    count_of_distances,
    shared_errors,
    squared_discrepancies,
)
from strandline.foundations import require
from strandline.interface import Interface, Noise, Observation, PointErrors
from strandline.likelihood import local_likelihood as local
from strandline.likelihood.inferred_noise import InferredNoise, infer_noise
from strandline.likelihood.interfaces import compared
from strandline.likelihood.local_likelihood import Nearby, Values
from strandline.smc import BatchedLogDensity, OnHost, is_on_host
from strandline.surrogate import FieldPrediction, FieldSurrogate, GaussianProcess, Predictor, batched_mean

DRAWS, NEAR_DRAWS = 16, 32
"""Fields drawn at each point for the expected likelihood, and for the one nearby; in pairs of opposite sign."""
STARTS, SHARES = 256, (1.0, 0.3, 0.1)
"""Inputs tried in each round of the search for the best ones, and the shares of the box around them."""
TRIED, LIKELY, TOLERATED = 8, 10.0, 0.2
"""Points at which `nearby` is compared with the measure; how much less likely than the best one they may be, in log L;
largest difference of log E[L]."""
ROUNDS, SHIFTS = 6, 16  # rounds of the search for the shift that the noise hides, and shifts tried in each
LEAST_SHIFT = 1e-12  # least shift of an interface that is tried, as a share of its extent
_BLOCK = 8192  # interfaces predicted together


@dataclass(frozen=True, eq=False)
class FieldLikelihood:
    """log L of inputs, given a surrogate of the interface, an observed one for each condition, and the measure d²."""

    surrogate: FieldSurrogate
    observations: tuple[Observation, ...]
    discrepancy: Discrepancy

    def plug_in(self, x: Float[np.ndarray, "point dim"]) -> Values:
        """Return log L of the predicted interfaces as if they were exact."""
        return self.at(self.surrogate.mean(x))

    @cached_property
    def nearby(self) -> Nearby | None:
        """A log-likelihood that takes a fraction of the time near the best fit; None if there is none."""
        if self.inferred is not None:
            return local.OfMixture(self.inferred.field, self.inferred.likelihood)
        return local.nearby(self.surrogate, self.observations, self.discrepancy, self._shared)

    def at(self, coefficients: Float[np.ndarray, "point mode"]) -> Values:
        """Return log L of the interfaces with these coefficients of the modes, mm: `plug_in` of known predictions."""
        blocks = [coefficients[k : k + _BLOCK] for k in range(0, len(coefficients), _BLOCK)]
        return np.concatenate([self._of(block, None) for block in blocks])

    def expected(self, x: Float[np.ndarray, "point dim"], *, plug_in: Values | None = None) -> Values:
        """Return log E[L] over the fields that the surrogate considers possible at each point.

        Draws of the fields weigh off what a parabola of log L misses, see `local_likelihood`; their standard normal
        numbers are the same at every point. For draws of the posterior, or of a tempered one, give their `plug_in`:
        then `nearby` may tell it, if it agrees with the measure.
        """
        if plug_in is not None and self.nearby is not None:
            found = self.surrogate.predict(x)
            values = self._nearby_expected(self.nearby, found, plug_in)
            if self._agrees(found, values, values - plug_in):
                return values
        number = max(_BLOCK // DRAWS, 1)
        blocks = [x[k : k + number] for k in range(0, len(x), number)]
        return np.concatenate([self._drawn(self.surrogate.predict(block)) for block in blocks])

    def gain(self, x: Float[np.ndarray, "point dim"], plug_in: Values) -> Values:
        """Return log E[L] - log L of predicted interfaces, by `plug_in` or `nearby`, in closed form: by a parabola."""
        found = self.surrogate.predict(x)
        return local.log_gain(self.parabola.parabolas(found.mean), found.variance, plug_in)

    @cached_property
    def parabola(self) -> local.NearParabola | local.FittedParabola:
        """A parabola of log L around any field: of the likelihood nearby, or else fitted around the best inputs."""
        if self.nearby is not None:
            return self.nearby.parabola
        low, high = self.surrogate.warping.low, self.surrogate.warping.high
        spread = qmc.Sobol(len(low), seed=np.random.default_rng(0)).random(STARTS) - 0.5
        x = 0.5 * (low + high)
        for share in SHARES:
            tried = np.vstack([x, np.clip(x + share * (high - low) * spread, low, high)])
            x = tried[int(np.argmax(self.plug_in(tried)))]
        step = min(noise_length(seen, self.discrepancy) for seen in self.known_observations)
        return local.FittedParabola.fitted(self.at, self.surrogate.mean(x[None])[0], step)

    def _nearby_expected(self, near: Nearby, found: FieldPrediction, plug_in: Values) -> Values:
        """Return log E[L] by draws of a likelihood nearby; what this is off at the mean field counts in part."""
        drawn, size, values = local.numbers(NEAR_DRAWS, *self._sizes), max(_BLOCK // NEAR_DRAWS, 1), []
        for first in range(0, len(found.mean), size):
            part = slice(first, first + size)
            one = FieldPrediction(found.mean[part], found.variance[part])
            parabolas = near.parabola.parabolas(one.mean)
            off = plug_in[part] - near.log_likelihood(one.mean)
            rest = 1 - local.share_gained(parabolas, one.variance)
            values.append(local.mean_of_draws(near.log_likelihood, parabolas, one, drawn) + rest * off)
        return np.concatenate(values)

    def _agrees(self, found: FieldPrediction, values: Values, gained: Values) -> bool:
        """Return whether log E[L] is the same by the measure, at some likely points that gain little to much."""
        likely = np.flatnonzero(values >= values.max() - LIKELY)
        likely = likely[np.argsort(gained[likely], kind="stable")]
        some = likely[np.unique(np.linspace(0, len(likely) - 1, TRIED).astype(int))]
        exact = self._drawn(FieldPrediction(found.mean[some], found.variance[some]))
        return bool(np.abs(exact - values[some]).max() <= TOLERATED)

    def variances(self, x: Float[np.ndarray, "point dim"]) -> Values:
        """Return the variance of log L over the fields that the surrogate considers possible at each point.

        It is that of a parabola of log L: slopesᵀ V slopes + ½ tr (information V)².
        """
        return self._varied(self.surrogate.predict(x))

    def _varied(self, found: FieldPrediction) -> Values:
        around, V = self.parabola.parabolas(found.mean), found.variance
        squares = np.einsum("pmn,pm,pn->p", around.information**2, V, V)
        return np.asarray((around.slopes**2 * V).sum(axis=1) + 0.5 * squares)

    def left_out(self, runs: Int[np.ndarray, " run"]) -> tuple[Values, Values]:
        """Return log E[L] of the training runs with these indices, each predicted from all others, and the variance of
        log L over the fields possible there.
        """
        left_out = [process.left_out() for process in self.surrogate.processes]
        values = np.stack([p.observed.values for p in self.surrogate.processes], axis=1)
        mean = values - np.stack([one.errors for one in left_out], axis=1)
        found = FieldPrediction(mean[runs], np.stack([one.variances for one in left_out], axis=1)[runs])
        return self._drawn(found), self._varied(found)

    def _drawn(self, found: FieldPrediction) -> Values:
        parabolas = self.parabola.parabolas(found.mean)
        return local.mean_of_draws(self._of, parabolas, found, local.numbers(DRAWS, *self._sizes))

    def _of(
        self, coefficients: Float[np.ndarray, "draw mode"], tail: Float[np.ndarray, "draw rest"] | None
    ) -> Float[np.ndarray, " draw"]:
        points, templates = self.surrogate.points(coefficients, tail), self.surrogate.templates
        if self.inferred is not None:
            return self.inferred.likelihood.many(points, templates)
        if self._shared is not None:
            return -0.5 * self._shared.many(points, templates)
        total = np.zeros(len(coefficients))
        for seen in self.observations:
            template = templates[seen.condition]
            one = compared(seen, self.discrepancy, len(template.points))
            measure = one.measure
            if isinstance(measure, Currents):
                measure = measure.tolerating(one.noise.scale, seen.interface)
            squares = squared_discrepancies(measure, points[seen.condition], template, seen.interface)
            total += one.noise.log_density(squares)
        return total

    @cached_property
    def inferred(self) -> InferredNoise | None:
        """The noise inferred from the residuals; None if it is stated."""
        found = infer_noise(self.surrogate, self.observations)
        right, expected = isinstance(self.discrepancy, NormalOffset), "the measure normal_offset, which can infer it"
        remedy = "State the noise, or take that measure."
        require(found is None or right, "noise of the observed points", "unknown", expected, remedy)
        return found

    @property
    def known_observations(self) -> tuple[Observation, ...]:
        """The observations, with the posterior medians of a noise that was inferred as if they were known."""
        return tuple(self.observations) if self.inferred is None else self.inferred.at_median(self.observations)

    @cached_property
    def _shared(self) -> JointErrors | None:
        return shared_errors(self.observations, self.discrepancy)

    @property
    def _sizes(self) -> tuple[int, int]:
        return len(self.surrogate.modes.basis), len(self.surrogate.modes.tail)


def noise_length(
    observation: Observation, discrepancy: Discrepancy, *, of: Callable[[tuple[float, ...]], Any] = np.mean
) -> float:
    """Return the shift of the observed interface, mm, that costs half a unit of log-likelihood: d² = σ_N².

    By default this is the mean `of` shifts along the axes; half the interface's extent if no shift costs as much. Of
    stated errors of points, only the local ones count: a stated shift is marginalised and leaves the shape as well
    known.
    """
    errors, noise = observation.errors, cast(Hashable, observation.noise)
    known = MeasureKey.of(discrepancy), Snapshot.of(observation.interface)
    return float(of(_lengths_of(*known, noise if errors is None else errors.local_part)))


@lru_cache(maxsize=64)
def _lengths_of(key: MeasureKey, snapshot: Snapshot, noise: Noise | PointErrors) -> tuple[float, ...]:
    seen = snapshot.interface
    extent = float(np.ptp(seen.points, axis=0).max())
    return tuple(_shift(Observation(seen, noise), key.measure, axis, extent) for axis in np.eye(seen.dim))


def sd_of_distances(observation: Observation, discrepancy: Discrepancy, simulated: Interface) -> float | None:
    """Return the standard deviation of a distance, mm, or of a point; None if d² is no sum of squared distances."""
    if count_of_distances(discrepancy, simulated, observation.interface) is None:
        return None
    errors = observation.errors
    return errors.sd if errors is not None else float(np.sqrt(compared(observation, discrepancy, 0).noise.scale))


def _shift(
    observation: Observation, discrepancy: Discrepancy, direction: Float[np.ndarray, " xyz"], extent: float
) -> float:
    """Search in the logarithm: d² grows with small shifts. It counts from its value without a shift, which is not 0
    where means stand for many points of a rough interface.
    """
    seen, low, high = observation.interface, LEAST_SHIFT * extent, 0.5 * extent
    one = compared(observation, discrepancy, len(seen.points))
    for _ in range(ROUNDS):
        tried = np.geomspace(low, high, SHIFTS)
        shifted = seen.points + np.append(0.0, tried)[:, None, None] * direction
        squares = squared_discrepancies(one.measure, shifted, seen, seen)
        above = squares[1:] - squares[0] > one.noise.scale
        first = int(np.argmax(above)) if above.any() else SHIFTS - 1
        low, high = float(tried[max(first - 1, 0)]), float(tried[first])
    return high


def predicted(process: Predictor, *, power: float = 1.0) -> BatchedLogDensity:
    """Return `power` times the mean, for the sampler: with JAX if it is a Gaussian process, else for NumPy arrays."""
    if not isinstance(process, GaussianProcess):
        return OnHost(lambda x: power * np.asarray(process.mean(x), float))
    mean = batched_mean(process)
    return mean if power == 1.0 else lambda x: power * mean(x)


def evaluated(log_density: BatchedLogDensity) -> Callable[[Float[np.ndarray, "point dim"]], Any]:
    """Return the same for NumPy arrays, compiled if possible."""
    function: Callable[..., Any] = log_density if is_on_host(log_density) else jax.jit(log_density)
    return function
