"""The noise variance σ_N² of a measure that fits stated errors of the observed points.

For d² = Σ r², with independent residuals of variance s², it is s². Any other d² weighs the errors in its own way. With
g and H the gradient and the Hessian of d² in some inputs at their estimate, the posterior's covariance is 2 σ_N² H⁻¹,
while errors of the observation scatter the estimate by H⁻¹ Cov(g) H⁻¹. The two agree in the mean over the inputs if

    σ_N² = tr(H⁻¹ Cov g) / (2 dim).

Cov g and the mean of H come from drawn observations, so the rule needs no property of the measure. It changes little
with the inputs as long as they move the interface over lengths well above the correlation length; a few smooth shapes
along the observed interface stand for them before anything is simulated.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import pdist

from strandline.discrepancy import (
    Discrepancy,
    KnowsPointErrors,
    MeasureKey,
    Snapshot,
    closest_points,
    extent,
    independent_terms,
    path_of,
    smoothed,
    squared_discrepancies,
    unit_of,
)
from strandline.foundations import InvalidInput, NumericsError, require
from strandline.interface import (
    Interface,
    Noise,
    Observation,
    PointErrors,
    arc_lengths,
    point_normals,
    spacings,
    steady_lengths,
)

DRAWS = 80
CURVATURES = 10  # drawn observations from which the mean Hessian comes: errors of the points flatten some measures
WIDER = 4.0
"""Steps of the second differences in those of the first: narrow ones would see where closest segments change."""
SHAPES = 4
SMOOTHED, PIECES = 4, 32
"""Points on either side over which the observed outline is smoothed, in correlation lengths; fewest such pieces."""
LARGE = 300
"""Triangles of an observed surface above which the closed form is not compared with the rule, which takes minutes."""
AGREED = 2.0  # ratio of closed form and general rule from which the rule is used
FEW_DRAWS = 20  # drawn observations for an assumed standard deviation: it is known to 8 %
MOST = 1500  # most points of a surface between which distances are taken
LARGEST_SD = 0.1
"""Largest sd of the points, as a share of the interface: at .1, currents of width .005 mm already hide less than at
.03 (a shift of .72 µm, not 1.2), and at .3 the rule takes minutes."""
_SMALL = 0.1
"""Standard deviation for which the noise variance of a measure is computed, in spacings of the observed points."""


def noise_variance(
    measure: Discrepancy, observed: Interface, errors: PointErrors, nodes: int, *, draws: int = DRAWS
) -> float:
    """Return σ_N² of a measure for the local errors of the observed points, in the unit of d².

    The closed form of the measure, if it has one and the general rule agrees to a factor of two, else the rule. Global
    errors are left out, since no variance can stand for them; `nodes` is the number of nodes of simulated interfaces.

    Raises:
        InvalidInput: No variance fits the measure, or the correlation is longer than half the interface.
    """
    errors.require_fits(observed)
    try:
        return _variance(MeasureKey.of(measure), Snapshot.of(observed), errors.local_part, nodes, draws)
    except NumericsError as error:
        raise InvalidInput(
            f"noise of {type(measure).__name__}",
            value=f"points with sd {1e3 * errors.sd:.3g} µm",
            expected="a measure that has a noise variance for such errors",
            remedy="Use the measure normal_offset, or state σ_N² yourself, e.g. noise: {variance: 0.0005}.",
        ) from error


@lru_cache(maxsize=64)
def _variance(key: MeasureKey, snapshot: Snapshot, errors: PointErrors, nodes: int, draws: int) -> float:
    measure, observed = key.measure, snapshot.interface
    closed = measure.noise_variance(errors, observed) if isinstance(measure, KnowsPointErrors) else None
    if closed is not None and observed.dim == 3 and len(observed.cells) > LARGE:
        return closed
    size = extent(observed)
    expected = f"at most a tenth of the interface, which is {1e3 * size:.4g} µm across"
    small, found = errors.sd <= LARGEST_SD * size, f"an sd of {1e3 * errors.sd:.4g} µm"
    require(small, "noise of the points", found, expected, "Correct the noise or its unit.")
    template = observed if observed.dim == 3 else _course(observed, errors).resampled(nodes)
    shapes = _shapes(template)

    def predict(x: Float[np.ndarray, "point shape"]) -> Float[np.ndarray, "point node xyz"]:
        return np.asarray(template.points + np.einsum("ks,snd->knd", x, shapes))

    none = np.zeros(len(shapes))
    steps = np.full(len(shapes), 0.5 * errors.sd)
    ruled = fitting_variance(measure, predict, template, none, steps, observed, errors, draws=draws)
    return closed if closed is not None and 1 / AGREED < closed / ruled < AGREED else ruled


def _course(observed: Interface, errors: PointErrors) -> Interface:
    """Return a polyline without much of its noise, as a simulated one would be."""
    spacing = float(np.median(spacings(observed)))
    half = min(round(SMOOTHED * max(errors.length, spacing) / spacing), len(observed.points) // PIECES)
    if half < 2:
        return observed
    return Interface.polyline(smoothed(path_of(observed), half, closed=observed.closed), closed=observed.closed)


def _shapes(interface: Interface) -> Float[np.ndarray, "shape node xyz"]:
    """Return smooth displacements along the normals, with amplitudes of 1."""
    if interface.dim == 2:
        t = arc_lengths(interface) / float(steady_lengths(interface).sum())
        waves = [np.cos(np.pi * k * t) for k in range(SHAPES)]
        if interface.closed:
            waves = [f(2 * np.pi * k * t) for k in range(1, 1 + SHAPES // 2) for f in (np.cos, np.sin)]
        window = 2 * float(np.median(interface.lengths))
    else:
        centred = interface.points - interface.points.mean(axis=0)
        u, v = (centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T / np.ptp(centred)).T
        waves, window = [np.ones(len(u)), u, v, u * v], 2 * float(np.sqrt(np.median(interface.areas)))
    normals = point_normals(interface, window)
    return np.array([wave[:, None] * normals for wave in waves])


def fitting_variance(
    measure: Discrepancy,
    predict: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, "point node xyz"]],
    template: Interface,
    at: Float[np.ndarray, " dim"],
    steps: Float[np.ndarray, " dim"],
    observed: Interface,
    errors: PointErrors,
    *,
    draws: int = DRAWS,
) -> float:
    """Return σ_N² by the general rule, in the unit of d².

    `predict` returns the points of simulated interfaces at inputs, `template` has their cells; `at` is the estimate,
    and `steps` of the inputs move the interface about as far as the noise. `observed` says how many points there are,
    and where.

    Raises:
        NumericsError: d² has no minimum at the estimate.
    """
    dim, random = len(at), np.random.default_rng(1)
    truth = _seen(Interface(predict(at[None])[0], template.cells), observed)
    near, wide = (predict(at + size * steps * differences(dim)) for size in (1.0, WIDER))
    gradients, curvatures = [], []
    for k in range(draws):
        drawn = errors.draw(truth, random)
        values = squared_discrepancies(measure, near[1 : 1 + 2 * dim], template, drawn)
        gradients.append(0.5 * (values[:dim] - values[dim:]))
        if k < CURVATURES:
            curvatures.append(second_differences(squared_discrepancies(measure, wide, template, drawn), dim) / WIDER**2)
    H = np.mean(curvatures, axis=0)
    if not np.linalg.eigvalsh(H).min() > 0:
        raise NumericsError("d² has no minimum at the estimate")
    covariance = np.atleast_2d(np.cov(np.array(gradients), rowvar=False))
    return float(np.trace(np.linalg.solve(H, covariance)) / (2 * dim))


def differences(dim: int) -> Float[np.ndarray, "move dim"]:
    """Return no move, a step of 1 ahead and behind in each input, and both together in each pair of inputs."""
    unit, pairs = np.eye(dim), _pairs(dim)
    moves = [np.zeros(dim), *unit, *-unit]
    moves += [a * unit[i] + b * unit[j] for i, j in pairs for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    return np.array(moves)


def second_differences(values: Float[np.ndarray, " move"], dim: int) -> Float[np.ndarray, "dim dim"]:
    """Return the Hessian of a function from its values at `differences`, per step."""
    here, ahead, behind = values[0], values[1 : 1 + dim], values[1 + dim : 1 + 2 * dim]
    H = np.diag(ahead + behind - 2 * here)
    for k, (i, j) in enumerate(_pairs(dim)):
        both, neither, one, other = values[1 + 2 * dim + 4 * k : 5 + 2 * dim + 4 * k]
        H[i, j] = H[j, i] = 0.25 * (both + neither - one - other)
    return H


def _pairs(dim: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(dim) for j in range(i)]


def _seen(simulated: Interface, observed: Interface) -> Interface:
    """Return the simulated interface with as many points as the observed one, over the part that was observed."""
    points = closest_points(observed.points, simulated).points
    try:
        return Interface(points, observed.cells)
    except InvalidInput:  # two points at the same place
        return simulated.resampled(len(observed.points)) if simulated.dim == 2 else observed


@dataclass(frozen=True)
class ResidualNoise:
    """Standard deviation s and integral correlation length ℓ of residuals along an interface, mm.

    The spectral density at low frequencies, 2 s²ℓ, decides how well slow shapes are known. Residuals of a right model
    have about the s²ℓ that was stated.
    """

    sd: float
    length: float

    @property
    def level(self) -> float:
        """The product s²ℓ, mm³: half the spectral density at low frequencies."""
        return self.sd**2 * self.length


@dataclass(frozen=True)
class StatedErrors:
    """Errors of the observed points; `assumed` if only the noise of the measure was stated, and independent errors of
    the points with the same noise variance stand for it.
    """

    errors: PointErrors
    assumed: bool

    def noise_along(self, seen: Interface) -> ResidualNoise:
        """Return the standard deviation and the correlation length that residuals of a right model have."""
        return ResidualNoise(self.errors.sd, self.errors.effective_length(seen))


def stated_errors(observation: Observation, measure: Discrepancy, nodes: int) -> StatedErrors:
    """Return the errors of the observed points that the noise of an observation stands for.

    If it states the noise of the measure only, these are independent errors of all coordinates, with the standard
    deviation for which the measure has that noise variance.

    Raises:
        InvalidInput: No errors of points have a noise variance of this measure.
    """
    if observation.errors is not None:
        return StatedErrors(observation.errors, assumed=False)
    variance = cast(Noise, observation.noise).scale
    return StatedErrors(PointErrors(_sd_of_points(variance, measure, observation.interface, nodes)), assumed=True)


def _sd_of_points(variance: float, measure: Discrepancy, seen: Interface, nodes: int) -> float:
    """Return the standard deviation of points, mm, whose noise variance is this one; it grows with its square."""
    if independent_terms(measure, seen) is not None and unit_of(measure, seen) == "mm²":
        return math.sqrt(variance)
    spacing = float(np.median(spacings(seen)))
    small = PointErrors(_SMALL * (spacing if seen.dim == 2 else math.sqrt(spacing)))
    found = measure.noise_variance(small, seen) if isinstance(measure, KnowsPointErrors) else None
    if found is None:
        found = noise_variance(measure, seen, small, nodes, draws=FEW_DRAWS)
    return small.sd * math.sqrt(variance / found)


def noise_of_residuals(residuals: Float[np.ndarray, " point"], polyline: Interface) -> ResidualNoise:
    """Return the standard deviation about zero and the integral correlation length of residuals at the points, mm.

    The autocorrelation of the residuals at equally spaced places is summed up to its first zero: ℓ = h (½ + Σ ρ), at
    least half the spacing h, which is the length of independent residuals.
    """
    places, order = arc_lengths(polyline), np.argsort(arc_lengths(polyline), kind="stable")
    number, whole = len(places), float(steady_lengths(polyline).sum())
    spacing = whole / (number if polyline.closed else number - 1)
    period = whole if polyline.closed else None
    values = np.interp(spacing * np.arange(number), places[order], residuals[order], period=period)
    size = number if polyline.closed else 2 * number  # zeros keep the ends of an open one apart
    products = np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[: size // 2]
    if not products[0] > 0:
        return ResidualNoise(0.0, 0.5 * spacing)
    return _noise(residuals, products, float(products[0]), spacing)


def noise_on_surface(residuals: Float[np.ndarray, " point"], surface: Interface) -> ResidualNoise:
    """Return the standard deviation about zero and the integral correlation length of residuals on a surface, mm.

    The covariance of two residuals is averaged over pairs at about the same distance in space, in steps of the spacing
    h, and summed up to its first zero: ℓ = h (½ + Σ ρ). Of many points, every second or third is taken.
    """
    step = -(-len(residuals) // MOST)
    values, points = residuals[::step], surface.points[::step]
    square, h = float(np.mean(values**2)), math.sqrt(float(surface.areas.sum()) / len(values))
    if not square > 0:
        return ResidualNoise(0.0, 0.5 * h)
    which = np.rint(pdist(points) / h).astype(int)
    first, second = np.triu_indices(len(values), 1)
    number = np.maximum(np.bincount(which), 1)
    covariance = np.bincount(which, values[first] * values[second]) / number
    return _noise(residuals, covariance, square, h)


def _noise(
    residuals: Float[np.ndarray, " point"], covariance: Float[np.ndarray, " lag"], square: float, spacing: float
) -> ResidualNoise:
    """Return sd and ℓ = h (½ + Σ ρ), ρ being the covariance at multiples of h over `square` up to its first zero."""
    below = np.flatnonzero(covariance[1:] <= 0)
    last = 1 + int(below[0]) if below.size else len(covariance)
    length = spacing * (0.5 + float(covariance[1:last].sum() / square))
    return ResidualNoise(math.sqrt(float(np.mean(residuals**2))), length)
