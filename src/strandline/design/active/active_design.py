"""An active design: batches of runs chosen on the posterior so far, a check on the true model, and when to stop.

The posterior is updated after each batch. Once a batch hardly moves it, the true model is run at draws from it, whose
log-likelihoods are predicted before. The design learns from these runs as from all others, and stops when the last
ones, and those before them left out, agree with what was predicted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from strandline.design.active.checking import FEWEST_DRAWS, BatchCheck
from strandline.design.active.choice import EXPLORATION, LARGEST_BATCH, Active, Losses, choose, price_of_a_hang
from strandline.design.active.coverage_runs import Surprise, points_around, points_elsewhere
from strandline.design.active.posterior_check import PosteriorChecker
from strandline.design.active.state import PosteriorMove, State
from strandline.design.refinement import over_prior
from strandline.parameters import ParameterSpace
from strandline.posterior import subset
from strandline.runs import RunRecord

Kind = Literal["given", "initial", "posterior", "elsewhere", "check", "trial", "exact"]
KINDS: dict[Kind, str] = {
    "given": "from an earlier analysis",
    "initial": "to begin with",
    "posterior": "chosen where the posterior lies",
    "elsewhere": "where the surrogate was contradicted or no run had looked",
    "check": "to check it, at draws of the posterior and elsewhere",
    "trial": "to try the correction of the cheaper model again",
    "exact": "to draw from the true posterior",
}
"""Kinds of batches, with what a report says of their runs, in its order."""
FEW_INPUTS, HARDLY = 3, 0.3
"""Number of inputs above which runs are chosen among draws of the posterior itself once it hardly moves: no mean by so
many standard deviations, no logarithm of a standard deviation by as much."""
BATCH_SHARE = 0.05
"""Runs of a batch as a share of the runs so far, if no number is stated and this is more than that of workers."""
TRIAL = 3  # further draws of a posterior at which the model runs if there are doubts about it
UNKNOWN = 5  # most batches at draws that the surrogate hardly knows: it may never, if the simulator scatters
FEWEST_EFFECTIVE = 0.2  # share of the draws that must be effective after the last batch for a check to begin
STILL = 0.05  # largest change of a posterior that is still the one that a check has passed
DIFFERENT = 0.4  # change of a mean, in sds, or of the logarithm of an sd, that two samples of one posterior do not show


@dataclass(frozen=True, eq=False)
class Batch:
    """Inputs that were run together (run, dim), and their purpose."""

    points: Float[np.ndarray, "run dim"]
    kind: Kind


@dataclass(frozen=True, eq=False)
class Step:
    """The posterior after a batch, from `runs` runs of which `ok` succeeded.

    `error` is that of the predicted interface, mm, root mean square along it, median over the posterior. `moved` is the
    distance from the last step, of `since` runs, that had fewer by at least the number of inputs, or half of it if runs
    yield derivatives; None if there is none since the last check. `check` is the result of the batch if it was one; it
    concerns the posterior before the batch.
    """

    runs: int
    ok: int
    kind: Kind
    mean: Float[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]
    error: float
    moved: PosteriorMove | None
    since: int | None
    check: BatchCheck | None


@dataclass(frozen=True, eq=False)
class Situation:
    """Where a design stands after a batch: the verdict on the posterior, if there is one, whether only doubts speak
    against it, and the number of runs left.
    """

    x: Float[np.ndarray, "run dim"]
    records: Sequence[RunRecord]
    kind: Kind
    check: BatchCheck | None
    doubted: bool
    left: int


Decision = Batch | None | Literal["not now"]  # the next batch, None to stop, or that another phase decides


class ActiveDesign:
    """Decides what to run next, `batch` runs at a time, given the runs so far.

    `learn` returns the posterior, given inputs and their records, `log_likelihood` that of a successful record by the
    true model. `afresh` samples a posterior again, from the prior, before it is checked. `doubts` returns what else
    speaks against a posterior that its check has passed, in words; `another_trial` whether runs at further draws of it
    could remove these doubts. `scramble` is the seed of the Sobol sequence of the first runs, None for the plain one.
    """

    def __init__(
        self,
        active: Active,
        space: ParameterSpace,
        *,
        batch: int,
        learn: Callable[[Float[np.ndarray, "run dim"], Sequence[RunRecord]], State],
        log_likelihood: Callable[[RunRecord], float],
        afresh: Callable[[State], State] = lambda state: state,
        seed: int,
        scramble: int | None = None,
        doubts: Callable[[State], tuple[str, ...]] = lambda state: (),
        another_trial: Callable[[], bool] = lambda: False,
    ) -> None:
        self.active, self.space, self.batch, self.seed, self.scramble = active, space, batch, seed, scramble
        self.learn, self.afresh, self.doubts, self.another_trial = learn, afresh, doubts, another_trial
        self.check = PosteriorChecker(active, space, batch=batch, log_likelihood=log_likelihood, seed=seed)
        self.batches: list[Batch] = []
        self.steps: list[Step] = []
        self.state: State | None = None
        self.converged = False
        self.reasons: tuple[str, ...] = ()
        self.besides = 0
        self._remembered: list[State] = []
        self._odd: tuple[Surprise, ...] = ()
        self._looked_around: set[bytes] = set()
        self._passed: tuple[State, BatchCheck] | None = None
        self._around_odd = False
        self._unknown = 0
        self._price = 1.0
        self.scattered = False

    def start(self, points: Float[np.ndarray, "run dim"], *, given: bool = False) -> None:
        """Record the first runs; `given` runs come from an earlier analysis and do not count towards the budget."""
        self.batches.append(Batch(points, "given" if given else "initial"))

    def more_of_the_first(self) -> Batch | None:
        """Return a further batch of the Sobol sequence because too few runs succeeded; None if no runs are left."""
        asked = sum(len(batch.points) for batch in self.batches)
        number = min(self.batch, self.active.runs - asked - self.besides)
        if number < 1:
            return None
        points = over_prior(self.space, asked + number, scramble=self.scramble)[asked:]
        return self._noted(points, "initial")

    def next(self, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> Batch | None:
        """Return the next batch, given all runs that have ended; None to stop."""
        self._price = price_of_a_hang(records)
        found = self._verdict(x, records)
        self.state = self.learn(x, records)
        if isinstance(found, BatchCheck):
            found = self.check.once_learnt(found, self.state)
        if found == "open":
            return self._noted(self.check.more(self.state, self._odd), "check")
        check, doubted = self._judged(found, records)
        self.steps.append(self._step(check))
        now = Situation(x, records, self.batches[-1].kind, check, doubted, self._left)
        for phase in self.phases:
            decision = phase(self, now)
            if not isinstance(decision, str):
                return decision
        room = self._room(now)
        return self._noted(self._chosen(min(self._together, room if room > 0 else now.left), len(now.x)), "posterior")

    def _verdict(
        self, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]
    ) -> BatchCheck | Literal["open"] | None:
        """Return what a check says of the posterior that it was made of; note what no posterior expected."""
        batch = self.batches[-1]
        if batch.kind == "elsewhere":
            self._odd = self.check.surprises(batch.points, x, records, self.state)
            if self._around_odd and self.check.surprises(batch.points, x, records, self.state, strictly=True):
                self._passed = None
        if batch.kind != "check":
            return None
        found, self._odd = self.check.verdict(x, records)
        return found

    @property
    def phases(self) -> "tuple[Callable[[Any, Situation], Decision], ...]":
        """What may be done after a batch besides learning where the posterior lies; the first one ready decides."""
        return PHASES

    @property
    def _posterior(self) -> State:
        """The posterior so far, after the first call of `next`."""
        assert self.state is not None
        return self.state

    def _judged(self, check: BatchCheck | None, records: Sequence[RunRecord]) -> tuple[BatchCheck | None, bool]:
        """Return the check that the new posterior has passed or not, and whether only doubts speak against it."""
        kind = self.batches[-1].kind
        if kind == "trial" or (kind == "elsewhere" and not self._odd):
            check = self._still_passed()
        if check is not None and check.passed:
            chosen = {row.tobytes() for batch in self.batches if batch.kind == "posterior" for row in batch.points}
            chosen -= {row.tobytes() for row in over_prior(self.space, self._posterior.runs + EXPLORATION)}
            self._odd = self.check.left_out(self._posterior, self._looked_around, chosen)
            if self._odd:
                self._passed = self._posterior, check
                check = replace(check, passed=False, reasons=(self._odd[0].words(self.space),))
        if kind == "given":
            check = self.check.without_runs(self._posterior, records)
        if check is not None and check.passed and (why := self.doubts(self._posterior)):
            self._passed = self._posterior, check
            return replace(check, passed=False, reasons=why), True
        return check, False

    def _finish(self, now: Situation) -> Decision:
        """Stop at a posterior that has passed its check, unless there are places where nobody has looked."""
        if now.check is None or not now.check.passed:
            return "not now"
        unseen = self._not_looked_at(now.x, now.left) if now.left > 0 and now.kind != "given" else now.x[:0]
        if len(unseen):
            self._passed, self._around_odd = (self._posterior, now.check), False
            return self._noted(unseen, "elsewhere")
        self.converged, self.reasons = True, ()
        return None

    def _give_up(self, now: Situation) -> Decision:
        if now.left > 0:
            return "not now"
        self.reasons = self._why_not()
        return None

    def _try_again(self, now: Situation) -> Decision:
        """Run the model at further draws of a posterior against which only doubts speak."""
        ready = now.doubted and now.kind != "given" and now.left >= TRIAL
        if not (ready and self.another_trial()):
            return "not now"
        draws = subset(np.exp(self._posterior.log_weights), TRIAL, self.seed + 7919 * len(now.x))
        return self._noted(self._posterior.positions[draws], "trial")

    def _look_around(self, now: Situation) -> Decision:
        """Run the model around runs that no posterior expected."""
        if not self._odd:
            return "not now"
        odd, number = np.array([one.x for one in self._odd]), max(self.batch, 2 * self.space.dim)
        self._looked_around |= {one.x.tobytes() for one in self._odd}
        around = points_around(odd, now.x, self.space, self.active.unseen, min(number, now.left))
        around = self._losses().bearable(around)
        self._around_odd = True
        return self._noted(around, "elsewhere") if len(around) else "not now"

    def _check(self, now: Situation) -> Decision:
        """Run the model at draws of a posterior that hardly moves, or of any if no more runs may be chosen.

        Before that, the surrogate learns from those draws that it hardly knows.
        """
        room = self._room(now)
        ready = (self._rests and (now.check is None or now.kind == "given") and room >= 0) or room < 1
        if not (ready and self._can_be_checked(now.left) and (self._confirmed() or room < 1)):
            return "not now"
        unknown = self.check.unknown(self._posterior, min(self._together, room)) if room > 0 else now.x[:0]
        if len(unknown := self._losses().bearable(unknown)) and self._unknown < UNKNOWN:
            self._unknown += 1
            return self._noted(unknown, "posterior")
        return self._noted(self.check.begin(self._posterior, now.x, now.left, self._losses()), "check")

    def _room(self, now: Situation) -> int:
        """Return the number of runs that are left besides those of a check."""
        return now.left - self.active.kept_for_check

    def overlooks(self, x: Float[np.ndarray, "run dim"]) -> bool:
        """Return whether these runs are too few to find a region as small as asked, other than where runs fail."""
        return len(self._not_looked_at(x, 1)) > 0

    def _not_looked_at(self, x: Float[np.ndarray, "run dim"], most: int) -> Float[np.ndarray, "new dim"]:
        likely = None if self.state is None else self._losses().likely
        return points_elsewhere(x, self.space, self.active.unseen, most, likely)

    def _can_be_checked(self, left: int) -> bool:
        """Return whether the runs left are enough for a check that could pass, and would not be lost to failures."""
        return left >= FEWEST_DRAWS and self._losses().bears_check(self._posterior, FEWEST_DRAWS)

    def _chosen(self, number: int, made: int) -> Float[np.ndarray, "run dim"]:
        """Return the inputs of the next batch, safe ones if too many runs were lost where they are known to fail."""
        losses = self._losses()
        for kept in (None, losses):
            points = choose(
                self._posterior,
                self.space,
                number,
                explore=self.active.explore,
                first=made,
                criterion=self.active.criterion,
                seed=self.seed + 7919 * made,
                losses=kept,
                near=self._nearly_settled,
            )
            if losses.bears(points):
                break
        return points

    @property
    def _together(self) -> int:
        """Number of runs of the next batch: it grows with the runs so far, so that choosing does not take too long."""
        if self.active.batch is not None:
            return self.batch
        asked = sum(len(batch.points) for batch in self.batches)
        return max(self.batch, min(int(BATCH_SHARE * asked), LARGEST_BATCH))

    @property
    def _nearly_settled(self) -> bool:
        """Whether the posterior of many inputs hardly moves: its flanks are then far more than the posterior."""
        moved = self.steps[-1].moved
        return self.space.dim > FEW_INPUTS and moved is not None and max(moved.shift, moved.width) < HARDLY

    @property
    def _rests(self) -> bool:
        """Whether the last batch has moved the posterior little; the last two if a check has failed before."""
        last = self.steps[-1]
        failed = any(step.check is not None and not step.check.passed for step in self.steps)
        before = [step for step in self.steps if step.runs == last.since and step.kind != "check"]
        return self._calm(last) and (not failed or any(map(self._calm, before)))

    def _calm(self, step: Step) -> bool:
        moved, change = step.moved, self.active.change
        return moved is not None and max(moved.shift, moved.width) < change and moved.effective > FEWEST_EFFECTIVE

    def _losses(self) -> Losses:
        early = [batch.points for batch in self.batches if batch.kind in ("initial", "given")]
        first = frozenset(row.tobytes() for points in early for row in points)
        return Losses(self._posterior.knowledge, self.active.runs, first, self._price)

    @property
    def _left(self) -> int:
        asked = sum(len(batch.points) for batch in self.batches if batch.kind != "given")
        return self.active.runs - asked - self.besides

    def _confirmed(self) -> bool:
        """Sample the posterior from the prior; return whether it is the one that the batches have led to."""
        before = self._posterior
        self.state = after = self.afresh(before)
        shift = np.abs(after.mean - before.mean) / before.sd
        width = np.abs(np.log(after.sd / before.sd))
        return bool(max(shift.max(), width.max()) < DIFFERENT)

    def _noted(self, points: Float[np.ndarray, "run dim"], kind: Kind) -> Batch:
        self.batches.append(Batch(points, kind))
        return self.batches[-1]

    def _still_passed(self) -> BatchCheck | None:
        """Return the check that the posterior had passed before the last runs; None if they have moved it."""
        (passed, self._passed) = (self._passed, None)
        if passed is None:
            return None
        moved = passed[0].moved(self._posterior.knowledge)
        still = max(moved.shift, moved.width) < STILL and moved.effective >= self.active.effective
        return passed[1] if still else None

    def _step(self, check: BatchCheck | None) -> Step:
        state = self._posterior
        weights, errors = np.exp(state.log_weights), state.knowledge.surrogate.predicted_error(state.positions)
        order = np.argsort(errors)
        half = int(np.searchsorted(np.cumsum(weights[order]), 0.5))
        kind, far = self.batches[-1].kind, state.runs - self._apart(state)
        before = [one for one in self._remembered if one.runs <= far][-1:]
        later = [one for one in self._remembered if one.runs > far]
        self._remembered = [state] if kind == "check" else [*before, *later, state]
        return Step(
            runs=state.runs,
            ok=int(state.knowledge.ok.sum()),
            kind=kind,
            mean=state.mean,
            sd=state.sd,
            error=float(errors[order[min(half, len(order) - 1)]]),
            moved=before[0].moved(state.knowledge) if before else None,
            since=before[0].runs if before else None,
            check=check,
        )

    def _apart(self, state: State) -> int:
        """Return by how many runs posteriors must differ to be compared: half the inputs, if runs yield derivatives."""
        return (self.space.dim + 1) // 2 if state.knowledge.surrogate.gradients else self.space.dim

    def _why_not(self) -> tuple[str, ...]:
        reasons = [f"all {self.active.runs} runs that were allowed are made", *self._losses().words(self._posterior)]
        moved = self.steps[-1].moved
        if moved is None:
            reasons.append("too few batches were made to tell whether the posterior still moves")
        elif not self._calm(self.steps[-1]):
            by = f"by {moved.shift:.2f} standard deviations, its width by {moved.width:.0%}"
            after = f"with {moved.effective:.0%} of its draws effective after it"
            reasons.append(f"the last batch still moved the posterior ({by}, {after})")
        checks = [step.check for step in self.steps if step.check is not None and step.kind != "given"]
        reasons += checks[-1].reasons if checks else ("no check on the true model was made",)
        reasons += [words for one in self._odd[:1] if (words := one.words(self.space)) not in reasons]
        self.scattered = self.check.scatter_prevents(self._posterior)
        return (*reasons, self.check.scatter.reason) if self.scattered else tuple(reasons)


PHASES: tuple[Callable[[ActiveDesign, Situation], Decision], ...] = (
    ActiveDesign._finish,
    ActiveDesign._give_up,
    ActiveDesign._try_again,
    ActiveDesign._look_around,
    ActiveDesign._check,
)
"""What a design may do after a batch besides learning more where the posterior lies: the first one ready decides."""
