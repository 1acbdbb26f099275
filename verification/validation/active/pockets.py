"""How often an active design certifies a posterior that misses a second mode in a pocket of the box.

The model has two inputs and is smooth but for a pocket, a disc of some share of the box, in which its interface turns
into the observed one. So the posterior has a second mode there, about as heavy as the first. The true posterior is
integrated on a grid. Wrong means off by more than 0.3 standard deviations in a mean, or a quarter in a width.

    python -m verification.validation.active.pockets [--seeds 40] [--shares 0.15 0.08 0.04 0] [--unseen 0.1]
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from verification.validation.tables import Table

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, State, learn, posterior_state
from strandline.design.active.elsewhere import least_found
from strandline.discrepancy import TrackedPoints
from strandline.errors import TooFewRuns
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.numerics.one_thread import one_thread
from strandline.numerics.precision import use_double
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior.weighted import Weighted
from strandline.priors import Uniform
from strandline.runs import RunRecord

SPACE = ParameterSpace((Parameter("a", Uniform(0.0, 1.0)), Parameter("b", Uniform(0.0, 1.0))))
X = np.linspace(0.0, 1.0, 21)
TRUTH = np.array([0.3, 0.35])
NOISE = 0.02
MEAN_OFF, WIDTH_OFF = 0.3, 0.25
GRID = 400


@dataclass(frozen=True)
class Pocket:
    """A smooth model with a disc in which it turns into what was observed.

    Args:
        middle: Middle of the disc.
        share: Its share of the box; 0: there is none.
    """

    middle: tuple[float, float]
    share: float

    def heights(self, x: Float[np.ndarray, "run 2"]) -> Float[np.ndarray, "run 21"]:
        """Return the heights of the interface at 21 places."""
        smooth = _smooth(x)
        if not self.share:
            return smooth
        apart = np.linalg.norm(x - np.array(self.middle), axis=1) / math.sqrt(self.share / math.pi)
        inside = np.where(apart < 1, (1 - np.minimum(apart, 1) ** 2) ** 2, 0.0)
        like = _smooth(TRUTH + 0.5 * (x - np.array(self.middle)))
        return smooth + inside[:, None] * (like - smooth)

    def run(self, x: Float[np.ndarray, " 2"]) -> RunRecord:
        """Return the record of a run."""
        interface = Interface.polyline(np.stack([X, self.heights(x[None])[0]], axis=1))
        return RunRecord(x.tobytes().hex(), SPACE.as_mapping(x), "ok", {"": interface})


def _smooth(x: Float[np.ndarray, "run 2"]) -> Float[np.ndarray, "run 21"]:
    a, b = x[:, :1], x[:, 1:]
    return 0.3 * np.sin(2 * a + X) * X + 0.4 * b * X**2 + 0.2 * a * b * np.sin(3 * X)


def pocket(share: float, seed: int) -> Pocket:
    """Return a pocket that lies inside the box, at least its radius away from the first mode."""
    radius, random = math.sqrt(share / math.pi), np.random.default_rng([7, seed])
    while True:
        middle = random.uniform(radius, 1 - radius, 2) if share else TRUTH
        if not share or np.linalg.norm(middle - TRUTH) > radius + 0.15:
            return Pocket((float(middle[0]), float(middle[1])), share)


def true_moments(model: Pocket, seen: Interface) -> Weighted:
    """Return the true posterior on a grid."""
    g = (np.arange(GRID) + 0.5) / GRID
    x = np.stack([one.ravel() for one in np.meshgrid(g, g)], axis=1)
    log = -0.5 * ((model.heights(x) - seen.points[:, 1]) ** 2).sum(axis=1) / NOISE**2
    weights = np.exp(log - log.max())
    return Weighted(x, weights / weights.sum())


@dataclass(frozen=True)
class Found:
    """How a design ended."""

    converged: bool
    right: bool
    runs: int
    region: float


def played(model: Pocket, seed: int, active: Active) -> Found:
    """Run an active design to its end."""
    random = np.random.default_rng([8, seed])
    heights = _smooth(TRUTH[None])[0] + NOISE * random.standard_normal(len(X))
    seen = Interface.polyline(np.stack([X, heights], axis=1))
    observations, measure = (Observation(seen, NOISE**2),), TrackedPoints()
    likelihood = InterfaceLikelihood(observations, measure)

    def posterior(x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> State:
        known = learn(x, records, SPACE, observations, measure)
        return posterior_state(known, SPACE, (seed, len(x)), before=design.state)

    design = ActiveDesign(
        active,
        SPACE,
        batch=4,
        learn=posterior,
        log_likelihood=lambda record: likelihood(record.interfaces),
        afresh=lambda state: posterior_state(state.knowledge, SPACE, (seed, len(state.knowledge.x), 1)),
        seed=seed,
        scramble=seed,
    )
    x = SPACE.to_physical(sobol(8, 2, scramble=seed))
    design.start(x)
    records = [model.run(row) for row in x]
    while True:
        try:
            with one_thread():
                more = design.next(x, records)
        except TooFewRuns:
            more = design.more_of_the_first()
        if more is None:
            break
        x = np.concatenate([x, more.points])
        records += [model.run(row) for row in more.points]
    assert design.state is not None
    true = true_moments(model, seen)
    off = np.abs(design.state.mean - true.mean) / true.sd
    width = np.abs(np.log(design.state.sd / true.sd))
    right = bool(off.max() < MEAN_OFF and width.max() < WIDTH_OFF)
    return Found(design.converged, right, len(x), least_found(x, SPACE))


def main() -> None:
    """Print a table with a row for each share."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.15, 0.08, 0.04, 0.0])
    parser.add_argument("--unseen", type=float, default=0.1)
    parser.add_argument("--runs", type=int, default=120)
    given = parser.parse_args()
    use_double()
    rows = []
    for share in given.shares:
        active = Active(runs=given.runs, unseen=given.unseen)
        found = [played(pocket(share, seed), seed, active) for seed in range(given.seeds)]
        wrong = [one for one in found if one.converged and not one.right]
        covered = sum(one.region > share for one in wrong)
        runs = np.array([one.runs for one in found])
        rows.append(
            (
                f"{share:.0%}",
                len(found),
                sum(one.converged for one in found),
                len(wrong),
                covered,
                sum(one.right for one in found),
                float(np.median(runs)),
                int(runs.max()),
            )
        )
        print(*rows[-1], flush=True)
    columns = ("pocket", "designs", "converged", "wrong of these", "said", "right", "runs, median", "most")
    formats = ("s", "d", "d", "d", "d", "d", "g", "d")
    print(Table("pockets", "Second modes in pockets", columns, formats, tuple(rows)).markdown())


if __name__ == "__main__":
    main()
