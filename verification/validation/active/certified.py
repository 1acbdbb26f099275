"""How often an active design certifies a wrong posterior of a model that is hard to learn, or easy to be fooled by.

The models are those of `hard_models`. The true posterior is integrated on a grid. Wrong means off by more than 0.3
standard deviations in a mean, or a quarter in a width; "said" counts wrong ones where the certificate states that a
region as small as the one that was missed may have been.

    python -m verification.validation.active.certified [--seeds 40] [--unseen 0.1] [--runs 120]
        [--workers 2] [MODEL ...]
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from jaxtyping import Float
from verification.validation.active.hard_models import MODELS, Model, X
from verification.validation.tables import arguments, show, table

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
    true = true_moments(model, seen)
    off = np.abs(design.state.mean - true.mean) / true.sd
    width = np.abs(np.log(design.state.sd / true.sd))
    right = bool(off.max() < MEAN_OFF and width.max() < WIDTH_OFF)
    reason = "scatter" if design.scattered else "; ".join(design.reasons[1:2])
    return Found(design.converged, right, len(x), least_found(x, space), reason)


def task(name: str, seed: int, active: Active) -> Found:
    """Run the design of one model and seed."""
    return played(MODELS[name](seed), seed, active)


def rows(names: Sequence[str], seeds: int, active: Active, workers: int) -> Iterator[tuple]:
    """Yield the row of each model."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=use_double) as pool:
        for name in names:
            found = [*pool.map(task, [name] * seeds, range(seeds), [active] * seeds)]
            wrong = [one for one in found if one.converged and not one.right]
            said = sum(one.region > MODELS[name](0).share > 0 for one in wrong)
            runs = np.array([one.runs for one in found])
            ended = sum(one.converged for one in found), len(wrong), said, sum(one.right for one in found)
            print(*Counter(one.reason for one in found if not one.converged).most_common(1))
            yield name, len(found), *ended, float(np.median(runs)), int(runs.max())


if __name__ == "__main__":
    given = arguments(__doc__, words=MODELS, seeds=40, unseen=0.1, runs=120, workers=2)
    heading = (
        "model | designs {d} | converged {d} | wrong of these {d} | said {d} | right {d} | runs, median {g} | most {d}"
    )
    active = Active(runs=given.runs, unseen=given.unseen)
    found = rows(given.words or [*MODELS], given.seeds, active, given.workers)
    show([table("certified", "Posteriors of hard models", heading, found, live=True)])
