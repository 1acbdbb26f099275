"""Evidence and moments of a density in one to three dimensions by adaptive cubature, to check a sampler.

The box is cut into equal cells with a tensor Gauss-Legendre rule in each. Cells are halved in every direction if
that can still change the evidence, a mean or a standard deviation. The difference between a cell and its halves is
their error estimate, so it is always the error of the coarser rule.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from strandline.foundations import NumericsError, require
from strandline.posterior.posterior import Histogram

__all__ = ["LogDensity", "QuadratureResult", "integrate", "mixture"]
LogDensity = Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]]
_CELLS = {1: 256, 2: 32, 3: 16}  # initial cells per direction
_NODES = {1: 4, 2: 4, 3: 3}  # nodes per direction and cell
_LEFT_ALONE = 0.1  # cells that together carry less than this share of the tolerance are not refined


@dataclass(frozen=True, eq=False)
class QuadratureResult:
    """Evidence log ∫ exp(log density) dx and moments over a box, physical, with a histogram for each direction.

    `evaluations` counts points without the padding of the last batch, `levels` the refinements made. It `converged` if
    the estimated errors are below their tolerances: those of the log evidence, the largest of a mean, in standard
    deviations, and the largest relative one of a standard deviation.
    """

    log_evidence: float
    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]
    sd: Float[np.ndarray, " dim"]
    evaluations: int
    converged: bool
    levels: int
    error_log_evidence: float
    error_mean: float
    error_sd: float
    marginals: tuple[Histogram, ...]


class _Cells(NamedTuple):
    """Cells of the unit cube with their integrals of (1, u, u uᵀ)·exp(log density - log_unit). `difference` holds, for
    the integrals of a cell, its share of the change that the refinement brought.
    """

    low: Float[np.ndarray, "cell dim"]
    width: Float[np.ndarray, " cell"]
    integral: Float[np.ndarray, "cell moment"]
    difference: Float[np.ndarray, "cell moment"]
    log_unit: float

    def where(self, chosen: Bool[np.ndarray, " cell"]) -> "_Cells":
        low, width, integral, difference = (part[chosen] for part in self[:4])
        return _Cells(low, width, integral, difference, self.log_unit)

    def rescaled(self, log_unit: float) -> "_Cells":
        factor = math.exp(self.log_unit - log_unit) if self.log_unit > -math.inf else 0.0
        return _Cells(self.low, self.width, self.integral * factor, self.difference * factor, log_unit)

    def joined(self, other: "_Cells") -> "_Cells":
        log_unit = max(self.log_unit, other.log_unit)
        pairs = zip(self.rescaled(log_unit)[:4], other.rescaled(log_unit)[:4], strict=True)
        low, width, integral, difference = (np.concatenate(pair) for pair in pairs)
        return _Cells(low, width, integral, difference, log_unit)


class _Moments(NamedTuple):
    """Moments in the unit cube; `mass` in units of exp(log_unit)."""

    mass: float
    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)))  # rounding may leave -1e-20


class _Rule:
    """The tensor Gauss-Legendre rule of a box, and a counter of its evaluations."""

    def __init__(
        self, log_density: LogDensity, low: Float[np.ndarray, " dim"], high: Float[np.ndarray, " dim"], batch: int
    ) -> None:
        self.log_density, self.low, self.high, self.batch = log_density, low, high, batch
        self.dim = len(low)
        nodes, weights = np.polynomial.legendre.leggauss(_NODES[self.dim])
        self.nodes = np.array(list(product(0.5 * (nodes + 1), repeat=self.dim)))
        self.weights = np.prod(list(product(0.5 * weights, repeat=self.dim)), axis=1)
        self.evaluations = 0

    def cells(self, low: Float[np.ndarray, "cell dim"], width: Float[np.ndarray, " cell"]) -> _Cells:
        """Integrate over the cells; their difference is the integral itself, as the error is not known yet."""
        u = low[:, None, :] + width[:, None, None] * self.nodes
        log_values = self._evaluate(u.reshape(-1, self.dim)).reshape(u.shape[:2])
        log_unit = float(log_values.max())
        values = np.exp(log_values - log_unit) if log_unit > -math.inf else np.zeros_like(log_values)
        values *= self.weights * width[:, None] ** self.dim
        second = np.einsum("cn,cnd,cne->cde", values, u, u, optimize=True).reshape(len(u), -1)
        integral = np.concatenate([values.sum(axis=1)[:, None], np.einsum("cn,cnd->cd", values, u), second], axis=1)
        return _Cells(low, width, integral, integral, log_unit)

    def halved(self, parents: _Cells) -> _Cells:
        """Return the 2^dim halves of each cell, each with an equal share of the change that they brought."""
        number = 2**self.dim
        corners = np.array(list(product([0.0, 0.5], repeat=self.dim)))
        low = (parents.low[:, None, :] + parents.width[:, None, None] * corners).reshape(-1, self.dim)
        halves = self.cells(low, np.repeat(0.5 * parents.width, number))
        log_unit = max(halves.log_unit, parents.log_unit)
        halves, parents = halves.rescaled(log_unit), parents.rescaled(log_unit)
        change = halves.integral.reshape(len(parents.low), number, -1).sum(axis=1) - parents.integral
        return _Cells(low, halves.width, halves.integral, np.repeat(change / number, number, axis=0), log_unit)

    def _evaluate(self, u: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the log density at points of the unit cube, in batches of constant size."""
        x = self.low + u * (self.high - self.low)
        padded = np.concatenate([x, np.repeat(x[-1:], -len(x) % self.batch, axis=0)])
        batches = [self.log_density(padded[i : i + self.batch]) for i in range(0, len(padded), self.batch)]
        values = np.concatenate([np.asarray(b, float) for b in batches])[: len(x)]
        self.evaluations += len(x)
        wrong = np.isnan(values) | np.isposinf(values)
        if wrong.any():
            where = int(np.argmax(wrong))
            raise NumericsError(
                f"the log density is {values[where]} at {x[where].tolist()}. Return -inf where the density is zero."
            )
        return values


def integrate(
    log_density: LogDensity,
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
    *,
    rtol: float = 1e-3,
    mean_tolerance: float = 2e-3,
    sd_tolerance: float = 2e-3,
    maximum_evaluations: int = 4_000_000,
    batch: int = 16_384,
) -> QuadratureResult:
    """Integrate an unnormalised density over a box, refining until evidence and moments have converged.

    A ridge is found if its width (four standard deviations) is 1/50 of the box or more. If it does not converge within
    the evaluations allowed, this is reported, not raised. The log density takes physical points; -inf is allowed. It
    gets exactly `batch` points each time, so a jitted function is compiled once. The tolerances of the evidence and of
    standard deviations are relative, that of the means is in standard deviations. Corners of the box are physical.

    Raises:
        InvalidInput: more than three dimensions or a box without extent.
        NumericsError: a log density of NaN or +inf, or -inf at all points of the first grid.
    """
    _require_box(low, high)
    rule = _Rule(log_density, np.asarray(low, float), np.asarray(high, float), batch)
    tolerances = np.array([[rtol], [mean_tolerance], [sd_tolerance]])
    cells, levels = _first_grid(rule), 0
    while True:
        moments = _moments(cells, rule.dim)
        errors = _errors(cells, moments)
        sizes = np.max(errors / tolerances, axis=0)
        if sizes.sum() <= 1.0:
            break
        chosen = _to_refine(sizes, (maximum_evaluations - rule.evaluations) // (len(rule.nodes) * 2**rule.dim))
        if not chosen.any():
            break
        refined = cells.where(~chosen).joined(rule.halved(cells.where(chosen)))
        if not refined.integral[:, 0].sum() > 0:  # so narrow that the halves miss what their cell met
            break
        cells, levels = refined, levels + 1
    return _result(rule, cells, moments, errors, converged=bool(sizes.sum() <= 1.0), levels=levels)


def mixture(parts: Sequence[QuadratureResult]) -> QuadratureResult:
    """Return moments and marginals of the mixture of normalised densities over one box, with equal weights.

    The evidence is the mean of the parts' evidences. Evaluations are summed; levels and errors are the largest.
    """
    means = np.array([part.mean for part in parts])
    mean, apart = means.mean(axis=0), means - means.mean(axis=0)
    covariance = np.mean([part.covariance for part in parts], axis=0) + apart.T @ apart / len(parts)
    logs = np.array([part.log_evidence for part in parts])
    by_input = zip(*(part.marginals for part in parts), strict=True)
    marginals = [Histogram(same[0].edges, np.mean([one.mass for one in same], axis=0)) for same in by_input]
    return QuadratureResult(
        log_evidence=float(logs.max() + np.log(np.mean(np.exp(logs - logs.max())))),
        mean=mean,
        covariance=covariance,
        sd=np.sqrt(np.diag(covariance)),
        evaluations=sum(part.evaluations for part in parts),
        converged=all(part.converged for part in parts),
        levels=max(part.levels for part in parts),
        error_log_evidence=max(part.error_log_evidence for part in parts),
        error_mean=max(part.error_mean for part in parts),
        error_sd=max(part.error_sd for part in parts),
        marginals=tuple(marginals),
    )


def _first_grid(rule: _Rule) -> _Cells:
    number = _CELLS[rule.dim]
    low = np.array(list(product(np.arange(number) / number, repeat=rule.dim)))
    cells = rule.cells(low, np.full(len(low), 1.0 / number))
    if cells.log_unit == -math.inf:
        raise NumericsError(
            f"the density is zero at all {rule.evaluations} points of the first grid. Check the box and the density."
        )
    return cells


def _moments(cells: _Cells, dim: int) -> _Moments:
    total = cells.integral.sum(axis=0)
    mean, second = total[1 : dim + 1] / total[0], total[dim + 1 :].reshape(dim, dim) / total[0]
    return _Moments(float(total[0]), mean, second - np.outer(mean, mean))


def _errors(cells: _Cells, moments: _Moments) -> Float[np.ndarray, "3 cell"]:
    """Return the estimated error of each cell: share of the evidence, largest mean (in sd), largest relative sd. These
    are effects of the differences as absolute values, which cannot cancel.
    """
    dim, m = len(moments.mean), moments.mean
    change = cells.difference / moments.mass
    sd = np.maximum(moments.sd, np.finfo(float).eps)
    first = change[:, 1 : dim + 1] - m * change[:, :1]
    diagonal = change[:, dim + 1 :: dim + 1]
    second = diagonal - 2 * m * change[:, 1 : dim + 1] + m**2 * change[:, :1]
    spread = second / sd**2 - change[:, :1]
    return np.stack([np.abs(change[:, 0]), np.abs(first / sd).max(axis=1), 0.5 * np.abs(spread).max(axis=1)])


def _to_refine(sizes: Float[np.ndarray, " cell"], affordable: int) -> Bool[np.ndarray, " cell"]:
    """Choose the cells with the largest errors, all but a small remainder, as far as evaluations allow."""
    order = np.argsort(-sizes, kind="stable")
    remainder = sizes.sum() - np.cumsum(sizes[order])
    wanted = int(np.searchsorted(-remainder, -_LEFT_ALONE)) + 1
    chosen = np.zeros(len(sizes), bool)
    chosen[order[: max(0, min(wanted, affordable))]] = True
    return chosen


def _result(
    rule: _Rule, cells: _Cells, moments: _Moments, errors: Float[np.ndarray, "3 cell"], *, converged: bool, levels: int
) -> QuadratureResult:
    extent = rule.high - rule.low
    return QuadratureResult(
        log_evidence=math.log(moments.mass) + cells.log_unit + float(np.log(extent).sum()),
        mean=rule.low + extent * moments.mean,
        covariance=extent[:, None] * extent * moments.covariance,
        sd=extent * moments.sd,
        evaluations=rule.evaluations,
        converged=converged,
        levels=levels,
        error_log_evidence=float(errors[0].sum()),
        error_mean=float(errors[1].sum()),
        error_sd=float(errors[2].sum()),
        marginals=tuple(_marginal(rule, cells, axis) for axis in range(rule.dim)),
    )


def _marginal(rule: _Rule, cells: _Cells, axis: int) -> Histogram:
    """Return the masses of slabs half as thick as the first cells; an unrefined cell fills two of them."""
    number = 2 * _CELLS[rule.dim]
    halves = cells.low[:, axis, None] + cells.width[:, None] * np.array([0.25, 0.75])
    slab = np.minimum((halves * number).astype(int), number - 1)
    mass = np.bincount(slab.ravel(), weights=np.repeat(0.5 * cells.integral[:, 0], 2), minlength=number)
    edges = np.linspace(rule.low[axis], rule.high[axis], number + 1)
    return Histogram(edges, mass / mass.sum())


def _require_box(low: Float[np.ndarray, " dim"], high: Float[np.ndarray, " dim"]) -> None:
    words = "corners of 1 to 3 numbers each", "Use Sequential Monte Carlo in more dimensions."
    sizes, number = f"{len(low)} and {len(high)}", len(low)
    require(1 <= number <= 3 and len(high) == number, "dimension of the quadrature", sizes, *words)
    low, high = np.asarray(low), np.asarray(high)
    right = np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()
    expected = "finite corners, the lower one below the upper one in every direction"
    require(right, "box of the quadrature", f"{low.tolist()} to {high.tolist()}", expected, "Give the design box.")
