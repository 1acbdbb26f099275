"""The check of a posterior in an active design: which runs it asks for, and what they and earlier runs say.

The simulator's own scatter is what its interfaces do that no smooth function of the inputs explains: loose tolerances
of a solver, or a mesh that changes with the inputs, move the interface a little from run to run. The nuggets of the
modes' processes estimate by how much. The posterior is that of the mean response, which the surrogate smooths out of
all runs; but each run at a draw of it has a log-likelihood that scatters, which limits what a check can confirm.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from strandline.design.active import checking, coverage_runs
from strandline.design.active.checking import BatchCheck, LogRatios
from strandline.design.active.choice import Active, Losses
from strandline.design.active.coverage_runs import Surprise, points_elsewhere
from strandline.design.active.state import Knowledge, State
from strandline.foundations import one_thread
from strandline.parameters import ParameterSpace
from strandline.posterior import reweight, subset
from strandline.runs import RunRecord

PLACES, REPEATS = 64, 32
"""Most draws of the posterior, and runs imagined at each, that show what the scatter does to the log-likelihood."""
NEGLIGIBLE = 0.01
"""Share of the shift hidden by the noise below which the scatter changes no log-likelihood worth mentioning."""
SURE = 2.0  # standard errors by which a shift must stay within its tolerance
MOST = 0.3  # share of the variance of the log ratios that the scatter must explain to be the reason why they vary
MAD = 1.4826  # standard deviation of normal numbers over their median absolute deviation
_SEED = 11
MASS, NEAR = 0.95, 0.995
"""Runs lie inside the posterior, or near it, if they are in its densest part that has this mass."""
FEWEST_LEFT_OUT = 20  # fewest earlier runs inside the posterior that can check it, each predicted from the others
UNKNOWN = 10.0
"""Expected variance of the log-likelihood at a draw, above which its run is learnt from before a check. Of ten ridges,
five were certified wrongly without this, two with it."""
SHOWING = 500  # draws that show how far the posterior would move
Points = Float[np.ndarray, "run dim"]
New = Float[np.ndarray, "new dim"]


@dataclass(frozen=True)
class SimulatorNoise:
    """The simulator's own scatter, root mean square along the interface, mm, and its effect on the log-likelihood of a
    run.

    `hidden` is the shift of the interface that the noise hides, mm; `variance` that of the log-likelihood of repeated
    runs, mean over some draws of the posterior.
    """

    rms: float
    hidden: float
    variance: float

    @property
    def share(self) -> float:
        return self.rms / self.hidden

    @property
    def sd(self) -> float:
        return math.sqrt(self.variance)

    @property
    def words(self) -> str:
        size = f"{1e3 * self.rms:.2g} µm, {self.share:.2g} times the shift that the local noise hides"
        return f"the simulator's own scatter: {size}"

    @property
    def reason(self) -> str:
        """Why a check cannot confirm a posterior, with advice."""
        return (
            f"{self.words}, changes the log-likelihood of a run by {self.sd:.2g}, too much for a check to confirm the "
            "posterior: tighten the solver's tolerance or keep its mesh, average repeated runs, or state the scatter "
            "as part of the noise"
        )

    def prevents(self, *, draws: int, shift: float, effective: float, observed: float | None) -> bool:
        """Return whether a check of a right posterior fails for the scatter alone.

        `shift` and `effective` are tolerated, `observed` is the typical variance of the log ratios of a check, if any.
        """
        if observed is not None and not self.explains(observed):
            return False
        return math.exp(-self.variance) < effective or SURE * math.sqrt(self.variance / max(draws, 1)) > shift

    def explains(self, observed: float) -> bool:
        """Return whether it is the reason why log ratios vary, given their typical variance."""
        return self.variance > 0 and self.variance >= MOST * observed


NONE = SimulatorNoise(0.0, 1.0, 0.0)  # a simulator that does not scatter


def simulator_noise(knowledge: Knowledge, draws: Float[np.ndarray, "draw dim"]) -> SimulatorNoise:
    """Return the scatter that the runs show, and its effect at draws of the posterior.

    Runs are imagined there whose modes scatter independently. The effect is larger in the tails: for a check, give its
    own draws.
    """
    surrogate, likelihood, hidden = knowledge.surrogate, knowledge.likelihood, knowledge.hidden
    rms = surrogate.scatter
    if rms < NEGLIGIBLE * hidden:
        return SimulatorNoise(rms, hidden, 0.0)
    means = surrogate.mean(draws[:: max(len(draws) // PLACES, 1)][:PLACES])
    normal = np.random.default_rng(_SEED).standard_normal((REPEATS, means.shape[1]))
    runs = means[:, None] + normal * np.sqrt(surrogate.scatter_variances)
    with one_thread():
        values = likelihood.at(runs.reshape(-1, means.shape[1])).reshape(len(means), REPEATS)
    return SimulatorNoise(rms, hidden, float(np.mean(np.var(values, axis=1, ddof=1))))


def left_out_ratios(
    state: State,
    records: Sequence[RunRecord],
    log_likelihood: Callable[[RunRecord], float],
    log_prior: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]],
    *,
    mass: float = MASS,
) -> LogRatios:
    """Return log(true/predicted likelihood) of the runs inside the posterior, each predicted from all others.

    The prediction is that of the surrogate without the run, so the ratios are those of a worse surrogate than the one
    in use. They show how much the weights of a check would differ, not where the posterior would move. Runs inside the
    posterior's densest part of this `mass` count. Records are in the order of `state.knowledge.x`.
    """
    knowledge, likelihood = state.knowledge, state.knowledge.likelihood
    x = knowledge.x[knowledge.ok]
    density = state.log_expected + np.asarray(log_prior(state.positions))
    order = np.argsort(-density)
    within = np.cumsum(np.exp(state.log_weights)[order]) <= mass
    lowest = density[order[within]].min() if within.any() else density.max()
    inside = knowledge.expected(x) + np.asarray(log_prior(x)) >= lowest
    if not inside.any():
        return LogRatios(x[inside], np.empty(0), np.empty(0))
    good = [record for record in records if record.ok]
    true = np.array([log_likelihood(good[i]) for i in np.flatnonzero(inside)])
    log_expected, variances = likelihood.left_out(np.flatnonzero(inside))
    return LogRatios(x[inside], true - (log_expected + knowledge.log_feasibility(x[inside])), variances)


@dataclass(frozen=True, eq=False)
class Checked:
    """A check that goes on: the draws of `state` that run now, their expected log-likelihood, and all draws so far.

    The first `probing` draws are probes. The verdict is sought after these numbers of draws, `ends`, from the next one
    on; in all, `looks` times. `elsewhere` are inputs of runs where nobody has looked yet, `odd` what such runs before
    these have shown.
    """

    state: State
    draws: Float[np.ndarray, "now dim"]
    log_expected: Float[np.ndarray, " now"]
    drawn: Float[np.ndarray, "draw dim"]
    probing: int
    ends: tuple[int, ...]
    looks: int
    elsewhere: New
    odd: tuple[Surprise, ...] = ()


def _not_run(state: State) -> Float[np.ndarray, " particle"]:
    """Return the weights of the particles, zero where a run has been: particles are carried on from batch to batch, and
    a run that has been learnt from agrees with itself. The first of several copies, which are one run, has the weight
    of all. If all have been run, they are drawn again.
    """
    _, first, of_all = np.unique(state.positions, axis=0, return_index=True, return_inverse=True)
    weights = np.zeros(len(state.positions))
    weights[first] = np.bincount(of_all.ravel(), np.exp(state.log_weights))
    known = {row.tobytes() for row in state.knowledge.x}
    new = np.where([row.tobytes() in known for row in state.positions], 0.0, weights)
    return np.asarray(new / new.sum() if new.any() else weights)


class PosteriorChecker:
    """Asks for runs that check a posterior, `batch` at a time, and judges it by them.

    The design learns from each batch before the next is drawn, so that draws before it count with the error with which
    all other runs predict them. `log_likelihood` returns that of a successful record, by the true model.
    """

    def __init__(
        self,
        active: Active,
        space: ParameterSpace,
        *,
        batch: int,
        log_likelihood: Callable[[RunRecord], float],
        seed: int,
    ) -> None:
        self.active, self.space, self.batch, self.seed = active, space, batch, seed
        self.log_likelihood = log_likelihood
        self.scatter: SimulatorNoise = NONE
        self._checked: Checked | None = None
        self._observed: tuple[int, float | None] = (active.check, None)

    def begin(self, state: State, x: Points, left: int, losses: Losses) -> New:
        """Return the first draws of a check, and where nobody has looked yet; `left` is the number of runs left."""
        pool = self._pool(state)
        first = pool[checking.probes(state.positions[pool], checking.FEWEST_DRAWS)][:left]
        most = min(left, len(first) + self.active.check)
        elsewhere = points_elsewhere(x, self.space, self.active.unseen, left - most) if left > most else x[:0]
        if not losses.bears(elsewhere):
            elsewhere = points_elsewhere(x, self.space, self.active.unseen, left - most, losses.likely)
        ends, draws = checking.looks(len(first), most, self.batch), state.positions[first]
        expected, probing = state.log_expected[first], len(first)
        self._checked = Checked(state, draws, expected, draws, probing, ends, len(ends), elsewhere)
        return np.concatenate([draws, elsewhere])

    def more(self, state: State, odd: tuple[Surprise, ...]) -> New:
        """Return the next draws of a check that is still open, from the posterior that has learnt from those before.

        They are taken by equal strides from the densest particle to the tails: six hold one of the last sixth.
        """
        checked = self._checked
        assert checked is not None
        done, end = checked.ends[:2]
        order = np.argsort(-(state.log_expected + np.asarray(self.space.log_prior(state.positions))), kind="stable")
        stride = subset(_not_run(state)[order], end - done, self.seed + 7919 * done)
        chosen = np.unique(order[stride])
        draws, none = state.positions[chosen], checked.elsewhere[:0]
        now = replace(checked, state=state, draws=draws, log_expected=state.log_expected[chosen])
        drawn = np.concatenate([checked.drawn, draws])
        self._checked = replace(now, drawn=drawn, ends=checked.ends[1:], elsewhere=none, odd=odd)
        return np.asarray(draws)

    def unknown(self, state: State, most: int) -> New:
        """Return draws of a posterior whose log-likelihood the surrogate hardly knows, the least known one first, then
        each the farthest from those before, in sds.
        """
        pool = state.positions[self._pool(state)]
        variances = state.knowledge.likelihood.variances(pool)
        pool = pool[np.argsort(-variances, kind="stable")][: int((variances > UNKNOWN).sum())]
        z = pool / np.maximum(state.sd, np.finfo(float).tiny)
        nearest = np.where(np.arange(len(z)) > 0, np.linalg.norm(z - z[:1], axis=1), -1.0)
        return np.asarray(pool[[0, *islice(coverage_runs.farthest_first(z, nearest), most - 1)]] if len(pool) else pool)

    def _pool(self, state: State) -> Int[np.ndarray, " draw"]:
        return np.unique(subset(_not_run(state), checking.POOL, self.seed + 1))

    def verdict(
        self, x: Points, records: Sequence[RunRecord]
    ) -> tuple[BatchCheck | Literal["open"], tuple[Surprise, ...]]:
        """Return the verdict of a check's runs on the posterior they were drawn from, and what it did not expect."""
        checked = self._checked
        assert checked is not None
        by_input = {row.tobytes(): record for row, record in zip(x, records, strict=True)}
        draws, left_out, probing = self._told(checked, by_input)
        posterior, variances = self._shown(checked.state), checked.state.knowledge.likelihood.variances
        self.scatter = simulator_noise(checked.state.knowledge, draws.x)
        finite = draws.values[np.isfinite(draws.values)]
        # the variance is that of normal numbers: a few extremes change little
        observed = float((MAD * np.median(np.abs(finite - np.median(finite)))) ** 2) if len(finite) else 0.0
        self._observed = len(draws), observed
        found = checking.verdict(
            draws,
            posterior,
            self.active.tolerances,
            probing=probing,
            level=checking.error_probability(checked.looks - len(checked.ends), checked.looks),
            last=len(checked.ends) == 1,
            left_out=left_out,
            typical=float(variances(posterior).mean()),
            scatter=self.scatter.variance,
        )
        odd = (*checked.odd, *self.surprises(checked.elsewhere, x, records, checked.state))
        if isinstance(found, BatchCheck) and found.passed:
            return replace(found, passed=not odd, reasons=tuple(one.words(self.space) for one in odd[:1])), odd
        return found, odd if found == "open" else ()

    def once_learnt(self, found: BatchCheck, state: State) -> BatchCheck | Literal["open"]:
        """Return the verdict once the design has learnt: a passed check goes on if its runs moved the posterior."""
        checked, tolerances = self._checked, self.active.tolerances
        assert checked is not None
        moved = checked.state.moved(state.knowledge)
        if not found.passed or (moved.shift <= tolerances.shift and moved.width <= tolerances.width):
            return found
        if len(checked.ends) > 1:
            return "open"
        by = f"by {moved.shift:.2f} standard deviations, its width by {moved.width:.0%}"
        return replace(found, passed=False, reasons=(f"the last runs of the check moved the posterior ({by})",))

    def _told(self, checked: Checked, by_input: dict[bytes, RunRecord]) -> tuple[LogRatios, LogRatios, int]:
        """Return the log ratios of the draws so far, those of other runs near the posterior, and the number of probes.

        Draws that ran just now count against their prediction; those before, and other runs, against the prediction by
        all others. Runs that have not ended yet do not count, nor draws that are not near the posterior any more.
        """
        knowledge, drawn = checked.state.knowledge, checked.drawn
        learnt = [by_input[key] for row in knowledge.x if (key := row.tobytes()) in by_input]
        if len(learnt) == len(knowledge.x):
            near = self.near(checked.state, learnt)
        else:  # a cheaper model has been dropped, and its runs with it
            near = LogRatios(drawn[:0], np.empty(0), np.empty(0))
        keys = [row.tobytes() for row in drawn]
        runs = [by_input.get(key) for key in keys]
        counts = np.array([run is not None and not run.ok for run in runs])
        values, variances = np.full((2, len(keys)), np.nan)
        place = {key: i for i, key in enumerate(keys)}
        at = np.array([place.get(row.tobytes(), -1) for row in near.x], int)
        of_check = at >= 0
        values[at[of_check]], variances[at[of_check]] = near.values[of_check], near.variances[of_check]
        counts[at[of_check]] = True
        first = len(keys) - len(checked.draws)
        for i, run in enumerate(runs[first:]):
            if run is not None and run.ok:
                values[first + i], counts[first + i] = self.log_likelihood(run) - checked.log_expected[i], True
        variances[first:] = knowledge.likelihood.variances(checked.draws)
        return LogRatios(drawn, values, variances)[counts], near[~of_check], int(counts[: checked.probing].sum())

    def surprises(
        self, points: New, x: Points, records: Sequence[RunRecord], state: State | None, *, strictly: bool = False
    ) -> tuple[Surprise, ...]:
        """Return which runs at these points `state` did not expect, see `coverage_runs.surprises`.

        Without a state everything is expected. With `strictly`, errors count as for runs that the others predict.
        """
        wanted = {row.tobytes() for row in points}
        good = [k for k, row in enumerate(x) if row.tobytes() in wanted and records[k].ok]
        if not good or state is None:
            return ()
        made = [records[k] for k in good]
        true = np.array([self.log_likelihood(record) for record in made])
        strict = coverage_runs.LEFT_OUT_SDS, coverage_runs.LEFT_OUT_NOISE, coverage_runs.AROUND_SHARE
        limits = {"limits": strict} if strictly else {}
        return coverage_runs.surprises(state, x[good], made, true, self.active.unseen, state.knowledge.hidden, **limits)

    def left_out(self, state: State, looked_around: set[bytes], chosen: set[bytes]) -> tuple[Surprise, ...]:
        """Return the run that the others predict much worse than they should, once for each run.

        Runs do not count around which others were made already, nor those `chosen` on a posterior: inputs as bytes.
        """
        if self.active.unseen >= 1:
            return ()
        found = coverage_runs.left_out_surprise(state, state.knowledge.hidden, looked_around, chosen)
        return () if found is None else (found,)

    def without_runs(self, state: State, records: Sequence[RunRecord]) -> BatchCheck:
        """Return the verdict of an earlier analysis's runs, each against its prediction from all others."""
        inside = left_out_ratios(state, records, self.log_likelihood, self.space.log_prior)
        if len(inside) < FEWEST_LEFT_OUT:
            reason = f"only {len(inside)} of the available runs lie inside the posterior"
            return BatchCheck(len(inside), 0, None, False, (reason,))
        found = reweight(inside.x, inside.values)
        reasons = (*checking.objections(found, self.active.tolerances), *self._unsure(state))
        return BatchCheck(len(inside), 0, found, not reasons, reasons)

    def _unsure(self, state: State) -> tuple[str, ...]:
        """Return a reason if the surrogate's own variance weighs too much: left-out runs only test where runs are."""
        ratios = np.exp(state.log_weights - state.log_weights_plug_in)
        share = float(1.0 / (np.exp(state.log_weights_plug_in) @ ratios**2))
        if share >= self.active.effective:
            return ()
        left = f"only {share:.0%} effective draws, not {self.active.effective:.0%}"
        return (f"the surrogate's own uncertainty leaves {left}",)

    def near(self, state: State, records: Sequence[RunRecord]) -> LogRatios:
        """Return the runs near the posterior: a parabola reaches a little farther than the draws."""
        return left_out_ratios(state, records, self.log_likelihood, self.space.log_prior, mass=NEAR)

    def scatter_prevents(self, state: State) -> bool:
        """Return whether the simulator's own scatter keeps a posterior from passing; `scatter` then says how."""
        at = self._shown(state) if self._checked is None else self._checked.draws
        self.scatter = simulator_noise(state.knowledge, at)  # by all runs: few may mistake curvature for scatter
        draws, observed = self._observed
        limits = {"shift": self.active.tolerances.shift, "effective": self.active.effective}
        return self.scatter.prevents(draws=draws, observed=observed, **limits)

    def _shown(self, state: State) -> Float[np.ndarray, "draw dim"]:
        return np.asarray(state.positions[subset(np.exp(state.log_weights), SHOWING, self.seed + 2)])
