"""Distances between large interfaces: against NumPy on the same task, and how long the largest take.

The surfaces are bent sheets of a square millimetre, and the points lie around them. A wide kernel couples all facets, a
narrow one only facets a few edges apart. NumPy does each task twice: over all pairs at once, the simplest way to write
it, and in blocks that fit the cache. Times depend on the machine and its load; ours for large tasks also depend on
``OMP_NUM_THREADS``.
"""

import statistics
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import jax
import numpy as np
from verification.benchmarks.figures import Figure, compared, peak_memory, timed

from strandline import Currents, Interface, PointErrors
from strandline.discrepancy import WhitenedOffset, squared_discrepancies
from strandline.discrepancy.nearest import squared_distances

WIDE, NARROW = 0.3, 0.01
NODES, MANY_NODES, TARGET_NODES = 72, 225, 201
"""Nodes along an edge of a sheet: 10 082, 100 352 and 80 000 triangles."""
POINTS_2D, SEGMENTS, POINTS_3D = 6600, 2000, 10_000
BLOCK = 1 << 16
REPEATS, ALL_AT_ONCE_REPEATS = 5, 3
INTERFACES, NODES_2D = 1000, 67
"""Simulated polylines of 66 segments against one observed, as in a campaign."""
SEEN, PARTICLES = 1600, 10_000
"""Points of a long contour, and interfaces predicted at the particles of a sampler."""


def figures() -> Iterator[Figure]:
    """Yield the figures of distances between large interfaces."""
    jax.config.update("jax_enable_x64", True)
    yield inner_product()
    yield from map(currents, (WIDE, NARROW))
    yield closest_on_polyline()
    yield inner_product(at_once=True)
    yield closest_on_polyline(at_once=True)
    yield from (many_polylines(width, batched=batched) for width in (0.005, 0.05) for batched in (False, True))
    yield long_contour()
    yield from map(closest_on_surface, (0.01, 0.3))
    yield from large(NARROW)
    yield from large(WIDE, repeats=1)


def inner_product(*, at_once: bool = False) -> Figure:
    """Compare one inner product of two surfaces, every facet with every other."""
    one, other = sheet(NODES, bend=0.20), sheet(NODES, bend=0.21)
    measure = Currents(WIDE, quadrature="centre")
    measure.inner(other, other)

    what = f"currents: inner product, {len(one.cells)}² triangles"
    name, repeats = _peer(at_once)
    theirs = partial(all_pairs_at_once if at_once else all_pairs, one, other, WIDE)
    return compared(what, name, partial(measure.inner, one, other), theirs, rtol=1e-9, repeats=repeats)


def _peer(at_once: bool) -> tuple[str, int]:
    """Return the name of NumPy's way, and how often to repeat it."""
    return ("all pairs in NumPy, at once", ALL_AT_ONCE_REPEATS) if at_once else ("all pairs in NumPy, blocks", 7)


def currents(width: float) -> Figure:
    """Compare d² of a simulated surface; both know the norm of the observed one."""
    simulated, observed = sheet(NODES, bend=0.20), sheet(NODES, bend=0.21)
    measure = Currents(width, quadrature="centre")
    known = all_pairs(observed, observed, width)

    def theirs() -> float:
        return all_pairs(simulated, simulated, width) - 2 * all_pairs(simulated, observed, width) + known

    what = f"currents: d², {len(observed.cells)}² triangles, width {width}"
    return compared(what, "all pairs in NumPy, blocks", partial(measure, simulated, observed), theirs, rtol=1e-6)


def closest_on_polyline(*, at_once: bool = False) -> Figure:
    """Compare the distances of points to a polyline."""
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 2.0, SEGMENTS + 1)
    target = Interface.polyline(np.stack([x, 0.3 * np.sin(3 * x) + 0.01 * rng.normal(size=x.size)], axis=1))
    points = np.stack([rng.uniform(0.0, 2.0, POINTS_2D), rng.uniform(-0.5, 0.5, POINTS_2D)], axis=1)
    what = f"closest points: {POINTS_2D} to {SEGMENTS} segments"
    name, repeats = _peer(at_once)
    block = len(points) * len(target.cells) if at_once else 4 * BLOCK
    ours, theirs = partial(squared_distances, points, target), partial(every_segment, points, target, block)
    return compared(what, name, ours, theirs, rtol=1e-9, atol=1e-15, repeats=repeats)


def many_polylines(width: float, *, batched: bool) -> Figure:
    """Compare d² of a campaign's polylines by the centre rule, one by one or as a batch."""
    observed, shapes = arches(NODES_2D, INTERFACES)
    simulated = [Interface.polyline(points) for points in shapes]
    measure = Currents(width, quadrature="centre")
    known = all_pairs_at_once(observed, observed, width)

    def ours() -> np.ndarray:
        if batched:
            return squared_discrepancies(measure, shapes, simulated[0], observed)
        return np.array([measure(one, observed) for one in simulated])

    def theirs() -> np.ndarray:
        pairs = ((all_pairs_at_once(one, one, width), all_pairs_at_once(one, observed, width)) for one in simulated)
        return np.array([own - 2 * cross + known for own, cross in pairs])

    what = f"currents: d², {INTERFACES} × {NODES_2D - 1} segments, width {width}{', batch' if batched else ''}"
    return compared(what, "each at once in NumPy", ours, theirs, rtol=1e-6)


def long_contour() -> Figure:
    """Return the time of `normal_offset` for many predicted interfaces, all errors of the contour integrated out."""
    errors = PointErrors(4e-4, 0.004, shift=0.004, rotation=0.2, scale=0.003, offset=0.003)

    def bows(heights: np.ndarray, nodes: int) -> np.ndarray:
        x = np.linspace(0.0, 1.0, nodes)
        return np.stack(np.broadcast_arrays(x, heights[:, None] * x * (1 - x)), axis=2)

    observed = errors.draw(Interface.polyline(bows(np.array([1.2]), SEEN)[0]), np.random.default_rng(5))
    predicted = bows(np.linspace(1.15, 1.25, PARTICLES), 161)
    measure, template = WhitenedOffset(errors), Interface.polyline(predicted[0])
    seconds, first = repeated(partial(measure.many, predicted, template, observed))
    what = f"normal_offset: {SEEN} points × {PARTICLES} interfaces"
    return Figure(what, "shift, rotation, scale, offset", seconds, "s", f"the first time {first:.3g} s")


def closest_on_surface(spread: float) -> Figure:
    """Return the time for points about `spread` mm from a large surface, whose search tree is known."""
    target = sheet(TARGET_NODES, bend=0.2)
    rng = np.random.default_rng(4)
    places = target.points[rng.integers(0, len(target.points), POINTS_3D)]
    points = places + spread * rng.normal(size=places.shape)
    seconds, first = repeated(partial(squared_distances, points, target))
    what = f"closest points: {POINTS_3D} to {len(target.cells)} triangles"
    return Figure(what, f"about {spread} mm away", seconds, "s", f"the first time {first:.3g} s")


def large(width: float, *, repeats: int = REPEATS) -> tuple[Figure, Figure]:
    """Return the time and memory of d² between two large surfaces, measured in a separate process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        seconds, first, memory, triangles = pool.submit(_large, width, repeats).result()
    what, case = f"currents: d², {triangles}² triangles", f"width {width}"
    return Figure(what, case, seconds, "s", f"the first time {first:.3g} s"), Figure(what, case, memory, "MiB", "peak")


def _large(width: float, repeats: int) -> tuple[float, float, float, int]:
    jax.config.update("jax_enable_x64", True)
    simulated, observed = sheet(MANY_NODES, bend=0.20), sheet(MANY_NODES, bend=0.21)
    seconds, first = repeated(partial(Currents(width, quadrature="centre"), simulated, observed), repeats)
    return seconds, first, peak_memory(), len(observed.cells)


def repeated(task: Callable[[], object], repeats: int = REPEATS) -> tuple[float, float]:
    """Return the median time of some calls, and the time of the first call before them."""
    first = timed(task)
    return statistics.median(timed(task) for _ in range(repeats)), first


def arches(nodes: int, number: int) -> tuple[Interface, np.ndarray]:
    """Return an arch as large as the biofilm, and the points of deformed ones."""
    t = np.linspace(0.0, np.pi, nodes)
    bends = 0.05 * np.random.default_rng(2).random((number, 1)) * np.sin(t)
    arch = np.stack([1.0 - 0.43 * np.cos(t), 0.47 * np.sin(t)], axis=1)
    return Interface.polyline(arch), arch + np.stack([bends, 0 * bends], axis=2)


def sheet(nodes: int, *, bend: float) -> Interface:
    """Return a square of nodes² points, bent in waves."""
    u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, nodes)], indexing="ij")
    points = np.stack([u, v, bend * np.sin(5 * u) * np.cos(4 * v)], axis=-1).reshape(-1, 3)
    first = (np.arange(nodes - 1)[:, None] * nodes + np.arange(nodes - 1)).ravel()
    one = np.stack([first, first + nodes, first + nodes + 1], axis=1)
    two = np.stack([first, first + nodes + 1, first + 1], axis=1)
    return Interface(points, np.concatenate([one, two]))


def all_pairs(a: Interface, b: Interface, width: float) -> float:
    """Return ⟨a,b⟩ by the centre rule over all pairs of facets, in blocks that fit the cache."""
    c, d, n, m = a.centres, b.centres, a.normals, b.normals
    total = 0.0
    for k in range(0, len(c), size := max(1, BLOCK // len(d))):
        r2 = sum((c[k : k + size, i, None] - d[:, i]) ** 2 for i in range(3))
        total += float(np.sum(n[k : k + size] * (np.exp(r2 * (-0.5 / width**2)) @ m)))
    return total


def all_pairs_at_once(a: Interface, b: Interface, width: float) -> float:
    """Return the same by a single expression."""
    r2 = sum((a.centres[:, i, None] - b.centres[:, i]) ** 2 for i in range(a.dim))
    return float(np.sum(np.exp(-r2 / (2 * width**2)) * (a.normals @ b.normals.T)))


def every_segment(points: np.ndarray, target: Interface, block: int = 4 * BLOCK) -> np.ndarray:
    """Return squared distances by projecting each point onto each segment, about `block` pairs at a time."""
    tangent = target.ends - target.starts
    square = np.sum(tangent**2, axis=1)
    found = []
    for k in range(0, len(points), size := max(1, block // len(tangent))):
        x, y = (points[k : k + size, i, None] - target.starts[:, i] for i in range(2))
        foot = np.clip((x * tangent[:, 0] + y * tangent[:, 1]) / square, 0.0, 1.0)
        x -= foot * tangent[:, 0]
        y -= foot * tangent[:, 1]
        found.append(np.min(x * x + y * y, axis=1))
    return np.concatenate(found)
