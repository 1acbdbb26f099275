"""Closed outlines that begin anywhere, in either direction, against the same outlines with fixed nodes.

Random families of outlines of two inputs; the posterior by a sum over a grid, through the surrogate of the interface,
and the number of runs after which an active design ends (half a minute a problem).

Run it with:  python -m verification.validation.first_nodes [--problems 40]
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from verification.validation.tables import arguments, show, table

import strandline as sl
from strandline.calibration import Problem, Settings, calibrate
from strandline.design import sobol
from strandline.design.active import Active
from strandline.discrepancy import NormalOffset, squared_discrepancies
from strandline.interface import Interface, Observation, PointErrors
from strandline.models.protocol import Simulation
from strandline.surrogate.field import FieldTraining, fit_field

SD = 0.01
"""Standard deviation of the observed points, mm; outlines have a radius of about 1 mm."""
RUNS, SEEN, GRID = 48, 50, 41
LOW, HIGH = np.zeros(2), np.ones(2)
WAVES = np.array([-2, -1, 1, 2, 3])
DESIGN = Settings(runs=8, particles=1000, surrogate="field", active=Active(120, batch=4), draft=True)


class Family:
    """Outlines as Fourier series whose coefficients are quadratic in two inputs; the nodes slide with the second."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 1])
        size = 0.3 / np.abs(WAVES) ** 1.5
        self.terms = size * (random.standard_normal((6, 5)) + 1j * random.standard_normal((6, 5))) / 3
        self.terms[0, 2] += 1.0
        self.sliding = random.uniform(-0.3, 0.3)
        self.truth = random.uniform(0.3, 0.7, 2)

    def __call__(self, x: np.ndarray, nodes: int, *, begin: float = 0.0) -> np.ndarray:
        a, b = x - 0.5
        terms = np.array([1.0, a, b, a * a, a * b, b * b]) @ self.terms
        t = begin + 2 * np.pi * np.arange(nodes) / nodes
        t = t + self.sliding * b + 0.2 * np.sin(t)
        z = np.exp(1j * np.outer(t, WAVES)) @ terms
        return np.stack([z.real, z.imag], axis=1)


def closed(points: np.ndarray, first: int = 0, *, back: bool = False) -> Interface:
    """Return the outline through points from another first one on."""
    return Interface.polyline(np.roll(points[::-1] if back else points, -first, axis=0), closed=True)


def posterior(
    family: Family, make: Callable[[np.ndarray], Interface], nodes: int
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return mean and sd of the posterior by runs of `make`, and how these share their points."""
    x = np.asarray(sobol(RUNS, 2, scramble=3))
    surrogate = fit_field(FieldTraining(x, [{"": make(row)} for row in x], None, LOW, HIGH))
    template = surrogate.layouts[""].template
    seen = PointErrors(SD).draw(closed(family(family.truth, SEEN)), np.random.default_rng([7, nodes]))
    seen = seen.reversed() if seen.runs_against(template) else seen
    low, high = LOW, HIGH
    for _ in range(3):
        axes = [np.linspace(a, b, GRID) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        squares = squared_discrepancies(NormalOffset(), surrogate.points(surrogate.mean(grid))[""], template, seen)
        weights = np.exp(-0.5 * (squares - squares.min()) / SD**2)
        mean = weights @ grid / weights.sum()
        sd = np.sqrt(weights @ (grid - mean) ** 2 / weights.sum())
        reach = 6 * np.maximum(sd, (high - low) / GRID)
        low, high = np.clip(mean - reach, 0, 1), np.clip(mean + reach, 0, 1)
    return mean, sd, ", ".join(surrogate.ways)


@dataclass(frozen=True)
class Simulator:
    """A forward model that returns the outline of the inputs a and b."""

    make: Callable[[np.ndarray], Interface]
    fingerprint: str = "outlines"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return Simulation.of(self.make(np.array([inputs["a"], inputs["b"]])))


def runs_of_a_design(family: Family, make: Callable[[np.ndarray], Interface]) -> int:
    """Return the number of runs after which an active design certifies its posterior."""
    seen = PointErrors(SD).draw(closed(family(family.truth, SEEN)), np.random.default_rng(7))
    space = sl.ParameterSpace(tuple(sl.Parameter(name, sl.Uniform(0.0, 1.0)) for name in "ab"))
    problem = Problem(Simulator(make), space, {}, (Observation(seen, PointErrors(SD)),), {"offset": NormalOffset()})
    found = calibrate(problem, DESIGN)
    if not found.field.certificate.converged:
        raise RuntimeError("an active design ended without a certificate")
    return len(found.records)


def compared(seed: int) -> list[tuple[str, float, float, str, int, int]]:
    """Return how far mean and width are from those with fixed nodes, in sd and as a ratio, and the runs of both."""
    family, random, found = Family(seed), np.random.default_rng([seed, 2]), []

    def wandering(x: np.ndarray) -> Interface:
        return closed(family(x, 60), int(random.integers(60)), back=bool(random.integers(2)))

    def anywhere(x: np.ndarray) -> Interface:
        begin, nodes = random.uniform(0, 2 * np.pi), int(random.integers(200, 280))
        return closed(family(x, nodes, begin=begin), back=bool(random.integers(2)))

    for kind, nodes, make in (("equal numbers of nodes", 60, wandering), ("other numbers", 240, anywhere)):

        def still(x: np.ndarray, nodes: int = nodes) -> Interface:
            return closed(family(x, nodes))

        mean, sd, _ = posterior(family, still, nodes)
        other_mean, other_sd, ways = posterior(family, make, nodes)
        off = float(np.max(np.abs(other_mean - mean) / sd))
        wider = float(np.max(np.abs(other_sd / sd - 1)))
        found.append((kind, off, wider, ways, runs_of_a_design(family, still), runs_of_a_design(family, make)))
    return found


def rows(problems: int) -> Iterator[tuple]:
    results = [one for seed in range(problems) for one in compared(seed)]
    for kind in dict.fromkeys(one[0] for one in results):
        mine = [one for one in results if one[0] == kind]
        ways = "; ".join(sorted({one[3] for one in mine}))
        worst = max(one[1] for one in mine), max(one[2] for one in mine)
        yield kind, len(mine), *worst, ways, sum(one[4] for one in mine), sum(one[5] for one in mine)


if __name__ == "__main__":
    heading = (
        "outlines | problems {d} | mean off, sd {.2g} | width off, share {.2g} | common points "
        "| runs, fixed {d} | runs, these {d}"
    )
    show([table("first nodes", "Against fixed nodes", heading, rows(arguments(__doc__, problems=40).problems))])
