"""A design grown batch by batch, with its posterior after each batch."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax
from verification.validation.active.cases import Case

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, Knowledge, State, learn, posterior_state
from strandline.errors import TooFewRuns
from strandline.numerics.threads import one_thread
from strandline.posterior import Weighted
from strandline.runs import RunRecord
from strandline.smc import OnHost, SMCSettings, sample

PARTICLES = 6000
RESTLESS = 1e-12
"""Change below which a design would go on to its check; none is as small."""


@dataclass(frozen=True, eq=False)
class Grown:
    """A design after a batch: its runs, its posterior, and the seconds that learning, sampling and choosing took."""

    state: State
    runs: int
    failed: int
    seconds: float


def initial_runs(dim: int, *, sensitivities: bool) -> int:
    """Return the size of the first design, the same as in a study."""
    return max((4 + 2 * dim) // 2, 3) if sensitivities else 4 + 2 * dim


def grow(
    one: Case,
    *,
    seed: int,
    batch: int,
    most: int,
    sensitivities: bool,
    criterion: str = "expected_variance",
    spoil: Callable[[RunRecord], RunRecord] = lambda record: record,
) -> Iterator[Grown]:
    """Yield the design after each batch, up to `most` runs; `spoil` is a function of a record that makes runs fail."""
    space, first = one.space, initial_runs(one.space.dim, sensitivities=sensitivities)
    most_asked = most + batch + Active.check
    active = Active(runs=most_asked, initial=first, batch=batch, criterion=criterion, change=RESTLESS)

    def posterior(x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> State:
        known = learn(x, records, space, one.observations, one.measure)
        return posterior_state(known, space, (seed, len(x)))

    design = ActiveDesign(
        active, space, batch=batch, learn=posterior, log_likelihood=one.log_likelihood, seed=seed, scramble=seed
    )
    x = space.to_physical(sobol(first, space.dim, scramble=seed))
    design.start(x)
    records = [spoil(one.run(row, sensitivities)) for row in x]
    while True:
        begun = time.perf_counter()
        try:
            with one_thread():
                more = design.next(x, records)
            yield Grown(design.state, len(x), sum(not r.ok for r in records), time.perf_counter() - begun)
        except TooFewRuns:
            more = design.more_of_the_first()
        if more is None or len(x) + batch > most:
            return
        x = np.concatenate([x, more.points])
        records += [spoil(one.run(row, sensitivities)) for row in more.points]


def delivered(one: Case, knowledge: Knowledge, seed: int) -> Weighted:
    """Return the posterior as a study computes it at the end, with enough particles to judge it."""
    host = OnHost(knowledge.nearly_expected)
    initial = one.space.prior_quantiles(np.random.default_rng([seed, 9]).random((PARTICLES, one.space.dim)))
    settings = SMCSettings(rejuvenation_steps=15, zeta=0.5)
    with one_thread():
        found = sample(jax.random.key(seed), host, one.space.log_prior, initial, settings=settings)
        expected = knowledge.expected(found.positions, plug_in=knowledge.plug_in(found.positions))
    weights = np.exp(log_softmax(found.log_weights + expected - found.log_likelihood))
    return Weighted(found.positions, weights)
