"""Pixels instead of an edge: how often 90 % intervals of an arch's shape contain the truth, and how wide they are.

The shape's log-likelihood is the sum of what each normal's pixels say (`tables`) at the places where the outline
of that shape crosses the normals, thinned by the number of samples that count as one. Beside it stands the product's
way: `find_edge`, its own errors, and `normal_offset`. Both see the same cameras and OCT B-scans of arches whose height
and shear are drawn; paths are 12 clicks, off by 2.5 px.

    python -m verification.validation.pixels [--pictures 100] [camera|OCT]
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.optimize import least_squares
from scipy.special import ndtr
from verification.validation.rendered import Camera, Scan, clicks, shaped
from verification.validation.tables import arguments, show, table

from strandline.discrepancy import NormalOffset
from strandline.discrepancy.normal_offset import signed_distances
from strandline.errors import InvalidInput
from strandline.imaging.edge import Edge, find_edge
from strandline.imaging.noise_covariance import autocovariance, sum_to_first_zero
from strandline.imaging.template import learnt_template, levelled
from strandline.interface import Interface, PointErrors

CANDIDATES = np.arange(-80, 81) * 0.05
"""Places of the edge on a normal, px from the edge's smoothed course."""
PRIOR = np.array([0.05, 0.1])
"""Standard deviations of the relative height and of the shear, as `arch` draws them."""
KINDS = {"camera": ("erf", (136, 280), Camera()), "OCT": ("path", (170, 233), Scan())}
BESIDE = 1.4
"""Samples beside an edge that count as one, over those away from it: the factor in the product's κ."""
REACH, PLACES, OFFSETS = 4.5, 25, np.linspace(-3.0, 3.0, 13)
"""Half the width of the grid in posterior sds, its nodes along each input, and nodes of the offset in its sds."""
HEADING = (
    "way | pictures {d} | height covered, % {.0f} | shear covered, % {.0f} | width of height, % {.2f} "
    "| width of shear, % {.2f} | needed for height, % {.2f} | needed for shear, % {.2f}"
)
"""Widths are those of 90 % intervals, in % of the height and in 0.01 of shear; needed is that of the true errors."""
Shape = Float[np.ndarray, "2"]
LogDensity = Callable[[Float[np.ndarray, "shape 2"]], Float[np.ndarray, " shape"]]
ManyShapes = Callable[[Float[np.ndarray, "shape 2"]], Float[np.ndarray, "shape point"]]


@dataclass(frozen=True, eq=False)
class Tables:
    """Log-likelihoods of all samples as if independent, and estimated and known shares of samples that count."""

    values: Float[np.ndarray, "normal candidate"]
    estimated: float
    known: float


def tables(edge: Edge, places: Float[np.ndarray, " normal"], kind: str) -> Tables:
    """Return log p(pixels | place) for each kept normal, with all levels estimated around an edge at these places.

    Cameras: blurred steps in Gaussian noise, with levels that are smooth along the edge. OCT: gamma with the picture's
    own mean profile.
    """
    strip, kept = edge.strip, edge.kept
    offsets = np.interp(np.arange(len(kept)), np.flatnonzero(kept), places)
    at = strip.places - CANDIDATES[:, None]
    if kind == "camera":
        phi = ndtr((strip.places - offsets[:, None]) / edge.errors.blur)
        one, up, two, z, zp = (
            gaussian_filter1d((strip.usable * part).sum(axis=1), 5.0)
            for part in (np.ones_like(phi), phi, phi**2, strip.samples, strip.samples * phi)
        )
        jump = (one * zp - up * z) / (one * two - up**2)
        low = (z - jump * up) / one
        residuals = np.where(strip.usable, strip.samples - low[:, None] - jump[:, None] * phi, 0.0)
        f, w = ndtr(at / edge.errors.blur).T, strip.usable
        above = np.where(w, strip.samples - low[:, None], 0.0)
        values = (above @ f) * jump[:, None] - 0.5 * jump[:, None] ** 2 * (w @ f**2)
        area, white = 1.0, strip.kept
    else:
        even = strip
        for _ in range(3):
            template, shift = learnt_template(even, offsets)
            expected = template.at(strip.places - (offsets + shift)[:, None])
            even = levelled(even, expected, relative=True)
        residuals = np.where(strip.usable, even.samples / expected - 1, 0.0)
        m = template.at(at)
        values = -(even.samples @ (1 / m).T + strip.usable @ np.log(m).T)
        area, white = 2 * math.pi * Scan().speckle ** 2, 1.0
    residuals, size = residuals[kept], (7.5, 7.5 / strip.step)
    usable = strip.usable[kept]
    variance = float((residuals**2).sum() / usable.sum())
    slow = gaussian_filter(residuals, size) / np.maximum(gaussian_filter(usable.astype(float), size), 1e-9)
    lags = autocovariance(np.where(usable, residuals - slow, 0.0), usable)
    together = math.prod(2 * sum_to_first_zero(one / one[0]) for one in (lags[:9, 0], lags[0, : round(8 / strip.step)]))
    return Tables(values[kept] / variance, 1 / together, strip.step * white / area)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Mean, its distance from the truth, standard deviation, and share below the truth, of each input."""

    mean: Shape
    off: Shape
    sd: Shape
    rank: Shape


def integrated(log_density: LogDensity, truth: Shape, mean: Shape, sd: Shape) -> Posterior:
    """Return the posterior on a grid that adapts, from a first guess of its mean and standard deviation."""
    for _ in range(12):
        axes = [np.linspace(m - REACH * s, m + REACH * s, PLACES) for m, s in zip(mean, sd, strict=True)]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        log_p = log_density(x) - 0.5 * ((x / PRIOR) ** 2).sum(axis=1)
        p = np.exp(log_p - log_p.max()).reshape(PLACES, PLACES)
        marginals = [m / m.sum() for m in (p.sum(axis=1), p.sum(axis=0))]
        centre = np.array([m @ a for m, a in zip(marginals, axes, strict=True)])
        found = np.sqrt([m @ (a - c) ** 2 for m, a, c in zip(marginals, axes, centre, strict=True)])
        if (np.abs(centre - mean) < 0.5 * sd).all() and (np.abs(np.log(np.maximum(found, 1e-9) / sd)) < 0.2).all():
            break
        mean, sd = centre, np.clip(found, 0.25 * sd, 2.0 * sd)
    rank = [np.interp(t, a, np.cumsum(m) - 0.5 * m) for t, a, m in zip(truth, axes, marginals, strict=True)]
    return Posterior(centre, centre - truth, found, np.array(rank))


def outline(shape: tuple[int, int], x: Shape) -> Interface:
    return Interface.polyline(shaped(shape, float(x[1]), float(x[0]))[0] * (1, -1))


def through_nine(function: Callable[[Shape], Float[np.ndarray, " point"]], middle: Shape, reach: Shape) -> ManyShapes:
    """Return the quadratic in the shape through values at nine shapes, at most `reach` from the middle."""
    nodes = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)

    def terms(z: Float[np.ndarray, "shape 2"]) -> Float[np.ndarray, "shape 6"]:
        a, b = z.T
        return np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)

    values = np.stack([function(middle + reach * node) for node in nodes])
    weights = np.linalg.lstsq(terms(nodes), values, rcond=None)[0]
    return lambda x: np.asarray(terms((x - middle) / reach) @ weights)


def by_edge(edge: Edge, shape: tuple[int, int], truth: Shape) -> Posterior:
    """Return the posterior of shapes through the edge and its own errors: `normal_offset`, quadratic in the shape."""
    e, seen = edge.errors, Interface.polyline(edge.points * (1, -1))
    model = NormalOffset().whitened(PointErrors(e.sd, e.length, offset=e.offset)).model(seen)
    mean = least_squares(lambda x: signed_distances(seen.points, outline(shape, x)), np.zeros(2), x_scale=PRIOR).x
    sd = 0.05 * PRIOR
    for _ in range(2):
        residuals = through_nine(lambda x: signed_distances(seen.points, outline(shape, x)), mean, 5 * sd)

        def log_density(x: Float[np.ndarray, "shape 2"], r: ManyShapes = residuals) -> Float[np.ndarray, " shape"]:
            return -0.5 * model.square(r(x))

        found = integrated(log_density, truth, mean, sd)
        mean, sd = found.mean, found.sd
    return found


def crossings(edge: Edge, shape: tuple[int, int], middle: Shape, sd: Shape) -> ManyShapes:
    """Return the places where outlines of given shapes cross the kept normals."""
    course = edge.strip.course
    start, normals = (part[edge.kept] * (1, -1) for part in (course.points, course.normals))

    def places(x: Shape) -> Float[np.ndarray, " normal"]:
        line, t = outline(shape, x), np.zeros(len(start))
        for _ in range(5):
            t -= signed_distances(start + t[:, None] * normals, line)
        return t

    return through_nine(places, middle, 5 * sd)


def by_pixels(edge: Edge, table: Tables, places: ManyShapes, share: float, offset: float) -> LogDensity:
    """Return the log-likelihood of shapes through the pixels, of which a share counts, with this sd of an offset."""
    rows, step = np.arange(len(table.values)), CANDIDATES[1] - CANDIDATES[0]

    def log_density(x: Float[np.ndarray, "shape 2"]) -> Float[np.ndarray, " shape"]:
        t, out = places(x), []
        for b in OFFSETS if offset else np.zeros(1):
            index = np.clip((t + b * offset - CANDIDATES[0]) / step, 0, len(CANDIDATES) - 1.001)
            first = index.astype(int)
            low, high = table.values[rows, first], table.values[rows, first + 1]
            out.append(share * (low + (index - first) * (high - low)).sum(axis=1) - 0.5 * b**2)
        return np.asarray(np.logaddexp.reduce(out, axis=0))

    return log_density


def compared(kind: str, seed: int) -> dict[str, Posterior]:
    method, shape, render = KINDS[kind]
    random = np.random.default_rng([19, seed])
    truth = PRIOR * random.standard_normal(2)
    line, region = shaped(shape, float(truth[1]), float(truth[0]))
    picture, path = render(region, shape, random), clicks(line, random)
    edge = find_edge(picture, np.clip(path, 0.0, np.array(shape[::-1]) - 1.0), method=method)
    first = by_edge(edge, shape, truth)
    places, offset = crossings(edge, shape, first.mean, first.sd), edge.errors.offset
    table = tables(edge, edge.offsets[edge.kept], kind)
    for _ in range(2):  # levels around the fitted outline, which is smoother than the edge
        fit = integrated(by_pixels(edge, table, places, table.estimated, offset), truth, first.mean, first.sd)
        table = tables(edge, places(fit.mean[None])[0], kind)
    ways = {
        "pixels, thinned by estimate": (table.estimated, offset),
        "pixels, thinned by estimate and 1.4": (table.estimated / BESIDE, offset),
        "pixels, thinned by known area": (table.known, offset),
        "pixels, thinned by estimate, no offset": (table.estimated, 0.0),
        "pixels, unthinned": (1.0, offset),
    }
    return {"edge, its own errors": first} | {
        name: integrated(by_pixels(edge, table, places, *way), truth, fit.mean, fit.sd) for name, way in ways.items()
    }


def rows(found: list[dict[str, Posterior]]) -> Iterator[tuple]:
    for way in found[0]:
        rank, sd, off = (np.array([getattr(one[way], name) for one in found]) for name in ("rank", "sd", "off"))
        covered, wide = 100 * (np.abs(rank - 0.5) < 0.45).mean(axis=0), 100 * 3.29 * sd.mean(axis=0)
        error = 100 * 3.29 * np.sqrt((off**2).mean(axis=0))
        yield way, len(found), *covered.tolist(), *wide.tolist(), *error.tolist()


def main() -> None:
    options = arguments(__doc__, words=KINDS, pictures=100)
    for kind in options.words or KINDS:
        found = []
        for seed in range(options.pictures):
            try:
                found.append(compared(kind, seed))
            except InvalidInput as refusal:
                print(f"  {kind}, picture {seed}: {str(refusal).partition('.')[0]}", flush=True)
        show([table(kind, kind, HEADING, rows(found))])


if __name__ == "__main__":
    main()
