"""The posterior that follows from what is known, as particles.

From one batch to the next the posterior moves little, so its particles are reweighted, resampled and moved: a tenth of
the evaluations of sampling from the prior. Particles that start from the last posterior cannot see a mode that has
appeared elsewhere. So draws of the prior are tried as well, and whatever is checked on the true model is sampled from
the prior. A likelihood that is quick near the best fit, if there is one, leads near the posterior; from there the
particles go on to that of the measure in the same way.
"""

from collections.abc import Callable, Iterator

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.design.active.state import Knowledge, State
from strandline.design.refinement import SAMPLING
from strandline.foundations import one_thread
from strandline.parameters import ParameterSpace
from strandline.smc import OnHost, SMCResult, SMCSettings, StepInfo, carried_over, sample

ROUGHLY = SMCSettings(rejuvenation_steps=6, zeta=0.5)
"""Settings of the sampler where such a likelihood leads near the posterior; moves by the exact one follow."""
PARTICLES = {1: 2000, 2: 2000, 3: 2000}
MANY_INPUTS_PARTICLES = 1200
DRAFT_PARTICLES = 600
"""Particles of a draft, whatever the number of inputs."""
TEMPERATURE = 0.5
"""γ of the sampled π_γ ∝ L^γ p; its particles are reweighted to the posterior, and runs are chosen from them."""
STREAM = 4
"""Keeps the random numbers of the active design apart from all others of the same seed."""


def posterior_state(
    knowledge: Knowledge,
    space: ParameterSpace,
    seed: tuple[int, ...],
    *,
    before: State | None = None,
    on_step: Callable[[StepInfo], None] | None = None,
    particles: int | None = None,
) -> State:
    """Return the posterior that `knowledge` leads to; the same arguments give the same result to the bit.

    It goes on from the posterior `before`, if that is near; else it is sampled from the prior. By default, there are as
    many particles as the number of inputs needs.
    """
    rng = np.random.default_rng([*seed, STREAM])
    number = particles or PARTICLES.get(space.dim, MANY_INPUTS_PARTICLES)
    initial = space.prior_quantiles(rng.random((number, space.dim)))
    host = OnHost(lambda x: TEMPERATURE * knowledge.plug_in(x))
    key = jax.random.key(int(rng.integers(2**32)))
    earlier = None if before is None or len(before.positions) != number else _sampled(before)
    with one_thread():
        starts = _near_the_posterior(knowledge, space, earlier, initial, key, on_step)
        tried = (_gone_on(host, space, near, initial, jax.random.fold_in(key, 1)) for near in starts)
        found = next((one for one in tried if one is not None), None)
        if found is None:
            found = sample(key, host, space.log_prior, initial, settings=SAMPLING, on_step=on_step)
        return _state(knowledge, found)


def _near_the_posterior(
    knowledge: Knowledge,
    space: ParameterSpace,
    earlier: SMCResult | None,
    initial: Float[np.ndarray, "particle dim"],
    key: jax.Array,
    on_step: Callable[[StepInfo], None] | None,
) -> Iterator[SMCResult]:
    """Yield particles from which the posterior may be reached, the quickest to get first.

    Those that a rough likelihood has moved from the last posterior can have a few that outweigh the rest by the exact
    one. Sampling the rough one from the prior then takes a fiftieth of the time of sampling the exact one.
    """
    if knowledge.roughly(initial[:1]) is None:
        if earlier is not None:
            yield earlier
        return
    rough = OnHost(lambda x: TEMPERATURE * np.asarray(knowledge.roughly(x)))
    moved = None if earlier is None else _gone_on(rough, space, earlier, initial, jax.random.split(key)[0])
    if moved is not None:
        yield moved
    yield sample(key, rough, space.log_prior, initial, settings=ROUGHLY, on_step=on_step)


def _sampled(state: State) -> SMCResult:
    """Return the particles of π_γ of a posterior that was sampled earlier."""
    values = TEMPERATURE * state.log_plug_in
    return SMCResult(
        positions=state.positions,
        log_weights=state.log_weights_tempered,
        log_likelihood=values,
        log_prior=np.full(len(values), np.nan),
        log_evidence=state.log_evidence_tempered,
        ess=float(np.exp(-logsumexp(2 * state.log_weights_tempered))),
        steps=(),
        likelihood_evaluations=0,
    )


def _gone_on(
    host: OnHost, space: ParameterSpace, before: SMCResult, scouts: Float[np.ndarray, "scout dim"], key: jax.Array
) -> SMCResult | None:
    """Return the particles moved from another likelihood's to those of `host`; None if the two are not near."""
    extents = space.high - space.low
    return carried_over(key, before, host, space.log_prior, scouts=scouts, extents=extents, settings=SAMPLING)


def _state(knowledge: Knowledge, found: SMCResult) -> State:
    x, log_weights, tempered = found.positions, found.log_weights, found.log_likelihood
    exact = tempered / TEMPERATURE
    expected = knowledge.expected(x, plug_in=exact)
    rest = log_weights - tempered
    return State(
        knowledge=knowledge,
        positions=x,
        log_weights=log_softmax(rest + expected),
        log_weights_tempered=log_weights,
        log_weights_plug_in=log_softmax(rest + exact),
        log_expected=expected,
        log_plug_in=exact,
        log_evidence_tempered=found.log_evidence,
    )
