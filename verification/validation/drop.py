"""Seconds per batch of an active design on a real contour: an air bubble in water, 1600 observed points, five inputs.

The contour is the half level of a photograph (CC0, from the pendantdrop project); the model is the Young–Laplace
equation as a Python function. The noise is not measured but set to half a pixel per point: use the times, not the
widths.

    python -m verification.validation.drop PICTURE [--measure normal_offset] [--direction to_observed] [--runs 70]

With `normal_offset`, points are correlated over two pixels, and the position, rotation, scale and offset of the whole
contour are uncertain too. To keep compiled programs, as the command line does, set JAX_COMPILATION_CACHE_DIR to a
folder, JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0.02 and JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES=-1.
"""

import argparse
import resource
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
from contourpy import contour_generator
from jaxtyping import Float
from matplotlib.image import imread
from scipy.integrate import solve_ivp

import strandline as sl
from strandline.calibration import Observer, calibrate
from strandline.design.active import Active
from strandline.discrepancy.closest_point import DIRECTIONS, WEIGHTINGS

PIXEL = 1.24 / 400  # mm: the needle's outer diameter is 1.24 mm or 400 pixels
DENSITY, GRAVITY = 997.0 - 1.2, 9.81  # kg/m³, m/s²
LOWEST = 1290  # row of the picture, from its top; the needle begins below it
NODES, OBSERVED = 161, 1600
NOISE = 0.5 * PIXEL


def bubble(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the outline of a bubble on a needle, mm, from its left foot over the apex to its right foot.

    Young–Laplace with the arc length s from the apex, the depth z below it and the angle φ of the tangent:
    dφ/ds = 2/b - Δρ g z/γ - sin φ/x. Inputs: γ (mN/m), apex radius b (mm), apex (x0, y0) (mm), tilt (degrees).
    """
    gamma, b = inputs["gamma"], inputs["b"]
    pull = DENSITY * GRAVITY / gamma * 1e-3  # 1/mm²

    def slope(s: float, state: Float[np.ndarray, " 3"]) -> list[float]:
        x, z, phi = state
        return [np.cos(phi), np.sin(phi), 2 / b - pull * z - (np.sin(phi) / x if x > 1e-9 else 1 / b)]

    s = np.linspace(0.0, inputs["length"], NODES // 2 + 1)
    found = solve_ivp(slope, (0.0, s[-1]), [0.0, 0.0, 0.0], t_eval=s, rtol=1e-9, atol=1e-10)
    if not found.success:
        raise sl.ForwardModelError("no_outline", str(found.message))
    x, z, _ = found.y
    outline = np.concatenate([np.stack([-x, -z], axis=1)[:0:-1], np.stack([x, -z], axis=1)])
    c, t = np.cos(np.radians(inputs["tilt"])), np.sin(np.radians(inputs["tilt"]))
    return sl.Interface.polyline(outline @ np.array([[c, t], [-t, c]]) + [inputs["x0"], inputs["y0"]])


def contour(picture: Path) -> sl.Interface:
    """Return the bubble's contour above the needle, mm, y upwards: the half level between air and bubble."""
    grey = np.asarray(imread(picture), float)
    grey = grey if grey.ndim == 2 else grey[..., :3].mean(axis=2)
    level = 0.5 * (np.median(grey[100:1200, 300:800]) + np.median(grey[900:1100, 1200:1400]))
    lines = contour_generator(z=grey[:LOWEST]).lines(level)
    longest = max(lines, key=len)
    points = np.column_stack([longest[:, 0], -longest[:, 1]]) * PIXEL
    points = points if points[0, 0] < points[-1, 0] else points[::-1]
    return sl.Interface.polyline(points[np.linspace(0, len(points) - 1, OBSERVED).round().astype(int)])


def problem(observed: sl.Interface, measure: sl.Discrepancy, noise: float | sl.PointErrors) -> sl.Problem:
    """Return the calibration of surface tension, apex radius, place and tilt."""
    top, middle = observed.points[:, 1].max(), 0.5 * (observed.points[:, 0].min() + observed.points[:, 0].max())
    space = sl.ParameterSpace(
        (
            sl.Parameter("gamma", sl.Uniform(50, 100), "mN/m"),
            sl.Parameter("b", sl.Uniform(1.2, 1.6), "mm"),
            sl.Parameter("x0", sl.Uniform(middle - 0.1, middle + 0.1), "mm"),
            sl.Parameter("y0", sl.Uniform(top - 0.1, top + 0.1), "mm"),
            sl.Parameter("tilt", sl.Uniform(-3, 3), "deg"),
        )
    )
    length = 0.5 * float(observed.lengths.sum()) + 0.15
    return sl.Problem(bubble, space, {"length": length}, (sl.Observation(observed, noise),), {"measure": measure})


def cpu() -> float:
    """Return the CPU seconds of this process and its children so far."""
    return sum(
        use.ru_utime + use.ru_stime for use in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


class Stages:
    """Observer that prints the seconds of each stage when the next one begins."""

    def __init__(self) -> None:
        self.name, self.began, self.used = "", time.perf_counter(), cpu()

    def __call__(self, name: str) -> None:
        """Note that stage `name` begins."""
        now, used = time.perf_counter(), cpu()
        if self.name:
            print(f"{self.name:12s} {now - self.began:8.2f} s {used - self.used:8.2f} CPU s", flush=True)
        self.name, self.began, self.used = name, now, used


def main() -> None:
    """Run the design and print a line for each batch."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("picture", type=Path)
    parser.add_argument("--measure", choices=("closest_point", "normal_offset"), default="closest_point")
    parser.add_argument("--direction", choices=DIRECTIONS, default="to_simulated")
    parser.add_argument("--weighting", choices=WEIGHTINGS, default="sum")
    parser.add_argument("--runs", type=int, default=70)
    chosen = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    observed = contour(chosen.picture)
    if chosen.measure == "closest_point":
        measure = sl.ClosestPoint(direction=chosen.direction, weighting=chosen.weighting)
        asked = problem(observed, measure, NOISE**2)
    else:
        errors = sl.PointErrors(NOISE, 2 * PIXEL, shift=PIXEL, rotation=0.1, scale=0.002, offset=0.5 * PIXEL)
        asked = problem(observed, sl.NormalOffset(), errors)
    print(f"{len(observed.points)} observed points, {observed.lengths.sum():.2f} mm; {NODES} simulated ones")
    settings = sl.Settings(
        runs=14,
        surrogate="field",
        active=Active(runs=chosen.runs, batch=4),
        particles=2000,
        smc=sl.SMCSettings(rejuvenation_steps=10, zeta=0.9),
        seed=1,
    )
    with TemporaryDirectory() as folder, sl.Ledger.open(f"{folder}/l.sqlite", model=bubble) as ledger:
        result = calibrate(asked, settings, ledger=ledger, executor=sl.InProcess(), observer=Observer(stage=Stages()))
    for name, mean, sd in zip(asked.space.names, result.posterior.mean, result.posterior.sd, strict=True):
        print(f"{name:6s} {mean:10.4f} ± {sd:.4f}")
    print({name: round(seconds, 2) for name, seconds in result.seconds.items()})


if __name__ == "__main__":
    main()
