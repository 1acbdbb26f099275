"""The posterior as weighted particles, its summaries, all of them weighted, and the interfaces that it predicts."""

import html
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, ndtr, ndtri

from strandline.foundations import html_table, html_text, require, unit_text, with_sd
from strandline.interface import Interface
from strandline.parameters import LogUniform, ParameterSpace, Uniform
from strandline.posterior.random_field import FieldPosterior, prior_draws
from strandline.posterior.weighted import PerParticle, Weighted, generator, systematic_indices

MOST_SHOWN = 8  # inputs named in one line
OFF, ROUNDING = 0.1, 1e-7
"""Logarithms of the weights' sum: normalised weights are below the first; rounding leaves more than the second if
log-likelihoods are of the order of -1e9."""
FLAT = (Uniform, LogUniform)
"""Priors that say no more than where their ends are; a posterior at an end has a warning of its own."""
LEVEL = 0.01  # probability, if prior and model are right, below which there is a warning: one false alarm in 100 inputs
LEAST_REMOVED = 0.05
"""Least share of the prior's variance that is taken to be removed: less is within the error of the draws."""
LEVELS = (0.05, 0.5, 0.95)  # of a band of interfaces
EDGE = 1e-12  # keeps normal quantiles finite


@dataclass(frozen=True, eq=False)
class Posterior:
    """Weighted draws of p(x, θ | Y) (paper (3a)) with the log-likelihood and the log prior density, in physical units,
    of each.

    The inputs of `space` are in the order of the columns of `draws`, physical values (particle, dim). The log weights
    (particle,) are normalised, and normalised again if rounding was large; -inf is a particle without weight.
    `log_evidence` is the log of the integral of likelihood times prior. Tempering with a step control near 1 ends with
    unequal weights: an unweighted summary of `draws` is wrong.

    Raises:
        InvalidInput: lengths that differ, draws that are not finite, or weights that do not sum to one.
    """

    space: ParameterSpace
    draws: Float[np.ndarray, "particle dim"]
    log_weights: PerParticle
    log_likelihood: PerParticle
    log_prior: PerParticle
    log_evidence: float

    def __post_init__(self) -> None:
        _require_shapes(self)
        total = float(logsumexp(self.log_weights)) if not np.isnan(self.log_weights).any() else np.nan
        words = "0 (normalised log weights)", "Subtract logsumexp(log_weights) first."
        require(abs(total) < OFF, "log of the sum of the posterior's weights", total, *words)
        if abs(total) > ROUNDING:
            object.__setattr__(self, "log_weights", self.log_weights - total)

    def __repr__(self) -> str:
        return f"<Posterior {self.line}; {self.number} particles, ESS {self.ess:.0f}>"

    def _repr_html_(self) -> str:
        low, high = self.quantiles([0.05, 0.95])
        columns = np.stack([self.mean, self.sd, self.map_estimate, low, high], axis=1)
        rows = [
            (html_text(one.name), html.escape(unit_text(one.unit)), *(f"{value:.4g}" for value in row))
            for one, row in zip(self.space, columns, strict=True)
            if one.name in self.space.scalars
        ]
        fields = "".join(one._repr_html_() for one in self.fields.values())
        head = ("input", "unit", "mean", "sd", "MAP", "5 %", "95 %")
        return (html_table(head, rows) if rows else "") + fields

    @property
    def line(self) -> str:
        """Mean ± standard deviation of inputs and of means of fields: ``E = 399.6 ± 15 Pa, nu = 0.297 ± 0.059``."""
        rows = zip(self.space, self.mean.tolist(), self.sd.tolist(), strict=True)
        shown = [row for row in rows if row[0].name in self.space.scalars]
        parts = [f"{p.name} = {with_sd(middle, width)} {unit_text(p.unit)}".rstrip() for p, middle, width in shown]
        parts += [one.line for one in self.fields.values()]
        more = f", and {len(parts) - MOST_SHOWN} more" if len(parts) > MOST_SHOWN else ""
        return ", ".join(parts[:MOST_SHOWN]) + more

    @cached_property
    def weights(self) -> PerParticle:
        """Normalised weights (particle,)."""
        return np.asarray(np.exp(self.log_weights))

    @cached_property
    def fields(self) -> dict[str, FieldPosterior]:
        """What is known of each random field whose coefficients are among the inputs, by its name."""
        if not (fields := self.space.fields):
            return {}
        prior, places = prior_draws(self.space), {name: k for k, name in enumerate(self.space.names)}
        columns = {one.name: [places[name] for name in one.names] for one in fields}
        given = ((one, self.draws[:, columns[one.name]], prior[:, columns[one.name]]) for one in fields)
        return {one.name: FieldPosterior(one, draws, self.weights, before) for one, draws, before in given}

    @property
    def number(self) -> int:
        """Number of particles."""
        return len(self.draws)

    @property
    def ess(self) -> float:
        """Effective sample size of the weights, 1 / Σ w²."""
        return float(1.0 / np.sum(self.weights**2))

    @property
    def mean(self) -> Float[np.ndarray, " dim"]:
        """Posterior mean (dim,)."""
        return Weighted(self.draws, self.weights).mean

    @property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        """Posterior covariance (dim, dim): the second central moment of the weighted draws."""
        return Weighted(self.draws, self.weights).covariance

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        """Posterior standard deviation (dim,)."""
        return np.sqrt(np.diag(self.covariance))

    def quantiles(self, p: float | Sequence[float] | Float[np.ndarray, " level"]) -> Float[np.ndarray, "*level dim"]:
        """Return the smallest draw with weighted cumulative probability ≥ p, input by input, (level, dim) or (dim,)."""
        levels = np.asarray(p, float)
        how: dict[str, Any] = {"weights": self.weights, "method": "inverted_cdf"}
        return np.stack([np.quantile(column, levels, **how) for column in self.draws.T], axis=-1)

    @property
    def log_density(self) -> PerParticle:
        """Normalised log posterior density at the particles: log L + log prior - log Z (particle,)."""
        return np.asarray(self.log_likelihood + self.log_prior - self.log_evidence)

    @property
    def information(self) -> float:
        """What the data tell about the inputs, nats: the mean log-likelihood minus the log-evidence."""
        known = np.isfinite(self.log_likelihood)
        return float(self.weights[known] @ self.log_likelihood[known]) - self.log_evidence

    @property
    def map_index(self) -> int:
        """Index of the particle with the highest posterior density.

        With nuisance inputs among the columns this is the mode of the *joint* density; for the posterior under
        uncertainty see `histogram_mode` (paper, Remark 8).
        """
        density = self.log_likelihood + self.log_prior
        return int(np.argmax(np.where(np.isnan(density), -np.inf, density)))

    @property
    def map_estimate(self) -> Float[np.ndarray, " dim"]:
        """The particle with the highest posterior density (dim,), physical."""
        return np.asarray(self.draws[self.map_index])

    def columns(self, names: Sequence[str]) -> Float[np.ndarray, "particle column"]:
        """Return the draws of the inputs `names`, in that order: marginal draws, with the same weights."""
        unknown = [name for name in names if name not in self.space.names]
        words = f"names out of {list(self.space.names)}", "Correct the names."
        require(not unknown, "names of inputs of the posterior", unknown, *words)
        return np.asarray(self.draws[:, [self.space.names.index(name) for name in names]])

    def equally_weighted(self, seed: Any, number: int | None = None) -> Float[np.ndarray, "draw dim"]:
        """Return draws of equal weight by systematic resampling, in the order of the particles; by default as many as
        these.

        Copies of one particle are adjacent, so that an autocorrelation-based effective sample size (such as ArviZ's)
        takes them into account. The seed is an integer, a NumPy generator or a JAX key.
        """
        size = self.number if number is None else number
        require(size >= 1, "number of equally weighted draws", number, "at least 1", "Ask for at least one draw.")
        return np.asarray(self.draws[systematic_indices(self.weights, size, generator(seed))])


def _require_shapes(posterior: Posterior) -> None:
    number, dim = posterior.draws.shape
    lengths = [len(a) for a in (posterior.log_weights, posterior.log_likelihood, posterior.log_prior)]
    right = number > 0 and dim == posterior.space.dim and set(lengths) == {number}
    value = f"draws {posterior.draws.shape}, weights, likelihoods and priors {lengths}"
    expected = f"(particle, {posterior.space.dim}) and three times (particle,)"
    remedy = "Pass one value per particle and one column per input."
    require(right, "sizes of the posterior's arrays", value, expected, remedy)
    finite = np.isfinite(posterior.draws).all(axis=1)
    bad = int(np.argmax(~finite))
    words = "finite physical values", "Check the sampler: a particle has left the design box."
    require(finite.all(), f"particle {bad} of the posterior", posterior.draws[bad].tolist(), *words)


def prior_conflicts(posterior: Posterior) -> Iterator[str]:
    """Yield a warning for each input whose prior the data contradict, unless that prior is flat.

    If prior and model are right, the posterior mean of a normal input is itself a normal draw: its mean is that of the
    prior, and its variance the prior's minus the posterior's. Other priors are first mapped to the standard normal one.
    The coefficients of a field together have as many false alarms as one input.
    """
    shares = np.clip(posterior.space.marginal_shares(posterior.draws), EDGE, 1 - EDGE)
    normal = Weighted(ndtri(shares), posterior.weights)
    z = normal.mean / np.sqrt(np.maximum(1 - normal.sd**2, LEAST_REMOVED))
    for k, one in enumerate(posterior.space):
        p = float(2 * ndtr(-abs(z[k])))
        level = LEVEL if one.of_field is None else LEVEL / one.of_field.count
        if p < level and not isinstance(one.prior, FLAT):
            unit = "" if one.unit in ("", "1") else f" {one.unit}"
            yield (
                f"The data contradict the prior of {one.name}, {one.prior}: a right prior and a right model would put "
                f"the posterior, {posterior.mean[k]:.4g} ± {posterior.sd[k]:.2g}{unit}, as far out with probability "
                f"{p:.1g} only. It is a compromise of both; check the prior, its unit, and the model."
            )


@dataclass(frozen=True, eq=False)
class Histogram:
    """Marginal of one input: the probability of each bin between edges in the unit of the input."""

    edges: Float[np.ndarray, " edge"]
    mass: Float[np.ndarray, " bin"]

    @property
    def density(self) -> Float[np.ndarray, " bin"]:
        """Probability density of each bin (bins,), in one over the unit of the input."""
        return np.asarray(self.mass / np.diff(self.edges))


def histogram(
    values: PerParticle,
    weights: PerParticle,
    *,
    bounds: tuple[float, float] | None = None,
    bins: int = 30,
) -> Histogram:
    """Return the weighted histogram of one input between `bounds`, by default the range of `values`.

    Raises:
        InvalidInput: Draws outside the bounds.
    """
    limits = _limits(values, bounds)
    mass, edges = np.histogram(values, bins=bins, range=limits, weights=weights)
    return Histogram(edges, np.asarray(mass, float))


def histogram_mode(
    draws: Float[np.ndarray, "particle dim"],
    weights: PerParticle,
    *,
    bounds: Sequence[tuple[float, float]],
    bins: int = 30,
) -> Float[np.ndarray, " dim"]:
    """Return the centre of the bin with the highest probability (dim,); the first if several tie.

    This is the MAP estimate under uncertainty (paper, Remark 8): pass only the columns of the calibrated inputs, which
    integrates over the nuisance inputs. The study takes 30 bins per input in 2-D and 10 in 6-D.
    """
    limits = np.array([_limits(column, bound) for column, bound in zip(draws.T, bounds, strict=True)])
    low, width = limits[:, 0], (limits[:, 1] - limits[:, 0]) / bins
    cell = np.minimum(((draws - low) / width).astype(int), bins - 1)
    cells, member = np.unique(cell, axis=0, return_inverse=True)
    mass = np.bincount(member.ravel(), weights=weights, minlength=len(cells))
    return np.asarray(low + (cells[np.argmax(mass)] + 0.5) * width)


def _limits(values: PerParticle, bounds: tuple[float, float] | None) -> tuple[float, float]:
    low, high = (float(values.min()), float(values.max())) if bounds is None else bounds
    expected = f"bounds that contain all draws, {values.min():g} to {values.max():g}"
    remedy = "Widen the bounds: draws left out would be probability left out."
    inside = not (values.min() < low or values.max() > high)
    require(inside, "range of a histogram", [low, high], expected, remedy)
    return low, high


@dataclass(frozen=True, eq=False)
class InterfaceBand:
    """Quantiles at 5, 50 and 95 %, node by node and coordinate by coordinate, mm."""

    low: Float[np.ndarray, "point xyz"]
    median: Float[np.ndarray, "point xyz"]
    high: Float[np.ndarray, "point xyz"]


@dataclass(frozen=True, eq=False)
class Offsets:
    """Signed distances from a polyline, mm, positive to the left of its direction, at positions along it, mm."""

    arc_length: Float[np.ndarray, " point"]
    offset: Float[np.ndarray, "*draw point"]


def interface_band(points: Float[np.ndarray, "draw point xyz"]) -> InterfaceBand:
    """Return the pointwise quantiles of interfaces that have the same nodes."""
    return InterfaceBand(*np.quantile(points, LEVELS, axis=0))


def normal_offsets(points: Float[np.ndarray, "draw point 2"], centre: Interface) -> Offsets:
    """Return how far each node lies from the same node of `centre`, along the normal there; one row per draw."""
    normals = np.zeros_like(centre.points)
    for corner in centre.cells.T:
        np.add.at(normals, corner, centre.normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arc_length = np.zeros(len(centre.points))
    arc_length[centre.cells[:, 0]] = _starts(centre)
    if not centre.closed:
        arc_length[centre.cells[-1, 1]] = centre.lengths.sum()
    return Offsets(arc_length, np.sum((points - centre.points) * normals, axis=2))


def observed_offsets(observed: Interface, centre: Interface) -> Offsets:
    """Return the distance of each point of `observed` from the closest point of the polyline `centre`."""
    tangent = centre.ends - centre.starts
    apart = observed.points[:, None] - centre.starts
    share = np.clip(np.sum(apart * tangent, axis=2) / centre.lengths**2, 0.0, 1.0)
    distance = np.linalg.norm(apart - share[..., None] * tangent, axis=2)
    rows, nearest = np.arange(len(distance)), np.argmin(distance, axis=1)
    side = np.sum(apart * centre.normals, axis=2)[rows, nearest]
    arc_length = (_starts(centre) + share * centre.lengths)[rows, nearest]
    order = np.argsort(arc_length, kind="stable")
    return Offsets(arc_length[order], (np.copysign(distance[rows, nearest], side))[order])


def _starts(polyline: Interface) -> Float[np.ndarray, " cell"]:
    """Return the arc length at which each segment starts."""
    return np.asarray(np.cumsum(polyline.lengths) - polyline.lengths)
