"""An active design for many inputs, with sensitivities: down to the best fit, then draws of the posterior.

The surrogate's best fit is run until a run lies there. All further runs are draws, predicted before they are run: half
of the posterior, half of the wider one with the root of its likelihood. Each batch is a check, and the surrogate learns
from it; earlier draws count with the errors with which all other runs predict them. Last come places where no run has
been, if the design is asked to look there.

Let δ be the logarithm of the true over the predicted likelihood. Weights exp(δ) move the mean of a quantity by its
covariance with δ. If δ has nothing to do with the quantity, n draws of the posterior show that its mean moves by no
more than 1.65 sd(δ)/√n of its standard deviations, with 95 % probability. Of the wider draws, those matter that the
true model likes more than predicted: their weights are the mass that the posterior misses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import norm

from strandline.design.active.active_design import ActiveDesign, Batch, Decision, Situation
from strandline.design.active.chains import WIDE, ChainState, Normalised
from strandline.design.active.checking import MOST_FAILED, BatchCheck
from strandline.design.active.choice import Active
from strandline.design.active.exact_draws import EFFECTIVE, ExactDraws, Expecting
from strandline.design.refinement import over_prior
from strandline.parameters import NormalScores, ParameterSpace
from strandline.runs import RunRecord

ARRIVED = 1.0  # distance of the best fit from a run, in sds of the Laplace approximation, up to which a run lies there
HALVED = 6  # times that the way to a best fit is halved where runs fail
TOGETHER = 4  # fewest runs of a batch: to sample the posterior takes as long as many of a cheap simulator
ALONE = 12  # the same of runs without sensitivities, which tell less
FEWEST = 12  # fewest draws of the posterior that can settle anything: with 8, that strip was off by 0.4 sds once in six
LARGEST_VARIANCE = 0.7  # largest variance of δ: half of the draws are effective
BOUND = 0.25  # largest shift of a mean, in sds, that the draws may leave possible
MISSED = 0.1  # largest share of the posterior's mass that wider draws may show to be missed
UNEXPECTED = 1.0  # log ratio above which a wider draw counts for this: with 0, scatter by 0.4 alone would show 16 %
PATIENT = 40  # draws after which those of the true posterior are considered
LOST = 0.25  # share of them that may fail
AFFORDED, SHARE = 60.0, 0.1
"""Seconds that their runs may take in all, as a certified field took 50 to 70 s beside its runs; share of the runs that
this estimate takes to be effective: of strips of 50 and 100 inputs, 30 to 80 in a hundred are."""
STEP, NARROWER = 0.3, 0.95
"""Differences along all directions, in prior sds; largest sd, in prior sds, along directions that the data inform."""
WIDER = 2  # one draw in so many is wider: with 4, a strip with a trap was certified wrong in one of six designs
SETTLING = FEWEST * WIDER  # fewest draws, wider ones included, with which a design can end
SURE = 5.0  # largest sd of δ with which they begin: that of the last surrogate, which has learnt, was 1 on 100 inputs
MIXED = 1.1  # largest R̂ of the chains whose draws can settle anything: with 1.2, a strip with a trap was off by one sd
WITHIN = 4.0  # a draw of an earlier posterior counts if its density is less than this many sds below the draws'


@dataclass(frozen=True, eq=False)
class Told:
    """Log ratios δ at draws of the posterior, at wider ones, the logarithms of the latter's weights, R̂ of the chains
    that the last ones are from, and how many of the last draws of the posterior were run and failed.
    """

    ratios: Float[np.ndarray, " draw"]
    wide: Float[np.ndarray, " wide"]
    wide_log: Float[np.ndarray, " wide"]
    r_hat: float = 1.0
    failed: int = 0
    drawn: int = 1

    @property
    def sd(self) -> float:
        return float(np.std(self.ratios, ddof=1)) if len(self.ratios) > 1 else np.inf

    @property
    def bound(self) -> float:
        """Shift of a mean that cannot be excluded, in its sds."""
        return float(norm.ppf(0.95) * self.sd / np.sqrt(max(len(self.ratios), 1)))

    @property
    def missed(self) -> float:
        """Mass of the true posterior at wider draws beyond that predicted, as a share of the predicted posterior's.

        A draw counts for no more than all of it: once it has run, the surrogate knows of it.
        """
        if not len(self.wide):
            return np.inf
        level = logsumexp(self.ratios) - np.log(len(self.ratios))
        with np.errstate(over="ignore"):
            beyond = np.where(self.wide - level > UNEXPECTED, np.expm1(self.wide - level), 0.0)
            return float(np.mean(np.minimum(np.exp(self.wide_log) * beyond, 1.0)))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the draws settle nothing yet, in words; none if they do."""
        if len(self.ratios) < FEWEST:
            return (f"only {len(self.ratios)} draw{'s' * (len(self.ratios) != 1)} so far",)
        reasons = []
        if self.failed > max(1.0, MOST_FAILED * self.drawn):
            reasons.append(self.losses)
        if self.sd**2 > LARGEST_VARIANCE:
            reasons.append(f"log-likelihoods differ from those predicted by {self.sd:.2g}, standard deviation")
        elif self.bound > BOUND:
            reasons.append(f"{len(self.ratios)} draws leave a shift of a mean by {self.bound:.2g} sds possible")
        if self.missed > MISSED:
            reasons.append(f"draws around the posterior show {self.missed:.0%} of its mass where none was predicted")
        if self.r_hat > MIXED:
            reasons.append(f"chains of the posterior do not agree (R̂ {self.r_hat:.2f})")
        return tuple(reasons)

    @property
    def losses(self) -> str:
        """How many draws of the posterior failed, in words."""
        return f"{self.failed} of {self.drawn} runs at draws of the posterior failed"

    @property
    def check(self) -> BatchCheck:
        """The draws as a check, passed if there are no reasons against it."""
        number, reasons = len(self.ratios), self.reasons
        sd, bound = (self.sd, self.bound) if number > 1 else (None, None)
        return BatchCheck(number, self.failed, None, not reasons, reasons, ratio_sd=sd, bound=bound)


def beside(
    x: Float[np.ndarray, " dim"], space: ParameterSpace, root: Float[np.ndarray, "dim dim"] | None = None
) -> Float[np.ndarray, "run dim"]:
    """Return inputs of which the differences from those given tell the slopes: along all directions, or, given a root
    of the posterior's covariance in normal scores, one of its sds along those in which it is narrower than the prior.
    """
    scores, dim = NormalScores(space), len(x)
    U, sds, _ = (np.eye(dim), STEP * np.ones(dim), None) if root is None else np.linalg.svd(root)
    steps = (U * sds)[:, sds < NARROWER]
    return scores.inputs(scores.places(x[None]) + steps.T)


def first_inputs(
    active: Active, space: ParameterSpace, number: int, scramble: int | None
) -> Float[np.ndarray, "run dim"]:
    """Return the inputs that an active design begins with: over the prior, and steps from the first for differences."""
    first = over_prior(space, number, scramble=scramble)
    return np.concatenate([first, beside(first[0], space)]) if active.differences else first


class InformedDesign(ActiveDesign):
    """Decides what to run next; see `ActiveDesign`."""

    told: Told | None = None
    exact: ExactDraws | None = None

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        self._wide: set[bytes] = set()

    def next(self, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> Batch | None:
        """Return the next batch, given all runs that have ended; None to stop."""
        if self.exact is not None:
            return self._further(self.exact, x, records)
        before, last = self.state, self.batches[-1]
        self.state = self.learn(x, records)
        if not isinstance(self.state, ChainState):
            self.reasons = ("not all runs have sensitivities by all inputs at points that all runs share",)
            return None
        check = None
        if last.kind == "check" and isinstance(before, ChainState):
            self.told = self._told(before, last, x, records)
            check = self.told.check
        if last.kind == "elsewhere":
            self._odd = self.check.surprises(last.points, x, records, before)
        self.steps.append(self._step(check))
        now = Situation(x, records, last.kind, check, False, self._left)
        for phase in INFORMED_PHASES:
            decision = phase(self, now)
            if not isinstance(decision, str):
                return decision
        state = self._sampled
        together = min(max(self._together, ALONE if self.active.differences else TOGETHER), now.left)
        beyond = together // WIDER
        number = together - beyond
        random = np.random.default_rng([self.seed, len(x)])
        chances = 0.9 * np.exp(state.log_weights) + 0.1 / len(state.positions)  # few may have nearly all the weight
        draws = random.choice(len(state.positions), number, replace=False, p=chances / chances.sum())
        wide = random.choice(len(state.wide), beyond, replace=False)
        return self._noted(np.concatenate([state.positions[draws], state.wide[wide]]), "check")

    @property
    def _seeks(self) -> bool:
        """Whether to look for a smaller share than the default one, which takes 25 runs with seven inputs."""
        return self.active.unseen < Active.unseen

    def overlooks(self, x: Float[np.ndarray, "run dim"]) -> bool:
        """Return whether it was to look elsewhere, and the runs were too few for that."""
        return self._seeks and super().overlooks(x)

    @property
    def _sampled(self) -> ChainState:
        return cast(ChainState, self._posterior)

    def _settle(self, now: Situation) -> Decision:
        """Stop at a posterior that has passed its check, unless its draws are to be those of the true model, or there
        are places where nobody has looked.
        """
        if now.kind == "elsewhere":
            passed = not self._odd and not self.active.exact
        else:
            passed = now.check is not None and now.check.passed and not self.active.exact
        if not passed:
            return "not now"
        looks = self._seeks and now.kind == "check" and now.left > 0
        unseen = self._not_looked_at(now.x, now.left) if looks else now.x[:0]
        if len(unseen):
            return self._noted(unseen, "elsewhere")
        self.converged, self.reasons = True, ()
        return None

    def _draw_exactly(self, now: Situation) -> Decision:
        """Begin to draw from the true posterior, if that is asked for, or affordable where nothing has settled."""
        if self.told is None or self.active.exact is False or self.told.sd > SURE:
            return "not now"
        drawn = sum(len(batch.points) for batch in self.batches if batch.kind == "check")
        ready = not self.told.reasons if self.active.exact else drawn >= PATIENT
        if not (ready or now.left < 1):
            return "not now"
        seconds = np.median([record.seconds for record in now.records if record.ok]) / self.batch
        if not self.active.exact and EFFECTIVE / SHARE * seconds > AFFORDED:
            return "not now"
        normal = Expecting(self.space, self._sampled.knowledge)
        self.exact = ExactDraws.of(self._sampled, normal, (self.seed, len(now.x)))
        return self._noted(self.exact.propose(), "exact")

    def _further(
        self, exact: ExactDraws, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]
    ) -> Batch | None:
        """Weigh the last draws; return the next ones, None if there are enough."""
        made = {row.tobytes(): record for row, record in zip(x, records, strict=True)}
        found = [made[row.tobytes()] for row in self.batches[-1].points]
        exact.take(np.array([self.check.log_likelihood(one) if one.ok else -np.inf for one in found]))
        if exact.done:
            self.converged, self.reasons = True, ()
            return None
        if exact.hopeless:
            self.reasons = (f"draws of the true posterior have not settled: {exact.words}",)
            return None
        return self._noted(exact.propose(), "exact")

    def _lose(self, now: Situation) -> Decision:
        """Stop once a quarter of the draws have failed: the surrogate of many inputs does not learn where runs fail."""
        told = self.told
        if told is None or told.drawn < PATIENT or told.failed < LOST * told.drawn:
            return "not now"
        self.reasons = (told.losses,)
        return None

    def _descend(self, now: Situation) -> Decision:
        """Run the best fit, or, after failed runs, half of the way to it from the nearest good one, a quarter, …"""
        state, failed = self._sampled, 0
        while failed < len(now.records) and not now.records[-1 - failed].ok:
            failed += 1
        begun = any(batch.kind == "check" for batch in self.batches)
        if state.off <= ARRIVED or begun or failed > HALVED:
            return "not now"
        normal, known = Normalised(self.space, state.knowledge), state.knowledge
        mode, runs = normal.places(state.mode[None])[0], normal.places(known.x[known.ok])
        away = np.linalg.norm(np.linalg.solve(state.root, (runs - mode).T), axis=0)
        nearest = runs[int(away.argmin())]
        there = normal.inputs((nearest + 0.5**failed * (mode - nearest))[None])
        if self.active.differences and not failed:
            there = np.concatenate([there, beside(there[0], self.space, state.root)])
        return self._noted(there, "posterior")

    def _told(
        self, before: ChainState, last: Batch, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]
    ) -> Told:
        """Return what the draws so far say: the last ones by their prediction, earlier ones by that of all others.

        Draws of an earlier posterior count if they lie in this one, wider ones always.
        """
        state = self._sampled
        knowledge, good = state.knowledge, [record for record in records if record.ok]
        runs = knowledge.x[knowledge.ok]
        places = {row.tobytes(): k for k, row in enumerate(runs)}
        now = [row.tobytes() for row in last.points if row.tobytes() in places]
        narrow, wide = ({row.tobytes(): k for k, row in enumerate(one)} for one in (before.positions, before.wide))
        self._wide |= {key for key in now if key not in narrow}
        drawn = [row.tobytes() for batch in self.batches if batch.kind == "check" for row in batch.points]
        drawn = [key for key in drawn if key not in self._wide and key not in wide]
        lost = {row.tobytes() for row in knowledge.x[~knowledge.ok]}
        failed = sum(key in lost for key in drawn), max(len(drawn), 1)
        told = _Ratios()
        for key in now:
            true = self.check.log_likelihood(good[places[key]])
            if key in narrow:
                told.narrow.append(true - before.log_expected[narrow[key]])
            else:
                told.wide(true - before.wide_expected[wide[key]], before.wide_log[wide[key]])
        earlier = [row.tobytes() for batch in self.batches[:-1] if batch.kind == "check" for row in batch.points]
        at = np.array([places[key] for key in earlier if key in places], int)
        if not len(at):
            return told.all(before.r_hat, failed)
        left_out = knowledge.likelihood.left_out(at)[0] + knowledge.log_feasibility(runs[at])
        predicted = knowledge.expected(runs[at])
        densities = state.log_expected + self.space.log_prior(state.positions)
        inside = predicted + self.space.log_prior(runs[at]) >= densities.mean() - WITHIN * densities.std()
        for k, place in enumerate(at):
            ratio = self.check.log_likelihood(good[place]) - left_out[k]
            if runs[place].tobytes() in self._wide:
                told.wide(ratio, state.wide_level + (1 - WIDE) * predicted[k])
            elif inside[k]:
                told.narrow.append(ratio)
        return told.all(before.r_hat, failed)


@dataclass
class _Ratios:
    """Log ratios as they are found."""

    narrow: list[float] = field(default_factory=list)
    of_wide: list[float] = field(default_factory=list)
    logs: list[float] = field(default_factory=list)

    def wide(self, ratio: float, log_weight: float) -> None:
        self.of_wide.append(ratio)
        self.logs.append(log_weight)

    def all(self, r_hat: float, failed: tuple[int, int]) -> Told:
        return Told(np.array(self.narrow), np.array(self.of_wide), np.array(self.logs), r_hat, *failed)


INFORMED_PHASES: tuple[Callable[[InformedDesign, Situation], Decision], ...] = (
    InformedDesign._settle,
    InformedDesign._draw_exactly,
    ActiveDesign._give_up,
    InformedDesign._lose,
    InformedDesign._descend,
)
"""What the design may do after a batch besides drawing more: the first one ready decides."""
