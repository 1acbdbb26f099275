"""The sd and the correlation length of the points' errors, inferred from what no input can explain.

At the inputs that fit best, the residuals r̂ are linear in the inputs, with slopes J. With local errors correlated as
exp(-t/ℓ) along the interface, global errors B and a wide prior over the inputs, r̂ is Gaussian with the covariance
s²R(ℓ) + BBᵀ + JΣJᵀ: inputs and global errors are marginalised in closed form, and p(s, ℓ | r̂) follows on a grid. Errors
correlated like that are a Markov chain along the interface, so that each pair (s, ℓ) costs O(n).

The posterior of the inputs is the mixture over the grid of the posteriors with known s and ℓ. Of these, only the level
of the noise at low frequencies matters, κ = s² coth(h/2ℓ). A model error, if it is asked for, adds its amplitude and
its length to the grid.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.special import logsumexp

from strandline.discrepancy import Discrepancy, JointErrors, NormalOffset
from strandline.foundations import require
from strandline.interface import (
    ErrorModel,
    Interface,
    Observation,
    PointErrors,
    UnknownErrors,
    arc_lengths,
    spacings,
    steady_lengths,
    summed_length,
)
from strandline.likelihood.linearised_residuals import Linearised, NearField, linearise
from strandline.likelihood.local_likelihood import Mixture
from strandline.surrogate import FieldSurrogate

Sds = Float[np.ndarray, " sd"]
Values = Float[np.ndarray, " value"]
Shared = Float[np.ndarray, "seen error"]
Residuals = Float[np.ndarray, " seen"]
WAVES = 12  # number of waves along the interface
AMPLITUDES = np.geomspace(0.3, 10.0, 6)  # amplitudes a compared, in root mean squares of the residuals
OFFSET_LENGTHS = (0.05, 0.15, 0.5)  # lengths L compared, as shares of the length of the interface
SPREADS = (0.02, 0.05, 0.1, 0.25, 0.5)
"""Standard deviations τ compared, as shares of that of a uniform prior over the box."""
SDS, LENGTHS = 33, 15
WIDER = 1.5  # factor by which the second grid exceeds what was found on the first
LEVELS = 12  # noise levels of the mixture, for each model error
NEGLIGIBLE = 1e-7  # probability below which a pair of amplitude and length of the model error is left out


@dataclass(frozen=True)
class Cause:
    """An error of the model: amplitude a of the offset, mm, its length as a share of the interface's, and τ.

    All zero (but for the length) if the model is right.
    """

    amplitude: float = 0.0
    share: float = 1.0
    spread: float = 0.0


@dataclass(frozen=True, eq=False)
class Causes:
    """Errors of the model to compare, the first of which is none, and what they do to the residuals.

    The offset is a Gaussian process of the arc length with the covariance a² exp(-t/L) (Kennedy and O'Hagan 2001),
    written as cosine waves whose variances are its spectral density (Solin and Särkkä 2020). The posterior average over
    a and L widens where the residuals ask for it, and only there. It also explains away what inputs could have
    explained: what they do to the interface must differ from a smooth offset.

    The embedded error is an input with a spread (Sargsyan et al. 2015): each condition has its own value, whose
    standard deviation τ around the common one is unknown.

    `columns` are what the waves, and deviations of inputs in each condition, do to the signed distances, mm; `scales`
    are their standard deviations for each error.
    """

    compared: tuple[Cause, ...]
    columns: Float[np.ndarray, "seen column"]
    scales: Float[np.ndarray, "cause column"]


def causes_of(lin: Linearised, observations: Sequence[Observation], unknown: UnknownErrors) -> Causes:
    """Return the errors of the model that are to be considered."""
    interfaces = [o.interface for o in observations]
    rms = float(np.sqrt(np.mean(lin.residuals**2))) or 1e-9
    offsets = [(a * rms, share) for a in AMPLITUDES for share in OFFSET_LENGTHS] if unknown.model_error else []
    spreads = SPREADS if unknown.spread else ()
    compared = [Cause(), *(Cause(a, share) for a, share in offsets), *(Cause(spread=tau) for tau in spreads)]
    compared += [Cause(a, share, tau) for a, share in offsets for tau in spreads]
    waves = block_diag(*[offset_waves(one) for one in interfaces]) if offsets else np.empty((len(lin.residuals), 0))
    ends = np.cumsum([len(one.points) for one in interfaces])
    chosen = lin.scaled[:, list(unknown.spread)]
    each = block_diag(*np.split(chosen, ends[:-1])) if spreads else np.empty((len(lin.residuals), 0))
    spread = [np.full(each.shape[1], cause.spread) for cause in compared]
    wavy = [[offset_scales(one, cause.amplitude, cause.share) for one in interfaces if offsets] for cause in compared]
    scales = [np.concatenate([*some, one]) for some, one in zip(wavy, spread, strict=True)]
    return Causes(tuple(compared), np.hstack([waves, each]), np.array(scales))


def offset_waves(seen: Interface) -> Float[np.ndarray, "point wave"]:
    """Return waves cos(πjt) at the observed points, t the share of the arc length; on a closed one sines too."""
    t = arc_lengths(seen) / float(steady_lengths(seen).sum())
    if seen.closed:
        angle = 2 * np.pi * t[:, None] * np.arange(WAVES // 2 + 1)
        return np.concatenate([np.cos(angle), np.sin(angle[:, 1:])], axis=1)
    return np.cos(np.pi * t[:, None] * np.arange(WAVES))


def offset_scales(seen: Interface, amplitude: float, share: float) -> Float[np.ndarray, " wave"]:
    """Return the standard deviation of each wave for an amplitude a, mm, and a length L, a share of the interface's."""
    each = np.arange(WAVES // 2 + 1)
    number = 2 * np.concatenate([each, each[1:]]) if seen.closed else np.arange(WAVES)
    density = 2 * share / (1 + (math.pi * number * share) ** 2)
    norm = np.where(number == 0, 1.0, 2.0)
    return np.asarray(amplitude * np.sqrt(norm * density))


@dataclass(frozen=True, eq=False)
class NoisePosterior:
    """Posterior of the noise on a grid: s, mm, ℓ, mm, and the model error, of which the first is none.

    `weights` are probabilities, whose sum is 1. `log_evidence` is the log density of the residuals, averaged over the
    prior, or over the grid where no range is stated, without the constant -½ n log 2π.
    """

    sds: Sds
    lengths: Float[np.ndarray, " length"]
    causes: tuple[Cause, ...]
    weights: Float[np.ndarray, "cause sd length"]
    log_evidence: float

    def quantiles(self, levels: Sequence[float]) -> dict[str, list[float]]:
        """Return quantiles of ``sd`` and ``length``, mm."""
        sd, length = self.weights.sum(axis=(0, 2)), self.weights.sum(axis=(0, 1))
        return {"sd": _quantiles(levels, self.sds, sd), "length": _quantiles(levels, self.lengths, length)}

    def quantiles_of_offset(self, levels: Sequence[float]) -> dict[str, list[float]] | None:
        """Return quantiles of the offset's ``amplitude``, mm, and ``share``, given that there is one.

        The share is its length in lengths of the interface. None if no offset was allowed.
        """
        mass, erring = self.weights.sum(axis=(1, 2)), [k for k, one in enumerate(self.causes) if one.amplitude > 0]
        whole = float(mass[erring].sum()) if erring else 0.0
        if not whole > 0:
            return None
        found = {}
        for name in ("amplitude", "share"):
            values, which = np.unique([getattr(self.causes[k], name) for k in erring], return_inverse=True)
            found[name] = _quantiles(levels, values, np.bincount(which, mass[erring] / whole))
        return found

    @property
    def probability_of_model_error(self) -> float:
        """Posterior probability that the model errs."""
        return float(self.weights[1:].sum())

    @property
    def model_error(self) -> float:
        """Posterior root mean square of the offset's amplitude, mm."""
        return float(np.sqrt(self.weights.sum(axis=(1, 2)) @ np.array([one.amplitude**2 for one in self.causes])))

    @property
    def spread(self) -> float:
        """Posterior root mean square of the inputs' spread, in standard deviations of a uniform prior over the box."""
        return float(np.sqrt(self.weights.sum(axis=(1, 2)) @ np.array([one.spread**2 for one in self.causes])))


@dataclass(frozen=True, eq=False)
class InferredNoise:
    """The likelihood of the inputs with the noise marginalised, and the posterior of the noise and of the model's
    errors.

    `explained` is what these errors do to the residuals, in root mean square of the posterior, mm; `field` the
    residuals as a function of the field near the best fit; `without` the likelihood of a model that does not err, with
    its own noise, None if no error was allowed.
    """

    likelihood: Mixture
    posterior: NoisePosterior
    explained: Float[np.ndarray, "seen cause"]
    field: NearField
    without: Mixture | None = None

    def at_median(self, observations: Sequence[Observation]) -> tuple[Observation, ...]:
        """Return the observations with the posterior medians of s and ℓ as if they were known."""
        return tuple(replace(one, noise=self.median(one.unknown)) for one in observations if one.unknown)

    def median(self, noise: UnknownErrors) -> PointErrors:
        """Return the errors with the posterior medians of s and ℓ."""
        return noise.known(*(self.posterior.quantiles([0.5])[name][0] for name in ("sd", "length")))


def require_inferable(observations: Sequence[Observation], measure: Discrepancy, *, by_field: bool) -> None:
    """Refuse unknown noise where nothing can infer it: it would count with a first guess.

    Raises:
        InvalidInput: Measure, surrogate or observations do not fit unknown noise.
    """
    for seen in observations:
        if seen.unknown:
            seen.unknown.require_fits(seen.interface)
    require_inferable_noise([seen.noise for seen in observations], measure, by_field=by_field)


def require_inferable_noise(noises: Sequence[object], measure: Discrepancy, *, by_field: bool) -> None:
    """Refuse the same before the observations are known, from the noise of each."""
    unknown = [one for one in noises if isinstance(one, UnknownErrors)]
    value, expected = "", "the measure normal_offset and a surrogate of the field"
    if not isinstance(measure, NormalOffset):
        value = f"the measure {type(measure).__name__}"
    elif not by_field:
        value = "a surrogate of the log-likelihood"
    elif len(unknown) < len(noises):
        value, expected = "an observation without", "the same unknown noise, or model error, for every condition"
    elif len({(one.sd, one.length, one.model_error, one.spread) for one in unknown}) > 1:
        value, expected = "different unknown noise", "the same sd, length, model_error and spread for every condition"
    remedy = "Change it (`discrepancy: {normal_offset: {}}`, `surrogate: {field: {}}`), or state all noise."
    require(not (unknown and value), "noise: an unknown sd or length, or a model error", value, expected, remedy)


def infer_noise(surrogate: FieldSurrogate, observations: Sequence[Observation]) -> InferredNoise | None:
    """Return the likelihood with inferred noise; None if no observation states unknown errors."""
    unknown = [o.unknown for o in observations if o.unknown]
    if len(unknown) < len(observations):
        return None
    typical = [one.typical(o.interface) for one, o in zip(unknown, observations, strict=True)]
    lin = linearise(surrogate, JointErrors(tuple(observations), tuple(typical)))
    first = posterior_of_noise(lin, observations, unknown, causes_of(lin, observations, unknown[0]))
    sd, length = (first.quantiles([0.5])[name][0] for name in ("sd", "length"))
    likely = tuple(one.known(sd, length) for one in unknown)
    lin = linearise(surrogate, JointErrors(tuple(observations), likely))  # weighs the residuals better
    causes = causes_of(lin, observations, unknown[0])
    found = posterior_of_noise(lin, observations, unknown, causes, near=first)
    size = np.sqrt(found.weights.sum(axis=(1, 2)) @ causes.scales**2)
    without, seen = None, tuple(observations)
    if len(causes.compared) > 1:
        none = Causes(causes.compared[:1], causes.columns, causes.scales[:1])
        without = _mixture(lin, seen, unknown, none, posterior_of_noise(lin, seen, unknown, none))
    mixture = _mixture(lin, seen, unknown, causes, found)
    field = replace(lin.field, model=mixture.model)
    return InferredNoise(mixture, found, causes.columns * size, field, without)


def posterior_of_noise(
    lin: Linearised,
    observations: Sequence[Observation],
    unknown: Sequence[UnknownErrors],
    causes: Causes,
    *,
    near: NoisePosterior | None = None,
) -> NoisePosterior:
    """Return p(s, ℓ, cause | r̂) on a grid even in logarithms, for priors flat there, half of them on no error."""
    interfaces = [o.interface for o in observations]
    sds, lengths = _grid(lin, interfaces, unknown[0], near)
    shared = _unit_errors(observations, unknown).model.shared
    log_density = np.empty((len(causes.compared), len(sds), len(lengths)))
    for k, scales in enumerate(causes.scales):
        F = np.hstack([shared, lin.scaled, (causes.columns * scales)[:, scales > 0]])
        for j, length in enumerate(lengths):
            log_density[k, :, j] = _log_evidences(lin.residuals, F, interfaces, sds, length)
    log_density[1:] -= np.log(max(len(log_density) - 1, 1))
    whole = float(logsumexp(log_density))
    log_evidence = whole - float(np.log(len(sds) * len(lengths) * (1 if len(log_density) == 1 else 2)))
    log_evidence += _log_share(unknown[0].sd, sds) + _log_share(unknown[0].length, lengths)
    return NoisePosterior(sds, lengths, causes.compared, np.exp(log_density - whole), log_evidence)


def _grid(
    lin: Linearised, interfaces: Sequence[Interface], unknown: UnknownErrors, near: NoisePosterior | None
) -> tuple[Sds, Float[np.ndarray, " length"]]:
    """Return values of s and ℓ: a wide range, or one around what was found there."""
    spacing = float(np.mean([spacings(one).mean() for one in interfaces]))
    shortest = 0.5 * min(float(one.lengths.sum()) for one in interfaces)
    longest = max(0.1 * max(float(one.lengths.sum()) for one in interfaces), 2 * spacing)
    low, high = unknown.length if isinstance(unknown.length, tuple) else (0.1 * spacing, min(longest, shortest))
    rms = max(float(np.sqrt(np.mean(lin.residuals**2))), 1e-6 * spacing)
    least, most = (0.003 if unknown.model_error else 0.1) * rms, 4 * rms
    if near is not None:
        found = near.quantiles([0.001, 0.999])
        least, most = found["sd"][0] / WIDER, found["sd"][1] * WIDER
        low, high = found["length"][0] / WIDER, min(found["length"][1] * WIDER, shortest)
    return unknown.sds(np.geomspace(least, most, SDS)), unknown.lengths(np.geomspace(low, high, LENGTHS))


def _quantiles(levels: Sequence[float], values: Values, mass: Values) -> list[float]:
    """Return quantiles of probabilities on a grid, interpolated in the logarithm of the values."""
    return [float(one) for one in np.exp(np.interp(levels, np.cumsum(mass) - 0.5 * mass, np.log(values)))]


def _log_share(given: tuple[float, float] | float | None, values: Values) -> float:
    """Return the log prior probability of the values' range: 0 unless a wider one was stated."""
    if not isinstance(given, tuple):
        return 0.0
    return float(np.log(np.log(values[-1] / values[0]) / np.log(given[1] / given[0])))


def _unit_errors(observations: Sequence[Observation], unknown: Sequence[UnknownErrors]) -> JointErrors:
    return JointErrors(tuple(observations), tuple(one.known(1.0, 0.0) for one in unknown))


def _log_evidences(r: Residuals, F: Shared, interfaces: Sequence[Interface], sds: Sds, length: float) -> Sds:
    """Return log N(r; 0, s²R(ℓ) + FFᵀ) without the constant, for each s."""
    both, log_det, first = np.column_stack([r, F]), 0.0, 0
    white = np.empty_like(both)
    for one in interfaces:
        places = arc_lengths(one)
        order = np.argsort(places, kind="stable")
        keep = np.exp(-np.diff(places[order]) / length)
        new = np.sqrt(1 - keep**2)
        part = both[first : first + len(one.points)][order]
        white[first] = part[0]
        white[first + 1 : first + len(part)] = (part[1:] - keep[:, None] * part[:-1]) / new[:, None]
        log_det += 2 * float(np.log(new).sum())
        first += len(part)
    square, product, G = white[:, 0] @ white[:, 0], white[:, 1:].T @ white[:, 0], white[:, 1:].T @ white[:, 1:]
    values, vectors = np.linalg.eigh(G)
    values, rotated = np.maximum(values, 0.0), (vectors.T @ product) ** 2
    out = np.empty(len(sds))
    for k, variance in enumerate(sds**2):
        least = square / variance - (rotated / (variance * (variance + values))).sum()
        whole = log_det + len(r) * np.log(variance) + np.log1p(values / variance).sum()
        out[k] = -0.5 * (least + whole)
    return out


def _mixture(
    lin: Linearised,
    observations: tuple[Observation, ...],
    unknown: Sequence[UnknownErrors],
    causes: Causes,
    found: NoisePosterior,
) -> Mixture:
    """Return the mixture of the likelihoods with known noise, each with the evidence that the grid gives it."""
    interfaces = [o.interface for o in observations]
    spacing = float(np.mean([spacings(one).mean() for one in interfaces]))
    local = np.concatenate([spacing / spacings(one) for one in interfaces])
    joint = _unit_errors(observations, unknown)
    shared = np.hstack([joint.model.shared, causes.columns])
    ones = np.ones(shared.shape[1] - causes.columns.shape[1])
    entries = [
        (level, scales, found.log_evidence + np.log(weight) + _normaliser(lin, level * local, shared * scales))
        for weight, level, cause in _levels(found, spacing)
        for scales in [np.concatenate([ones, causes.scales[cause]])]
    ]
    return Mixture(joint, local, shared, *(np.array(part) for part in zip(*entries, strict=True)))


def _levels(found: NoisePosterior, spacing: float) -> Iterator[tuple[float, float, int]]:
    """Yield weight, κ and number of the cause, for quantiles of κ under each cause."""
    kappa = (found.sds[:, None] ** 2 * 2 * summed_length(found.lengths, spacing) / spacing).ravel()
    order = np.argsort(kappa)
    for cause, weights in enumerate(found.weights):
        mass, whole = weights.ravel()[order], float(weights.sum())
        if whole < NEGLIGIBLE:
            continue
        place = np.minimum((np.cumsum(mass) - 0.5 * mass) / whole * LEVELS, LEVELS - 1e-9).astype(int)
        for k in range(LEVELS):
            part = mass * (place == k)
            if part.sum() > 0:
                yield float(part.sum()), float(np.exp(part @ np.log(kappa[order]) / part.sum())), cause


def _normaliser(lin: Linearised, local: Residuals, shared: Shared) -> float:
    """Return minus the log evidence of the residuals with the inputs marginalised, over that without inputs."""
    alone, with_inputs = ErrorModel(local, shared), ErrorModel(local, np.hstack([shared, lin.scaled]))
    least = float(with_inputs.square(lin.residuals))
    return 0.5 * (least + with_inputs.log_det - alone.log_det)
