"""Fields of stiffness from the shape of a strip: runs to a certificate, and how often it is wrong.

A strip bends under a uniform load: w'' = M/B, M = q (1 - s)²/2, B = exp(z), z a Gaussian field. The shape is seen at 40
points with noise of 1 % of the tip's displacement; the observation's field has 200 modes. The true posterior is sampled
from the true model: by Hamiltonian chains, or, where it is planted with a trap, by tempered particles. Printed are the
largest error of the field's mean, in its sds, and of its sd, over all points.

    python -m verification.validation.active.strips [--dims 10 20] [--seeds 20] [--first 0] [--workers 2]
        [--exact no|auto|yes] [--planted length|jump|mode|matters] [--runs 120] [--differences]
"""

import argparse
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from strandline.calibration import Problem, Settings, calibrate
from strandline.design.active import Active
from strandline.discrepancy import TrackedPoints
from strandline.foundations import use_double
from strandline.interface import Interface, Observation
from strandline.models import Simulation
from strandline.parameters import GaussianField, ParameterSpace, RandomField
from strandline.parameters.fields import Support
from strandline.posterior import Weighted
from strandline.smc import OnHost, SMCSettings, hamiltonian, sample

PLACES, NOISE, LOAD = 200, 0.005, 3.0
MEAN_OFF, WIDTH_OFF = 0.3, 0.25
SWITCH, STEEP, SHIFT, KNEE = 1.2, 8.0, 1.5, 0.015
"""Where a second mode begins in the last coefficient, and how steeply; its shift of the first one; size of a knee."""
MIDDLES = (np.arange(PLACES) + 0.5) / PLACES
SEEN = np.linspace(0.0, 1.0, 41)[1:]
BENDING = np.maximum(SEEN[:, None] - MIDDLES, 0.0) * LOAD * (1 - MIDDLES) ** 2 / 2 / PLACES
"""Displacements of the seen points by the compliances 1/B of all places."""
Coefficients = Float[np.ndarray, "draw dim"]


def prior(modes: int, length: float = 0.15) -> RandomField:
    """Return the field of log stiffness, sd .5."""
    support = Support(np.stack([MIDDLES, 0 * MIDDLES], axis=1), np.full(PLACES, 1 / PLACES))
    return GaussianField(1.0, 0.5, length, covariance="matern12", modes=modes).on("B", support)


@dataclass(frozen=True)
class Strip:
    """The strip; of a planted one, the coefficients act on the shape in another way, and are its inputs."""

    dim: int
    planted: str = ""
    sensitivities: bool = True

    @cached_property
    def field(self) -> RandomField:
        return prior(self.dim)

    def shapes(self, xi: Coefficients) -> tuple[Float[np.ndarray, "draw 40"], Float[np.ndarray, "draw dim"], Any]:
        """Return displacements, the coefficients that the strip sees, and the last one's effect on the first."""
        acting, last = np.array(xi), xi[:, -1]
        if self.planted == "mode":
            acting[:, 0] += SHIFT / (1 + np.exp(-STEEP * (last - SWITCH)))
        w = np.exp(-acting @ self.field.modes.T) @ BENDING.T
        if self.planted == "matters":
            w = w + KNEE * np.maximum(last, 0.0)[:, None] ** 2 * np.sin(3 * np.pi * SEEN)
        return w, acting, last

    def slopes(self, xi: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "40 dim"]:
        _, acting, last = self.shapes(xi[None])
        J = -(BENDING * np.exp(-self.field.modes @ acting[0])) @ self.field.modes
        if self.planted == "mode":
            step = 1 / (1 + np.exp(-STEEP * (last[0] - SWITCH)))
            J[:, -1] += J[:, 0] * SHIFT * STEEP * step * (1 - step)
        if self.planted == "matters":
            J[:, -1] += 2 * KNEE * max(last[0], 0.0) * np.sin(3 * np.pi * SEEN)
        return np.asarray(J)

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        xi = np.array([inputs[name] for name in self.field.names])
        w, J = self.shapes(xi[None])[0][0], self.slopes(xi)
        by = {name: np.stack([np.zeros(40), J[:, k]], axis=1) for k, name in enumerate(self.field.names)}
        return Simulation.of(
            Interface.polyline(np.stack([SEEN, w], axis=1)), sensitivities=by if self.sensitivities else None
        )


@dataclass(frozen=True)
class Truth:
    """Displacements that are seen of a strip, and the true posterior of its field."""

    strip: Strip
    seen: Float[np.ndarray, " 40"]

    def log_likelihood(self, xi: Coefficients) -> Float[np.ndarray, " draw"]:
        with np.errstate(over="ignore", invalid="ignore"):
            found = -0.5 * ((self.strip.shapes(xi)[0] - self.seen) ** 2).sum(axis=1) / NOISE**2
        return np.nan_to_num(found, nan=-np.inf)

    def force(self, xi: Coefficients) -> Coefficients:
        """Return the slope of the log posterior, of a strip that is not planted."""
        compliances = np.exp(-xi @ self.strip.field.modes.T)
        r = (compliances @ BENDING.T - self.seen) / NOISE**2
        return ((r @ BENDING) * compliances) @ self.strip.field.modes - xi

    def by_chains(self, start: Coefficients, random: np.random.Generator) -> Weighted:
        H = np.mean([J.T @ J for J in map(self.strip.slopes, start)], axis=0) / NOISE**2 + np.eye(self.strip.dim)
        root = np.linalg.inv(np.linalg.cholesky(H)).T
        density = lambda xi: self.log_likelihood(xi) - 0.5 * (xi**2).sum(axis=1)  # noqa: E731
        warm = hamiltonian(density, self.force, start, root, random, steps=300, step=0.3, adapt=True)
        found = hamiltonian(density, self.force, warm.last, root, random, steps=1500, step=warm.step)
        print(f"    true model: R̂ {found.r_hat:.3f}, effective {found.effective:.0f}", flush=True)
        xi = found.draws[::5].reshape(-1, self.strip.dim)
        return Weighted(xi @ self.strip.field.modes.T, np.full(len(xi), 1 / len(xi)))

    def by_particles(self, seed: int) -> Weighted:
        space = ParameterSpace(self.strip.field.parameters)
        first = space.prior_quantiles(np.random.default_rng(seed).random((4000, self.strip.dim)))
        settings = SMCSettings(rejuvenation_steps=25, zeta=0.6)
        found = sample(jax.random.key(seed), OnHost(self.log_likelihood), space.log_prior, first, settings=settings)
        xi = found.positions
        if self.strip.planted == "mode":
            xi = self.strip.shapes(xi)[1]
        return Weighted(xi @ self.strip.field.modes.T, np.exp(found.log_weights))


def observed(strip: Strip, seed: int) -> Float[np.ndarray, " 40"]:
    """Return the displacements of a strip of its own field, with noise."""
    random = np.random.default_rng([21, seed])
    z = prior(200, 0.05 if strip.planted == "length" else 0.15)
    values = z.values(random.standard_normal(200))
    if strip.planted == "jump":
        values = values * np.where(random.uniform(0.2, 0.6) < MIDDLES, 2.0, 0.7)
    return np.asarray(BENDING @ (1 / values) + NOISE * random.standard_normal(40))


def one(seed: int, dim: int, planted: str, exact: bool | None, runs: int = 120, *, differences: bool = False) -> str:
    """Return what a calibration finds, as a line."""
    use_double()
    strip = Strip(dim, planted, not differences)
    truth = Truth(strip, observed(strip, seed))
    seen = Observation(Interface.polyline(np.stack([SEEN, truth.seen], axis=1)), NOISE**2)
    space = ParameterSpace(strip.field.parameters)
    problem = Problem(strip, space, {}, (seen,), {"tracked": TrackedPoints()})
    active = Active(runs=runs, exact=exact, differences=differences)
    begun = time.process_time()
    found = calibrate(problem, Settings(runs=3, surrogate="field", active=active, seed=seed))
    seconds = time.process_time() - begun
    draws, weights = found.posterior.draws, found.posterior.weights
    acting = strip.shapes(draws)[1] if planted == "mode" else draws
    ours = Weighted(acting @ strip.field.modes.T, weights)
    start = found.posterior.equally_weighted(1, 48)
    by_particles = planted in ("mode", "matters")
    true = truth.by_particles(seed) if by_particles else truth.by_chains(start, np.random.default_rng(seed))
    off, wide = np.abs((ours.mean - true.mean) / true.sd).max(), np.abs(ours.sd / true.sd - 1).max()
    state, chain = found.certificate.converged, found.certificate.drawn
    wrong = state and (off > MEAN_OFF or wide > WIDTH_OFF)
    return (
        f"d {dim} seed {seed}: {'converged' if state else 'not'}{' WRONG' if wrong else ''} after "
        f"{len(found.records)} runs, mean off {off:.2f}, sd {wide:.2f}, {seconds:.0f} CPU-s {chain}"
    )


def main() -> None:
    """Print a line for each strip."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--dims", type=int, nargs="+", default=[10, 20])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--runs", type=int, default=120)
    parser.add_argument("--exact", choices=("no", "auto", "yes"), default="auto")
    parser.add_argument("--planted", choices=("", "length", "jump", "mode", "matters"), default="")
    parser.add_argument("--differences", action="store_true")
    given = parser.parse_args()
    exact = {"no": False, "auto": None, "yes": True}[given.exact]
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        for dim in given.dims:
            of_one = partial(
                one, dim=dim, planted=given.planted, exact=exact, runs=given.runs, differences=given.differences
            )
            for line in pool.map(of_one, range(given.first, given.first + given.seeds)):
                print(line, flush=True)


if __name__ == "__main__":
    main()
