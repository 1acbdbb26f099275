"""How well and how fast surfaces are found in stacks of 256 × 256 × 128 voxels; exit status 1 on a missed aim.

Two solids with bumps, blurred by 1.5 voxels, contrast over noise 10: one with cubes as voxels, one with voxels twice as
long along z. The time is that from the array to the observation: surface, thinned to 5000 triangles, and its errors.

    python -m verification.validation.stack [--stacks 3] [--planes 128]
"""

import time

import numpy as np
from verification.benchmarks.figures import timed
from verification.validation.rendered_stacks import Blob, Microscope
from verification.validation.tables import arguments, finish, show, table

from strandline.discrepancy import ClosestPoint, Currents
from strandline.imaging import StackFrame, find_surface
from strandline.interface import GaussianNoise, Interface, Observation

SECONDS, DISTANCE, OWN, TRIANGLES = 3.0, 0.1, (0.7, 1.3), 5000
"""Aims: longest time, largest rms distance from the truth in sides of a voxel, own s over s, most triangles."""
SMALLEST = 1e-3
HEADING = (
    "voxels | seconds {.2f} | triangles {d} | rms distance {.3f} | bias {+.3f} | own offset {.3f} | s {.3f} "
    "| own s / s {.2f} | ℓ {.2f} | closest point, s {.2f} | currents, s {.2f}"
)


def solid(along: float, planes: int) -> tuple[Blob, Microscope]:
    """Return a solid, and the microscope with so many planes, `along` times as far apart as the voxels are wide."""
    shape = (planes, 2 * planes, 2 * planes)
    voxel = (SMALLEST, SMALLEST, along * SMALLEST)
    size = SMALLEST * np.array([2 * planes, 2 * planes, along * planes])
    centre, axes = tuple((0.5 * size + 0.3 * SMALLEST).tolist()), tuple((0.36 * size).tolist())
    blur = (1.5 * SMALLEST, 1.5 * SMALLEST, 1.5 * SMALLEST * along)
    return Blob(centre, axes, bumps=0.04), Microscope(voxel, shape, blur)


def row(name: str, along: float, stacks: int, planes: int) -> tuple[tuple, bool]:
    """Return what was found in stacks of one kind, and whether the aims were met."""
    blob, microscope = solid(along, planes)
    clean, side = microscope.clean(blob), float(np.prod(microscope.voxel)) ** (1 / 3)
    times, off, found, triangles = [], [], [], 0
    for seed in range(stacks):
        stack = microscope.with_noise(clean, np.random.default_rng([7, seed]))
        start = time.perf_counter()
        surface = find_surface(stack, solid="bright", triangles=TRIANGLES)
        seen = StackFrame((0.0, 0.0, 0.0), stack.voxel).interface(surface.mesh)
        Observation(seen, GaussianNoise(1.0))
        times.append(time.perf_counter() - start)
        off.append(blob.distances(seen.points) / side)
        found.append(surface.errors)
        triangles = max(triangles, len(seen.cells))
    inside = np.concatenate([off[-1], blob.distances(seen.centres) / side])
    rms = max(float(np.sqrt(np.mean(part**2))) for part in (*off, inside))
    scatter = np.array([part.std() for part in off])
    own, offsets, lengths = (np.array([getattr(one, k) for one in found]) / side for k in ("sd", "offset", "length"))
    ratios = own / scatter
    width, simulated = 0.1 * float(np.ptp(seen.points, axis=0).max()), Interface(1.01 * seen.points, seen.cells)
    measures = ClosestPoint(direction="to_simulated"), Currents(width, quadrature="centre")
    bias = np.mean([part.mean() for part in off])
    of_errors = map(float, (bias, offsets.mean(), scatter.mean(), ratios.mean(), lengths.mean()))
    seconds = (timed(measure, simulated, seen) for measure in measures)
    cells = (f"{name}, {2 * planes} × {2 * planes} × {planes}", max(times), triangles, rms, *of_errors, *seconds)
    low, high = OWN
    met = max(times) <= SECONDS and rms <= DISTANCE and low <= ratios.min() and ratios.max() <= high
    return cells, met and triangles <= TRIANGLES


if __name__ == "__main__":
    options = arguments(__doc__, stacks=3, planes=128)
    kinds = {"cubes": 1.0, "twice as long": 2.0}
    found, met = zip(*(row(*kind, options.stacks, options.planes) for kind in kinds.items()), strict=True)
    show([table("stack", "Surfaces in rendered stacks", HEADING, found)])
    aims = f"aims: {SECONDS:g} s, rms distance {DISTANCE:g}, own s / s from {OWN[0]:g} to {OWN[1]:g}"
    finish([] if all(met) else [f"{aims}: missed"])
