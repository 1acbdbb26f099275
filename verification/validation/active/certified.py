"""How often an active design certifies a wrong posterior of a model that is hard to learn, or easy to be fooled by.

The models are those of `hard_models`. The true posterior is integrated on a grid. Wrong means off by more than 0.3
standard deviations in a mean, or a quarter in a width; "said" counts wrong ones where the certificate states that a
region as small as the one that was missed may have been.

    python -m verification.validation.active.certified [--seeds 40] [--unseen 0.1] [--workers 1] [MODEL ...]
"""

import argparse
import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from jaxtyping import Float
from verification.validation.active.hard_models import MODELS, Model, X
from verification.validation.tables import Table

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, State, learn, posterior_state
from strandline.design.active.coverage_runs import least_found
from strandline.discrepancy import TrackedPoints
from strandline.errors import TooFewRuns
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.numerics.threads import one_thread, use_double
from strandline.posterior import Weighted
from strandline.runs import RunRecord

NOISE = 0.02
MEAN_OFF, WIDTH_OFF = 0.3, 0.25
GRID = {2: 400, 3: 100}


def true_moments(model: Model, seen: Interface) -> Weighted:
    """Return the true posterior on a grid: without the scatter of a model, and only where its runs succeed."""
    dim = len(model.truth)
    g = (np.arange(GRID[dim]) + 0.5) / GRID[dim]
    x = np.stack([one.ravel() for one in np.meshgrid(*[g] * dim)], axis=1)
    log = -0.5 * ((model.heights(x) - seen.points[:, 1]) ** 2).sum(axis=1) / NOISE**2
    log[model.fails(x)] = -np.inf
    weights = np.exp(log - log.max())
    return Weighted(x, weights / weights.sum())


@dataclass(frozen=True)
class Found:
    """How a design ended."""

    converged: bool
    right: bool
    runs: int
    region: float
    reason: str


def played(model: Model, seed: int, active: Active) -> Found:
    """Run an active design to its end."""
    random, space = np.random.default_rng([8, seed]), model.space
    heights = model.heights(model.truth[None])[0] + NOISE * random.standard_normal(len(X))
    seen = Interface.polyline(np.stack([X, heights], axis=1))
    observations, measure = (Observation(seen, NOISE**2),), TrackedPoints()
    likelihood = InterfaceLikelihood(observations, measure)

    def posterior(x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> State:
        known = learn(x, records, space, observations, measure)
        return posterior_state(known, space, (seed, len(x)), before=design.state)

    design = ActiveDesign(
        active,
        space,
        batch=4,
        learn=posterior,
        log_likelihood=lambda record: likelihood(record.interfaces),
        afresh=lambda state: posterior_state(state.knowledge, space, (seed, len(state.knowledge.x), 1)),
        seed=seed,
        scramble=seed,
    )
    x = space.to_physical(sobol(4 + 2 * space.dim, space.dim, scramble=seed))
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
    reason = "scatter" if design.scattered else "; ".join(design.reasons[1:2])
    return Found(design.converged, right, len(x), least_found(x, space), reason)


def start() -> None:
    """Prepare a process."""
    use_double()


def task(name: str, seed: int, active: Active) -> Found:
    """Run the design of one model and seed."""
    return played(MODELS[name](seed), seed, active)


def main() -> None:
    """Print a table with a row for each model."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("models", nargs="*", default=[], metavar="MODEL", help=", ".join(MODELS))
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--unseen", type=float, default=0.1)
    parser.add_argument("--runs", type=int, default=120)
    parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1))
    given = parser.parse_args()
    active, rows = Active(runs=given.runs, unseen=given.unseen), []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn"), initializer=start) as pool:
        for name in given.models or MODELS:
            found = [*pool.map(task, [name] * given.seeds, range(given.seeds), [active] * given.seeds)]
            wrong = [one for one in found if one.converged and not one.right]
            said = sum(one.region > MODELS[name](0).share > 0 for one in wrong)
            runs = np.array([one.runs for one in found])
            reasons = Counter(one.reason for one in found if not one.converged).most_common(1)
            ended = sum(one.converged for one in found), len(wrong), said, sum(one.right for one in found)
            rows.append((name, len(found), *ended, float(np.median(runs)), int(runs.max())))
            print(*rows[-1], *reasons, flush=True)
    columns = ("model", "designs", "converged", "wrong of these", "said", "right", "runs, median", "most")
    formats = ("s", "d", "d", "d", "d", "d", "g", "d")
    print(Table("certified", "Posteriors of hard models", columns, formats, tuple(rows)).markdown())


if __name__ == "__main__":
    main()
