"""What is known after some runs: the surrogate of the field, where runs fail, and the posterior as particles.

From one batch to the next the posterior moves little, so its particles are reweighted, resampled and moved: a tenth of
the evaluations of sampling from the prior. Particles that start from the last posterior cannot see a mode that has
appeared elsewhere. So draws of the prior are tried as well, and whatever is checked on the true model is sampled from
the prior. A likelihood that is quick near the best fit, if there is one, leads near the posterior; from there the
particles go on to that of the measure in the same way.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.design.refinement import SAMPLING
from strandline.design.run_filter import says_whether_runs_succeed
from strandline.discrepancy import Discrepancy
from strandline.foundations import NoCommonPoints, one_thread, require
from strandline.interface import Observation
from strandline.likelihood import FieldLikelihood, noise_length
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted
from strandline.runs import RunRecord
from strandline.smc import OnHost, SMCResult, SMCSettings, StepInfo, carried_over, sample
from strandline.surrogate import Feasibility, FieldSurrogate, FieldTraining, fit_field, learn_feasibility

Values = Float[np.ndarray, " point"]

TOLERATED_REMAINDER = 0.08
"""Largest remainder that the modes may leave, as a share of the shift in a random direction that the noise hides."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Surrogate and classifier learnt from some runs.

    These are the log-likelihood through the surrogate of the field, and the probability that a run succeeds, which is
    taken relative to that of the safest run; `highest` is the logarithm of the latter.
    """

    x: Float[np.ndarray, "run dim"]
    ok: np.ndarray
    likelihood: FieldLikelihood
    feasibility: Feasibility
    highest: float

    @property
    def surrogate(self) -> FieldSurrogate:
        return self.likelihood.surrogate

    @property
    def hidden(self) -> float:
        """Shift of an observed interface that the noise hides, mm: the smallest of all conditions."""
        return hidden_shift(self.likelihood.known_observations, self.likelihood.discrepancy)

    def log_feasibility(self, x: Float[np.ndarray, "point dim"]) -> Values:
        """Return the log probability of success relative to the safest run, so random failures change nothing."""
        z = self.surrogate.warping.standardise(x)
        return np.asarray(np.minimum(self.feasibility.log_probability(z) - self.highest, 0.0))

    def plug_in(self, x: Float[np.ndarray, "point dim"]) -> Values:
        """Return log L of the predicted interface plus the log probability that there is one."""
        return np.asarray(self.likelihood.plug_in(x) + self.log_feasibility(x))

    def roughly(self, x: Float[np.ndarray, "point dim"]) -> Values | None:
        """Return what `plug_in` returns, by `FieldLikelihood.nearby`, in a fraction of the time; None without that."""
        if self.likelihood.nearby is None:
            return None
        near = self.likelihood.nearby.log_likelihood(self.surrogate.mean(x))
        return np.asarray(near + self.log_feasibility(x))

    def gain(self, x: Float[np.ndarray, "point dim"], plug_in: Values) -> Values:
        """Return log E[L] - log L in closed form, by `plug_in` or `roughly`: what the surrogate's uncertainty adds."""
        return self.likelihood.gain(x, plug_in)

    def nearly_expected(self, x: Float[np.ndarray, "point dim"]) -> Values:
        """Return `plug_in` with its `gain`: what `expected` returns, but for what a parabola of log L misses."""
        values = self.plug_in(x)
        return np.asarray(values + self.gain(x, values))

    def roughly_expected(self, x: Float[np.ndarray, "point dim"]) -> Values | None:
        """Return `roughly` with its `gain`; None if there is no such way."""
        values = self.roughly(x)
        return None if values is None else np.asarray(values + self.gain(x, values))

    def expected(self, x: Float[np.ndarray, "point dim"], *, plug_in: Values | None = None) -> Values:
        """Return log E[L] over the fields possible for the surrogate plus the log probability of an interface.

        `plug_in` is that of the points, if they are draws of the posterior, or of a tempered one.
        """
        feasible = self.log_feasibility(x)
        plain = None if plug_in is None else plug_in - feasible
        return np.asarray(self.likelihood.expected(x, plug_in=plain) + feasible)


def hidden_shift(observations: Sequence[Observation], discrepancy: Discrepancy) -> float:
    """Return the shift of an observed interface that the noise hides, mm: the smallest of all conditions."""
    return min(noise_length(seen, discrepancy) for seen in observations)


def _tolerance(observations: Sequence[Observation], discrepancy: Discrepancy) -> float:
    """Return the remainder that the modes may leave, mm.

    The mean of the shifts along the axes is too much for a flat strip, which slides along itself unseen: with a share
    of that, means of five inputs of a field were 0.25 sd off, and 82, 50, 134 runs were made, not 60, 52, 57.
    """

    def of(shifts: tuple[float, ...]) -> float:
        return float(np.mean(np.square(shifts) ** -1.0) ** -0.5)

    return TOLERATED_REMAINDER * min(noise_length(seen, discrepancy, of=of) for seen in observations)


def learn(
    x: Float[np.ndarray, "run dim"],
    records: Sequence[RunRecord],
    space: ParameterSpace,
    observations: tuple[Observation, ...],
    discrepancy: Discrepancy,
    *,
    shared: bool = False,
) -> Knowledge:
    """Return what is learnt from these runs; nothing else matters. Modes may share a kernel (`FieldTraining`).

    Raises:
        TooFewRuns: too few runs succeeded.
        NoCommonPoints: interfaces that cannot be brought to common points, or only to points that are
            farther away than the noise hides.
    """
    ok = np.array([record.ok for record in records], bool)
    hidden = hidden_shift(observations, discrepancy)
    training = replace(training_of(x, records, space, [seen.condition for seen in observations]), shared=shared)
    surrogate = fit_field(training, tolerance=_tolerance(observations, discrepancy))
    likelihood = FieldLikelihood(surrogate, observations, discrepancy)
    if likelihood.inferred is not None:
        guess, hidden = hidden, hidden_shift(likelihood.known_observations, discrepancy)
        if hidden < guess:
            surrogate = fit_field(training, tolerance=_tolerance(likelihood.known_observations, discrepancy))
            likelihood = FieldLikelihood(surrogate, observations, discrepancy)
    what, error = "interfaces of the runs for a surrogate of the field", surrogate.registration_error
    value = f"common points {error:.3g} mm away from them, root mean square"
    expected = f"at most {hidden:.3g} mm, the shift of the interface that the local noise hides"
    remedy = "Let the simulator return more nodes, or nodes that are the same in all runs."
    require(not error > hidden, what, value, expected, remedy, NoCommonPoints)
    z = surrogate.warping.standardise(x)
    told = np.array([says_whether_runs_succeed(record) for record in records], bool)
    feasibility = learn_feasibility(z[told], ok[told])
    highest = float(feasibility.log_probability(z).max())
    return Knowledge(x, ok, likelihood, feasibility, highest)


@dataclass(frozen=True)
class PosteriorMove:
    """How far a posterior is from an earlier one: the largest shift of a mean, in standard deviations, the largest
    change of the logarithm of a standard deviation, and the effective sample size of the weights between the two, as a
    share.
    """

    shift: float
    width: float
    effective: float


@dataclass(frozen=True, eq=False)
class State:
    """The posterior after some runs, as particles of π_γ with three sets of normalised log weights.

    These are the weights of the posterior with the expected likelihood, of π_γ, and of the posterior as if the
    predicted interfaces were exact. log E[L] and log L of the predicted interfaces are those at the particles;
    `log_evidence_tempered` is log ∫ L^γ p dx of the latter, NaN if it is not known.
    """

    knowledge: Knowledge
    positions: Float[np.ndarray, "particle dim"]
    log_weights: Float[np.ndarray, " particle"]
    log_weights_tempered: Float[np.ndarray, " particle"]
    log_weights_plug_in: Float[np.ndarray, " particle"]
    log_expected: Float[np.ndarray, " particle"]
    log_plug_in: Float[np.ndarray, " particle"]
    log_evidence_tempered: float = math.nan

    @property
    def runs(self) -> int:
        return len(self.knowledge.x)

    @property
    def mean(self) -> Float[np.ndarray, " dim"]:
        """Mean of the particles, as `positions`."""
        return Weighted(self.positions, np.exp(self.log_weights)).mean

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        return Weighted(self.positions, np.exp(self.log_weights)).sd

    def moved(self, knowledge: Knowledge) -> PosteriorMove:
        """Return how far the posterior that `knowledge` leads to is from this one.

        The same particles are reweighted by the ratio of the two likelihoods. Two separate samples would differ by
        their noise, which in seven dimensions is larger than the shift to be measured.
        """
        log_weights = log_softmax(self.log_weights + knowledge.plug_in(self.positions) - self.log_plug_in)
        after = Weighted(self.positions, np.exp(log_weights))
        tiny = np.finfo(float).tiny
        sd = np.maximum(self.sd, tiny)
        return PosteriorMove(
            shift=float(np.abs((after.mean - self.mean) / sd).max()),
            width=float(np.abs(np.log(np.maximum(after.sd, tiny) / sd)).max()),
            effective=float(1.0 / (after.weights @ np.exp(log_weights - self.log_weights))),
        )


def training_of(
    x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord], space: ParameterSpace, conditions: Sequence[str]
) -> FieldTraining:
    """Return what the surrogate of the interface of some conditions is trained with: all runs that succeeded."""
    ok = np.array([record.ok for record in records], bool)
    good = [record for record in records if record.ok]
    interfaces = [{name: record.interfaces[name] for name in conditions} for record in good]
    return FieldTraining(x[ok], interfaces, _gradients(good, conditions, space.names), space.low, space.high)


def _gradients(
    records: Sequence[RunRecord], conditions: Sequence[str], inputs: Sequence[str]
) -> list[Mapping[str, Float[np.ndarray, "point xyz dim"]]] | None:
    """Return the sensitivities of each run by condition, inputs on the last axis; None unless all runs have all."""
    out: list[Mapping[str, Float[np.ndarray, "point xyz dim"]]] = []
    for record in records:
        found = record.sensitivities
        if any(name not in found.get(condition, {}) for condition in conditions for name in inputs):
            return None
        out.append({c: np.stack([found[c][name] for name in inputs], axis=-1) for c in conditions})
    return out


ROUGHLY = SMCSettings(rejuvenation_steps=6, zeta=0.5)
"""Settings of the sampler where such a likelihood leads near the posterior; moves by the exact one follow."""
PARTICLES = {1: 2000, 2: 2000, 3: 2000}
MANY_INPUTS_PARTICLES = 1200
DRAFT_PARTICLES = 600  # particles of a draft, whatever the number of inputs
TEMPERATURE = 0.5
"""γ of the sampled π_γ ∝ L^γ p; its particles are reweighted to the posterior, and runs are chosen from them."""
STREAM = 4  # keeps the random numbers of the active design apart from all others of the same seed


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
    """Yield particles from which the posterior may be reached, the quickest to get first. Those that a rough likelihood
    has moved from the last posterior can have a few that outweigh the rest by the exact one. Sampling the rough one
    from the prior then takes a fiftieth of the time of sampling the exact one.
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
