"""The experiment behind some observations, to be repeated at other inputs, and where these come from.

The points, the noise and the analysis stay the same; the true inputs come from the prior of a study, or its posterior.
Ranks of the truth are uniform if it comes from the distribution that the analysis takes as its prior (Talts et al.
2018). So with truths from the posterior, the analysis begins with this posterior, and a repeated observation adds to
the real one (Säilynoja et al. 2025).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.special import log_softmax, logsumexp

from strandline.calibration.importance_sampler import SCRAMBLE, effective_size
from strandline.design import Knowledge, sobol
from strandline.discrepancy import Discrepancy, JointErrors, NormalOffset, TrackedPoints, closest_points, shared_errors
from strandline.foundations import InvalidInput, require
from strandline.interface import Interface, Noise, Observation, PointErrors, UnknownErrors, steady_normals
from strandline.likelihood import FieldLikelihood, compared, noise_length, stated_errors, with_variance
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, Weighted, systematic_indices
from strandline.surrogate import FieldSurrogate

POINTS = 4096  # draws of the distribution whose predicted interfaces are kept for all replicates
FEWEST = 100.0  # smallest effective number of draws of a posterior that the surrogate of the interface agrees with
TOLERATED = 0.5  # error of the predicted interface that is tolerated, as a share of the shift that the noise hides
TOLERATED_SHARE = 0.05  # share of the draws at which a larger error is tolerated
DRAWS = 512


@dataclass(frozen=True, eq=False)
class Source:
    """A distribution of the inputs: that of the truths, and what each analysis takes as its prior.

    A region where runs fail is part of it only as far as they succeed there. `points` are weighted draws that stand for
    `number` equally weighted ones, with the coefficients of the modes predicted there, mm. `log_norm` is the logarithm
    of the integral of the density before it is normalised.
    """

    knowledge: Knowledge
    space: ParameterSpace
    points: Float[np.ndarray, "point dim"]
    log_weights: Float[np.ndarray, " point"]
    coefficients: Float[np.ndarray, "point mode"]
    number: int
    log_norm: float
    from_posterior: bool

    @cached_property
    def log_densities(self) -> Float[np.ndarray, " point"]:
        return self.log_density(self.points, self.coefficients)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        return Weighted(self.points, np.exp(self.log_weights)).covariance

    def log_density(
        self, x: Float[np.ndarray, "some dim"], coefficients: Float[np.ndarray, "some mode"]
    ) -> Float[np.ndarray, " some"]:
        """Return the normalised log density at points inside the prior, given the coefficients predicted there."""
        known = self.knowledge.log_feasibility(x) + np.asarray(self.space.log_prior(x)) - self.log_norm
        return np.asarray(known + self.knowledge.likelihood.at(coefficients) if self.from_posterior else known)

    def draw(self, random: np.random.Generator) -> Float[np.ndarray, " dim"]:
        """Return one draw: of the prior a new one, of a posterior one of `points`."""
        if self.from_posterior:
            weights = np.exp(self.log_weights)
            return np.asarray(self.points[random.choice(len(weights), p=weights / weights.sum())])
        while True:
            x = self.space.prior_quantiles(random.random((1, self.space.dim)))
            if random.random() < np.exp(self.knowledge.log_feasibility(x)[0]):
                return np.asarray(x[0])


def prior_source(knowledge: Knowledge, space: ParameterSpace, *, number: int = POINTS) -> Source:
    """Return the prior, as far as runs succeed, represented by a number of draws."""
    points = space.prior_quantiles(sobol(number, space.dim, scramble=SCRAMBLE))
    feasible = knowledge.log_feasibility(points)
    return Source(
        knowledge=knowledge,
        space=space,
        points=points,
        log_weights=np.asarray(log_softmax(feasible)),
        coefficients=knowledge.surrogate.mean(points),
        number=len(points),
        log_norm=float(logsumexp(feasible)) - math.log(len(points)),
        from_posterior=False,
    )


def posterior_source(knowledge: Knowledge, posterior: Posterior) -> Source:
    """Return the posterior, with weights by the log-likelihood of the predicted interface, as equally weighted draws.

    Raises:
        InvalidInput: Hardly any draws have weight, since the posterior was computed from another likelihood.
    """
    known = np.isfinite(posterior.log_weights) & np.isfinite(posterior.log_likelihood)
    draws = posterior.draws[known]
    log_weights = posterior.log_weights[known] + knowledge.plug_in(draws) - posterior.log_likelihood[known]
    effective = effective_size(log_weights)
    what, found = "the stored posterior and the surrogate of the interface disagree", f"{effective:.0f} effective draws"
    remedy = "Make more runs where the posterior lies, or draw the truths from the prior."
    require(not effective < FEWEST, what, f"{found} of {posterior.number}", f"at least {FEWEST:.0f}", remedy)
    weights = np.exp(log_softmax(log_weights))
    drawn = systematic_indices(weights, POINTS, np.random.default_rng(0))
    chosen, counts = np.unique(drawn, return_counts=True)
    points = draws[chosen]
    return Source(
        knowledge=knowledge,
        space=posterior.space,
        points=points,
        log_weights=np.log(counts / POINTS),
        coefficients=knowledge.surrogate.mean(points),
        number=POINTS,
        log_norm=posterior.log_evidence + float(logsumexp(log_weights)),
        from_posterior=True,
    )


@dataclass(frozen=True)
class FieldQuality:
    """Errors of the predicted interface, root mean square along it, at draws of a distribution; mm.

    `hidden` is the shift of the observed interface that the noise hides, the smallest of all conditions; `median` and
    `q95` are quantiles of the errors that the surrogate expects, `left_out` is the median error at runs predicted from
    the others, and `beyond` the share of the draws with an error above `TOLERATED` times `hidden`.
    """

    hidden: float
    median: float
    q95: float
    left_out: float
    beyond: float

    @property
    def good(self) -> bool:
        return self.beyond <= TOLERATED_SHARE


def field_quality(source: Source) -> FieldQuality:
    """Return how good the surrogate is at draws of a distribution."""
    return quality_at(source.knowledge.likelihood, source.points, np.exp(source.log_weights))


def quality_at(
    likelihood: FieldLikelihood, points: Float[np.ndarray, "point dim"], weights: Float[np.ndarray, " point"]
) -> FieldQuality:
    """Return how good the surrogate is at weighted points, for the noise of a likelihood.

    The errors that it expects count more if those at left-out runs are larger than expected.
    """
    surrogate = likelihood.surrogate
    hidden = min(noise_length(seen, likelihood.discrepancy) for seen in likelihood.known_observations)
    chosen = np.random.default_rng(0).choice(len(weights), DRAWS, p=weights / weights.sum())
    errors = max(1.0, _surprise(surrogate)) * surrogate.predicted_error(points[chosen])
    median, q95 = np.quantile(errors, [0.5, 0.95]).tolist()
    return FieldQuality(
        hidden=hidden,
        median=median,
        q95=q95,
        left_out=float(np.median(surrogate.left_out_error())),
        beyond=float((errors > TOLERATED * hidden).mean()),
    )


def _surprise(surrogate: FieldSurrogate) -> float:
    """Return the root mean square error at left-out runs over the expected one."""
    left_out = [process.left_out() for process in surrogate.processes]
    found = sum(float(np.sum(one.errors**2)) for one in left_out)
    expected = sum(float(np.sum(one.variances)) for one in left_out)
    return float(np.sqrt(found / expected)) if expected > 0 else 1.0


Matrix = Float[np.ndarray, "dim dim"]
Point = Float[np.ndarray, " dim"]
WHOLE = 0.8  # share of a polyline from which an observation of as many points consists of its nodes
STEP = 1e-3  # step of finite differences of the predicted interface, as a share of the box


@dataclass(frozen=True, eq=False)
class Footprint:
    """The observed points as weighted means of the nodes of a simulated interface; others are observed there too.

    A polyline is followed by its arc length, so that noise along it moves no point past its neighbour. The points of a
    surface keep their place within its triangles. `corners` are the numbers of the nodes around each observed point.
    """

    corners: Int[np.ndarray, "point corner"]
    weights: Float[np.ndarray, "point corner"]
    cells: Int[np.ndarray, "cell end"]

    def on(self, nodes: Float[np.ndarray, "node xyz"]) -> Float[np.ndarray, "point xyz"]:
        """Return the observed points on a simulated interface with these nodes; it is linear in them."""
        return np.asarray(np.einsum("pc,pcx->px", self.weights, nodes[self.corners]))


def footprint(observed: Interface, simulated: Interface) -> Footprint:
    """Return where the points of `observed` lie on `simulated`, an interface near it that runs the same way."""
    same = observed.points.shape == simulated.points.shape and np.array_equal(observed.cells, simulated.cells)
    begin, end = _part(observed, simulated) if same and observed.dim == 2 else (0.0, math.inf)
    if same and end - begin >= WHOLE * float(simulated.sizes.sum()):
        numbers = np.arange(len(observed.points))[:, None]
        return Footprint(numbers, np.ones(numbers.shape), observed.cells)
    return _on_surface(observed, simulated) if observed.dim == 3 else _on_polyline(observed, simulated)


def _on_polyline(observed: Interface, simulated: Interface) -> Footprint:
    begin, end = _part(observed, simulated)
    along = _arc_lengths(observed)
    chain = np.append(observed.cells[:, 0], observed.cells[-1, 1])
    places = np.zeros(len(observed.points))
    places[chain[::-1]] = begin + (end - begin) * along[::-1] / along[-1]
    bounds, lengths = _arc_lengths(simulated), simulated.lengths
    places = places % bounds[-1] if simulated.closed else np.clip(places, 0.0, bounds[-1])
    cells = np.clip(np.searchsorted(bounds, places, side="right") - 1, 0, len(lengths) - 1)
    share = np.clip((places - bounds[cells]) / lengths[cells], 0.0, 1.0)
    return Footprint(simulated.cells[cells], np.stack([1 - share, share], axis=1), observed.cells)


def _part(observed: Interface, simulated: Interface) -> tuple[float, float]:
    """Return the arc lengths on `simulated` between which `observed` lies, mm.

    The second exceeds the whole length if the part goes past the point where a closed polyline begins.
    """
    whole = float(simulated.lengths.sum())
    ends = observed.points[[observed.cells[0, 0], observed.cells[-1, 1]]]
    found = closest_points(ends, simulated)
    on_cell = np.linalg.norm(found.points - simulated.starts[found.cells], axis=1)
    begin, end = (_arc_lengths(simulated)[found.cells] + on_cell).tolist()
    if observed.closed:
        return (begin, begin + whole) if simulated.closed else (0.0, whole)
    if simulated.closed:
        return begin, end if end > begin else end + whole
    return (begin, end) if end > begin else (0.0, whole)


def _arc_lengths(polyline: Interface) -> Float[np.ndarray, " corner"]:
    return np.concatenate([[0.0], np.cumsum(polyline.lengths)])


def _on_surface(observed: Interface, simulated: Interface) -> Footprint:
    """Return the places by the areas opposite to the corners of the closest triangles."""
    found = closest_points(observed.points, simulated)
    corners = simulated.cells[found.cells]
    a, b, c = (simulated.points[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.einsum("px,px->p", normal, normal)
    first = np.einsum("px,px->p", np.cross(b - found.points, c - found.points), normal) / size
    second = np.einsum("px,px->p", np.cross(c - found.points, a - found.points), normal) / size
    return Footprint(corners, np.stack([first, second, 1 - first - second], axis=1), observed.cells)


@dataclass(frozen=True)
class CoordinateErrors:
    """Independent errors of all coordinates of tracked points, with this standard deviation, mm."""

    sd: float

    @property
    def facts(self) -> dict[str, float]:
        return {"coordinate_sd": self.sd}

    def draw(self, true: Interface, random: np.random.Generator) -> Interface:
        return Interface(true.points + self.sd * random.standard_normal(true.points.shape), true.cells)


Errors = PointErrors | CoordinateErrors  # errors of the points of an observed interface


@dataclass(frozen=True, eq=False)
class Experiment:
    """Places of the observed points on simulated interfaces, their errors, and noise and measure of the analysis."""

    surrogate: FieldSurrogate
    footprints: Mapping[str, Footprint]
    errors: Mapping[str, Errors]
    noises: Mapping[str, Noise | PointErrors | UnknownErrors]
    measure: Discrepancy

    def truths(self, x: Point) -> dict[str, Interface]:
        """Return the predicted interfaces at inputs x, at the observed places."""
        nodes = self.surrogate.points(self.surrogate.mean(x[None]))
        return {name: Interface(one.on(nodes[name][0]), one.cells) for name, one in self.footprints.items()}

    def observed(self, truths: Mapping[str, Interface], random: np.random.Generator) -> tuple[Observation, ...]:
        """Return the true interfaces as they might be observed, with the noise of the analysis."""
        joint = self._shared(truths)
        if joint is None:
            drawn = {name: self.errors[name].draw(true, random) for name, true in truths.items()}
        else:
            drawn = _drawn_together(joint, random)
        return tuple(Observation(seen, self.noises[name], name) for name, seen in drawn.items())

    def likelihood(self, observations: tuple[Observation, ...]) -> FieldLikelihood:
        return FieldLikelihood(self.surrogate, observations, self.measure)

    def information(self, x: Point, truths: Mapping[str, Interface]) -> Matrix:
        """Return the Fisher information of the inputs at x by these errors, for small displacements."""
        slopes, joint = self._slopes(x), self._shared(truths)
        if joint is not None:
            rows = [_along_normals(slopes[name], true) for name, true in truths.items()]
            return joint.model.information(np.concatenate(rows))
        return np.asarray(sum(_of_one(self.errors[name], slopes[name], true) for name, true in truths.items()))

    def _slopes(self, x: Point) -> dict[str, Float[np.ndarray, "_ xyz dim"]]:
        """Return the derivatives of the observed points, mm per unit of the input, by condition."""
        low, high = self.surrogate.warping.low, self.surrogate.warping.high
        steps = np.diag(STEP * (high - low))
        ahead, behind = np.clip(x + steps, low, high), np.clip(x - steps, low, high)
        spans = np.diag(ahead - behind)
        nodes = self.surrogate.points(self.surrogate.mean(np.concatenate([ahead, behind])))
        found = {}
        for name, one in self.footprints.items():
            changes = nodes[name][: len(x)] - nodes[name][len(x) :]
            found[name] = np.stack([one.on(c) / s for c, s in zip(changes, spans, strict=True)], axis=2)
        return found

    def _shared(self, truths: Mapping[str, Interface]) -> JointErrors | None:
        """Return the errors if all conditions share shift, rotation and scale; None if there is nothing to share."""
        known = ((name, one) for name, one in self.errors.items() if isinstance(one, PointErrors))
        seen = [Observation(truths[name], one, name) for name, one in known]
        return shared_errors(seen, NormalOffset()) if len(seen) == len(self.errors) else None


def experiment_behind(likelihood: FieldLikelihood, near: Float[np.ndarray, " mode"]) -> Experiment:
    """Return the experiment behind the observations of a likelihood, with predicted interfaces `near` them, mm.

    Observations are drawn with the errors of the points if these are stated, else with independent errors for which the
    stated σ_N² is right: of all coordinates of tracked points, of other points along the normals.

    Raises:
        InvalidInput: No independent errors have this σ_N².
    """
    surrogate, measure = likelihood.surrogate, likelihood.discrepancy
    nodes, footprints = surrogate.points(near[None]), {}
    errors: dict[str, Errors] = {}
    noises: dict[str, Noise | PointErrors | UnknownErrors] = {}
    for seen in likelihood.observations:
        template = surrogate.layouts[seen.condition].template
        footprints[seen.condition] = footprint(seen.interface, Interface(nodes[seen.condition][0], template.cells))
        known = seen if likelihood.inferred is None else likelihood.inferred.at_median([seen])[0]
        errors[seen.condition] = errors_behind(known, measure, len(template.points))
        noises[seen.condition] = with_variance(seen, measure, len(template.points))
    return Experiment(surrogate, footprints, errors, noises, measure)


def errors_behind(seen: Observation, measure: Discrepancy, nodes: int) -> Errors:
    """Return errors of the observed points for which the noise is right; of unknown errors, the first guess.

    Raises:
        InvalidInput: No independent errors have the stated σ_N².
    """
    one = compared(seen, measure, nodes)
    if isinstance(measure, TrackedPoints) and seen.errors is None:
        return CoordinateErrors(math.sqrt(one.noise.scale))
    try:
        return stated_errors(seen, measure, nodes).errors
    except InvalidInput as error:
        value = f"σ_N² = {one.noise.scale:.3g}, for which no independent errors of the points were found"
        expected = "a σ_N² that follows from errors of the points"
        remedy = "State these errors, e.g. noise: {sd: 3, unit: um}, or use the measure normal_offset."
        raise InvalidInput("noise of repeated observations", value=value, expected=expected, remedy=remedy) from error


def _drawn_together(joint: JointErrors, random: np.random.Generator) -> dict[str, Interface]:
    """Return observations with the same drawn shift, rotation and scale about their common middle."""
    middle = np.concatenate([true.interface.points for true in joint.observations]).mean(axis=0)
    by, out = random.standard_normal(replace(joint.errors[0], offset=0.0).global_errors(len(middle))), {}
    for true, errors in zip(joint.observations, joint.errors, strict=True):
        own = replace(errors, shift=0.0, rotation=0.0, scale=0.0).draw(true.interface, random)
        out[true.condition] = replace(errors, offset=0.0).moved(own, by, middle=middle)
    return out


def _of_one(errors: Errors, slopes: Float[np.ndarray, "point xyz dim"], true: Interface) -> Matrix:
    if isinstance(errors, CoordinateErrors):
        return np.asarray(np.einsum("pxi,pxj->ij", slopes, slopes) / errors.sd**2)
    return errors.model(true).information(_along_normals(slopes, true))


def _along_normals(slopes: Float[np.ndarray, "point xyz dim"], true: Interface) -> Float[np.ndarray, "point dim"]:
    return np.asarray(np.einsum("px,pxd->pd", steady_normals(true), slopes))
