"""The posterior of many inputs, by chains in their normal scores.

The chains start from draws of the Laplace approximation at the mode, which Gauss–Newton steps on the surrogate reach.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp
from scipy.stats import multivariate_normal

from strandline.design.active.state import STREAM, Knowledge, State
from strandline.foundations import one_thread
from strandline.parameters import NormalScores, ParameterSpace
from strandline.smc import LEAPS, Chains, SMCResult, StepInfo, hamiltonian, joined

CHAINS = 48  # chains side by side: the first half of the posterior, the others of one with the root of the likelihood
WARM, KEPT, EVERY = 20, 75, 3
"""Steps before draws count, twice, and after, and how many of these there are to a draw."""
MOST_LEAPS, AGREED = 64, 1.1
"""Most leaps of a move, which are doubled until the chains agree, as curved valleys ask, and the R̂ then."""
AVERAGED = 12
"""Draws over which the Gauss–Newton Hessian is averaged. With that at the mode alone, chains of the strip of 100 inputs
had a quarter of the effective draws, and those of one with 10 a thirteenth."""
WIDE = 0.5  # power of the likelihood in the second half of the chains, which look beyond the posterior
FAR = 20.0  # longest Gauss–Newton step, in sds of the Laplace approximation there
STEPS, STILL = 20, 1e-3
"""Most Gauss–Newton steps, and the length below which they have arrived."""
PART, MOST_PARTS = 50, 12
"""Steps between two looks at the chains of the final posterior, and most of these."""
R_HAT, EFFECTIVE = 1.02, 3000.0
"""Largest R̂ and fewest effective draws of the worst input with which they end."""
BRIDGED, LEAST = 50, 1e-9
"""Iterations of the bridge; least variance of its normal distribution."""

Points = Float[np.ndarray, "point dim"]


@dataclass(frozen=True, eq=False)
class Normalised(NormalScores):
    """Surrogate and prior as functions of the inputs' normal scores."""

    knowledge: Knowledge
    powers: Float[np.ndarray, " chain"] | float = 1.0

    def log_likelihood(self, coefficients: Float[np.ndarray, "point mode"]) -> Float[np.ndarray, " point"]:
        likelihood = self.knowledge.likelihood
        near = likelihood.nearby
        return likelihood.at(coefficients) if near is None else np.asarray(near.log_likelihood(coefficients))

    def log_density(self, u: Points) -> Float[np.ndarray, " point"]:
        x = self.inputs(u)
        return np.asarray(self.powers * self.roughly(x) - 0.5 * (u**2).sum(axis=1))

    def roughly(self, x: Points) -> Float[np.ndarray, " point"]:
        """Return the logarithm of the likelihood that the chains sample."""
        return np.asarray(self.log_likelihood(self.knowledge.surrogate.mean(x)) + self.knowledge.log_feasibility(x))

    def force(self, u: Points) -> Points:
        x = self.inputs(u)
        coefficients, by_inputs = self.knowledge.surrogate.mean_with_slopes(x)
        pull = by_inputs(self.knowledge.likelihood.parabola.parabolas(coefficients).slopes)
        return np.asarray(self.pulled(pull, u, x) * np.broadcast_to(self.powers, len(u))[:, None] - u)

    def curvature(self, u: Float[np.ndarray, " dim"]) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, "dim dim"]]:
        """Return the force at a point, and the Gauss–Newton Hessian of minus the log density there."""
        x = self.inputs(u[None])
        J, slopes, information = self._parabola(x)
        J = self.pulled(J, u[None], x)
        return J.T @ slopes - u, J.T @ information @ J + np.eye(len(u))

    def information(self, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
        """Return the Gauss–Newton Hessian of minus the log-likelihood by the inputs."""
        J, _, information = self._parabola(x[None])
        return np.asarray(J.T @ information @ J)

    def _parabola(self, x: Points) -> tuple[Any, Any, Any]:
        """Return derivatives of the coefficients at a point, and of the log-likelihood by them."""
        surrogate = self.knowledge.surrogate
        coefficients, _ = surrogate.mean_with_slopes(x)
        modes = coefficients.shape[1]
        _, by_inputs = surrogate.mean_with_slopes(np.repeat(x, modes, axis=0))
        near = self.knowledge.likelihood.parabola.parabolas(coefficients)
        return by_inputs(np.eye(modes)), near.slopes[0], near.information[0]

    def mode(self, u: Float[np.ndarray, " dim"]) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, "dim dim"]]:
        """Return the mode that Gauss–Newton steps from u lead to, and a root of the Laplace covariance there."""
        for _ in range(STEPS):
            force, H = self.curvature(u)
            step = np.linalg.solve(H, force)
            length = float(np.sqrt(step @ H @ step))
            step *= min(1.0, FAR / max(length, 1e-300))
            here = self.log_density(u[None])[0]
            for share in (1.0, 0.5, 0.25, 0.1):
                if self.log_density((u + share * step)[None])[0] > here:
                    break
            else:
                break
            u = u + share * step
            if length < STILL:
                break
        return u, root_of(self.curvature(u)[1])


def root_of(information: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return a root of the inverse."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(information).T, np.eye(len(information))))


@dataclass(frozen=True, eq=False)
class ChainState(State):
    """A posterior sampled by chains: its mode, how far that is from the nearest run, in sds, and the chains' R̂.

    `wide` are draws of the posterior with the likelihood's root, `wide_expected` their log-likelihood, and `wide_log`
    the logarithms of their weights in the posterior, of mean 1: `wide_level` plus half of that. `root` is a root
    of the inverse of the mean Gauss–Newton Hessian, in normal quantiles, `last` where the chains ended, after moves of
    so many `leaps` of this `step`.
    """

    mode: Float[np.ndarray, " dim"] = field(kw_only=True)
    off: float = field(kw_only=True)
    r_hat: float = field(kw_only=True)
    wide: Float[np.ndarray, "wide dim"] = field(kw_only=True)
    wide_expected: Float[np.ndarray, " wide"] = field(kw_only=True)
    wide_level: float = field(kw_only=True)
    last: Float[np.ndarray, "chain dim"] = field(kw_only=True)
    root: Float[np.ndarray, "dim dim"] = field(kw_only=True)
    step: float = field(kw_only=True)
    leaps: int = field(kw_only=True)

    @property
    def wide_log(self) -> Float[np.ndarray, " wide"]:
        return np.asarray(self.wide_level + (1 - WIDE) * self.wide_expected)


def sample_by_chains(
    knowledge: Knowledge, space: ParameterSpace, seed: int, number: int, before: State | None
) -> tuple[SMCResult, float]:
    """Return up to `number` draws of the posterior, as many as are effective, and R̂; the chains start from `before`."""
    random, normal = np.random.default_rng([seed, STREAM, 1]), Normalised(space, knowledge)
    with one_thread():
        state = before if isinstance(before, ChainState) else chain_state(knowledge, space, (seed,), None)
        u, step = normal.places(state.last)[: CHAINS // 2].repeat(2, axis=0), state.step
        run = partial(hamiltonian, normal.log_density, normal.force, root=state.root, random=random, steps=PART)
        parts: list[Chains] = []
        while len(parts) <= MOST_PARTS:
            one = run(start=u, step=step, leaps=state.leaps, adapt=not parts)
            u, step = one.last, one.step
            parts.append(one)
            found = Chains.joined(parts[1:] or parts)
            if len(parts) > 1 and found.r_hat <= R_HAT and found.effective >= EFFECTIVE:
                break
        return drawn_result(normal, found, random, number), found.r_hat


def drawn_result(
    normal: Normalised,
    found: Chains,
    random: np.random.Generator,
    number: int | None = None,
    true: tuple[Float[np.ndarray, "step chain"], Float[np.ndarray, "step chain"]] | None = None,
) -> SMCResult:
    """Return draws of chains, in two halves of independent ones: all, or up to `number` and as many as are effective.

    `true` are the log-likelihoods of another model and their excess over the chains', which weighs the draws; those of
    no likelihood are left out. The evidence is that of a bridge (Meng and Wong, Statistica Sinica 6, 1996, 831) to a
    normal distribution with the mean of the other half's draws, and their covariance, less their correlations if they
    are few.
    """
    steps, chains, _ = found.draws.shape
    every = 1 if number is None else max(-(-steps * chains // max(int(min(number, found.effective)), 1)), 1)

    def half(k: int, of: Float[np.ndarray, "step chain *dim"]) -> Any:
        return np.concatenate(list(of[:, k::2].swapaxes(0, 1)))[::every]

    halves = [half(k, found.draws) for k in (0, 1)]
    x = [normal.inputs(one) for one in halves]
    logs = [normal.roughly(one) for one in x]
    densities = [log - 0.5 * (u**2).sum(axis=1) for log, u in zip(logs, halves, strict=True)]
    pairs = zip(halves, densities, halves[::-1], strict=True)
    evidence = float(np.mean([_bridge(normal, *one, random) for one in pairs]))
    results = []
    for k in (0, 1):
        excess = np.zeros(len(x[k])) if true is None else half(k, true[1])
        values, some = logs[k] if true is None else half(k, true[0]), np.isfinite(excess)
        at, of_all = x[k][some], evidence + float(logsumexp(excess)) - np.log(len(excess))
        weights = log_softmax(excess[some])
        effective = float(np.exp(-logsumexp(2 * weights)))
        step = StepInfo(1.0, effective, found.accepted, False, of_all, 1.0)
        prior, number_of = normal.space.log_prior(at), steps * chains // 2
        results.append(SMCResult(at, weights, values[some], prior, of_all, effective, (step,), number_of))
    return joined(*results)


def _bridge(
    normal: Normalised,
    u: Points,
    log_density: Float[np.ndarray, " point"],
    other: Float[np.ndarray, "other dim"],
    random: np.random.Generator,
) -> float:
    """Return the logarithm of the integral of the density, from draws of it."""
    covariance, few = np.cov(other.T), min(1.0, u.shape[1] / len(other))  # of few draws, it is singular
    covariance += few * (np.diag(np.diag(covariance)) - covariance) + LEAST * np.eye(u.shape[1])
    near: Any = multivariate_normal(other.mean(axis=0), covariance)
    from_near = near.rvs(len(u), random_state=random)
    ours, theirs = log_density - near.logpdf(u), normal.log_density(from_near) - near.logpdf(from_near)
    log_ratio = float(np.median(ours))
    for _ in range(BRIDGED):
        up = logsumexp(-np.logaddexp(0.0, log_ratio - theirs))
        down = logsumexp(-np.logaddexp(ours, log_ratio))
        log_ratio = float(up - down)
    return float(log_ratio - 0.5 * u.shape[1] * np.log(2 * np.pi))


def chain_state(knowledge: Knowledge, space: ParameterSpace, seed: tuple[int, ...], before: State | None) -> ChainState:
    """Return the posterior that `knowledge` leads to; the same arguments give the same result to the bit."""
    random = np.random.default_rng([*seed, STREAM])
    normal = Normalised(space, knowledge)
    with one_thread():
        runs = normal.places(knowledge.x[knowledge.ok])
        best = runs[int(np.argmax(normal.log_density(runs)))]
        mode, root = normal.mode(best)
        away = np.linalg.solve(root, (runs - mode).T)
        off = float(np.linalg.norm(away, axis=0).min())
        earlier = before if isinstance(before, ChainState) else None
        start = mode + random.standard_normal((CHAINS, space.dim)) @ root.T
        if earlier is not None and earlier.off < 1.0:
            start = normal.places(earlier.last)
        both = Normalised(space, knowledge, np.repeat([1.0, WIDE], CHAINS // 2))
        warm = hamiltonian(both.log_density, both.force, start, root, random, steps=WARM, step=0.2, adapt=True)
        root = root_of(np.mean([normal.curvature(one)[1] for one in warm.last[:AVERAGED]], axis=0))
        warm = hamiltonian(both.log_density, both.force, warm.last, root, random, steps=WARM, step=0.4, adapt=True)
        found, leaps = warm, LEAPS if earlier is None else max(earlier.leaps // 4, LEAPS // 2)
        while found is warm or (found.only(slice(CHAINS // 2)).r_hat > AGREED and leaps < MOST_LEAPS):
            leaps *= 2
            found = hamiltonian(
                both.log_density, both.force, found.last, root, random, steps=KEPT, step=warm.step, leaps=leaps
            )
        narrow, wide = (found.only(part) for part in (slice(CHAINS // 2), slice(CHAINS // 2, CHAINS)))
        x, beyond = (normal.inputs(one.draws[::EVERY].reshape(-1, space.dim)) for one in (narrow, wide))
        roughly, exact = normal.roughly(x), knowledge.plug_in(x)
        expected, outside = (knowledge.expected(at, plug_in=by) for at, by in ((x, exact), (beyond, None)))
    equal = np.full(len(x), -np.log(len(x)))
    return ChainState(
        knowledge,
        x,
        log_softmax(expected - roughly),
        equal,
        log_softmax(exact - roughly),
        expected,
        exact,
        mode=normal.inputs(mode[None])[0],
        off=off,
        r_hat=narrow.r_hat,
        last=normal.inputs(found.last),
        step=found.step,
        wide=beyond,
        wide_expected=outside,
        root=root,
        leaps=leaps,
        wide_level=float(np.log(len(beyond)) - logsumexp((1 - WIDE) * outside)),
    )
