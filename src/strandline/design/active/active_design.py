"""An active design: batches of runs chosen on the posterior so far, a check on the true model, and when to stop.

The posterior is updated after each batch. If it has not moved over two batches, the true model is run at draws from it,
and importance weights show how far it is from the true posterior. If it is too far, these runs join the training set
and the design goes on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from strandline.design.active.choice import choose, criterion_named
from strandline.design.active.left_out import left_out_ratios
from strandline.design.active.state import Moved, Remembered, State
from strandline.design.space_filling import sobol
from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.posterior import NEARLY_EQUAL, Reweighting, reweight, subset
from strandline.runs import RunRecord

__all__ = ["Active", "ActiveDesign", "Batch", "BatchCheck", "Step"]

Kind = Literal["initial", "given", "posterior", "check"]
FEWEST_CHECKED = 20
DIFFERENT = 0.4
"""Change of a mean, in sds, or of the logarithm of an sd, that two samples of one posterior do not show."""


@dataclass(frozen=True)
class Active:
    """How an active design goes on and when it stops.

    Args:
        runs: Maximum number of runs, those of the checks included; at least `initial` + `check`. Runs from an earlier
            ``study.yaml`` or a reused study do not count.
        initial: First runs, from the Sobol sequence, at least 3; default: 4 + 2 × number of inputs; with sensitivities
            half that, but at least 3.
        batch: Runs chosen together; default: number of workers, within 2 to 16.
        explore: Share of runs placed where least is known, whatever the posterior, 0 to 0.5.
        criterion: How to choose the others: ``expected_variance`` most reduces the variance of the predicted interface
            over the posterior; ``repulsion`` takes the farthest from all runs; or ``module:name`` of a criterion of
            your own.
        check: Posterior draws at which to run the true model before stopping, at least 20.
        change: Largest change over each of the last two batches: of a mean in standard deviations, of a standard
            deviation in natural logarithms; batches with fewer runs than inputs count together.
        shift: Largest shift of a mean by the check's importance weights, in standard deviations beyond its standard
            error.
        k_hat: Upper limit for the Pareto shape of these weights, unless 98 % of draws are effective.
        effective: Share of draws that must be effective, between 0 and 1.
        patience: Once half a batch is done, the next does not wait for a run longer than this many times the longest
            before it; at least 1.

    Raises:
        InvalidInput: a number out of its range.
    """

    runs: int
    initial: int | None = None
    batch: int | None = None
    explore: float = 0.1
    criterion: str = "expected_variance"
    check: int = 25
    change: float = 0.1
    shift: float = 0.1
    k_hat: float = 0.7
    effective: float = 0.8
    patience: float = 3.0

    def __post_init__(self) -> None:
        _require(self.check >= FEWEST_CHECKED, "check", self.check, f"at least {FEWEST_CHECKED} draws")
        _require(self.initial is None or self.initial >= 3, "initial", self.initial, "at least 3 runs")
        _require(self.batch is None or self.batch >= 1, "batch", self.batch, "at least 1 run")
        _require(0 <= self.explore <= 0.5, "explore", self.explore, "a share from 0 to 0.5")
        criterion_named(self.criterion)
        _require(0 < self.effective < 1, "effective", self.effective, "a share between 0 and 1")
        for name in ("change", "shift", "k_hat"):
            _require(getattr(self, name) > 0, name, getattr(self, name), "a number above 0")
        _require(self.patience >= 1, "patience", self.patience, "at least 1")
        left = self.runs - (self.initial or 3)
        _require(
            self.batch is None or self.batch <= max(left, 1),
            "batch",
            self.batch,
            f"at most {max(left, 1)}, the runs that are left of {self.runs} after the first {self.initial or 3}",
        )
        least = (self.initial or 3) + self.check
        _require(
            self.runs >= least,
            "runs",
            self.runs,
            f"at least {least}: {self.initial or 3} first ones and a check of {self.check}",
        )


@dataclass(frozen=True, eq=False)
class Batch:
    """Inputs that were run together (run, dim), and their purpose."""

    points: Float[np.ndarray, "run dim"]
    kind: Kind


@dataclass(frozen=True, eq=False)
class BatchCheck:
    """The true model at draws of the posterior.

    Args:
        draws: Number of draws.
        failed: Number of draws whose run failed; they are left out of the weights.
        reweighting: Reweighting by the draws whose run succeeded.
        passed: Whether all figures are within the tolerances.
        reasons: Figures outside the tolerances, in words.
    """

    draws: int
    failed: int
    reweighting: Reweighting | None
    passed: bool
    reasons: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Step:
    """The posterior after a batch.

    Args:
        runs: Number of runs made so far.
        ok: Number of these runs that succeeded.
        kind: Kind of the batch.
        mean: Posterior mean, shape (dim,).
        sd: Posterior standard deviation, shape (dim,).
        error: Error of the predicted interface, mm: root mean square along it, median over the posterior.
        moved: Distance from the last step that had fewer runs by at least the number of inputs; None if there is none
            since the last check.
        since: Number of runs at that step.
        check: Result of the batch if it was a check; it concerns the posterior before the batch.
    """

    runs: int
    ok: int
    kind: Kind
    mean: Float[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]
    error: float
    moved: Moved | None
    since: int | None
    check: BatchCheck | None


class ActiveDesign:
    """Decides what to run next, given the runs so far.

    Args:
        active: Settings of the design.
        space: The inputs.
        batch: Number of runs chosen together.
        learn: Function that returns the posterior, given inputs and their records.
        log_likelihood: Function that returns the log-likelihood of a successful record, by the true model.
        afresh: Function that samples a posterior again, from the prior, before it is checked.
        seed: Seed of all random numbers.
        scramble: Seed that scrambles the Sobol sequence of the first runs, None for the plain sequence.
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
    ) -> None:
        self.active, self.space, self.batch, self.seed, self.scramble = active, space, batch, seed, scramble
        self.learn, self.log_likelihood, self.afresh = learn, log_likelihood, afresh
        self.batches: list[Batch] = []
        self.steps: list[Step] = []
        self.state: State | None = None
        self.converged = False
        self.reasons: tuple[str, ...] = ()
        self._remembered: list[Remembered] = []
        self._checked: tuple[Float[np.ndarray, "draw dim"], Float[np.ndarray, " draw"]] | None = None

    def start(self, points: Float[np.ndarray, "run dim"], *, given: bool = False) -> None:
        """Record the first runs; `given` runs come from an earlier analysis and do not count towards the budget."""
        self.batches.append(Batch(points, "given" if given else "initial"))

    def more_of_the_first(self) -> Batch | None:
        """Return a further batch of the Sobol sequence because too few runs succeeded; None if no runs are left."""
        asked = sum(len(batch.points) for batch in self.batches)
        number = min(self.batch, self.active.runs - asked)
        if number < 1:
            return None
        points = sobol(asked + number, self.space.dim, scramble=self.scramble)[asked:]
        return self._noted(self.space.to_physical(points), "initial")

    def next(self, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> Batch | None:
        """Return the next batch, given all runs that have ended; None to stop."""
        kind = self.batches[-1].kind
        check = self._judged(x, records) if kind == "check" else None
        self.state = self.learn(x, records)
        if kind == "given":
            check = self._judged_without_runs(records)
        self.steps.append(self._step(check))
        asked = sum(len(batch.points) for batch in self.batches if batch.kind != "given")
        stable, left = self._stable(), self.active.runs - asked
        if check is not None and check.passed and (stable or kind == "given"):
            self.converged, self.reasons = True, ()
            return None
        if kind == "given":
            check = None
        if left <= 0 or (check is not None and left < self.batch):
            self.reasons = self._why_not(check)
            return None
        room = left - self.active.check
        if (stable and check is None and room >= 0) or room < 1:
            number = min(self.active.check, left)
            if number < FEWEST_CHECKED:
                self.reasons = self._why_not(check)
                return None
            if self._confirmed() or room < 1:
                return self._noted(self._to_check(number), "check")
        points = choose(
            self.state,
            self.space,
            min(self.batch, max(room, 1)),
            explore=self.active.explore,
            first=len(x),
            criterion=self.active.criterion,
            seed=self.seed + 7919 * len(x),
        )
        return self._noted(points, "posterior")

    def _confirmed(self) -> bool:
        """Sample the posterior from the prior; return whether it is the one that the batches have led to."""
        assert self.state is not None
        before, self.state = self.state, self.afresh(self.state)
        shift = np.abs(self.state.mean - before.mean) / before.sd
        width = np.abs(np.log(self.state.sd / before.sd))
        return bool(max(shift.max(), width.max()) < DIFFERENT)

    def _noted(self, points: Float[np.ndarray, "run dim"], kind: Kind) -> Batch:
        self.batches.append(Batch(points, kind))
        return self.batches[-1]

    def _to_check(self, number: int) -> Float[np.ndarray, "draw dim"]:
        state = self.state
        assert state is not None
        chosen = subset(np.exp(state.log_weights), number, self.seed)
        self._checked = state.positions[chosen], state.log_expected[chosen]
        return np.asarray(state.positions[chosen])

    def _judged(self, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> BatchCheck:
        """Return the verdict of a check's runs on the posterior that they were drawn from."""
        assert self._checked is not None
        draws, surrogate = self._checked
        by_input = {row.tobytes(): record for row, record in zip(x, records, strict=True)}
        settled = [by_input.get(row.tobytes()) for row in draws]
        good = np.array([record is not None and record.ok for record in settled])
        failed = sum(record is not None and not record.ok for record in settled)
        if good.sum() < FEWEST_CHECKED // 2:
            reason = f"only {int(good.sum())} of {len(draws)} runs of the check succeeded"
            return BatchCheck(len(draws), failed, None, False, (reason,))
        true = np.array([self.log_likelihood(record) for record in settled if record is not None and record.ok])
        found = reweight(draws[good], true - surrogate[good])
        reasons = self._objections(found)
        return BatchCheck(len(draws), failed, found, not reasons, reasons)

    def _judged_without_runs(self, records: Sequence[RunRecord]) -> BatchCheck:
        """Return the verdict of an earlier analysis's runs, each against its prediction from all others."""
        assert self.state is not None
        x, ratios = left_out_ratios(self.state, records, self.log_likelihood, self.space.log_prior)
        if len(x) < FEWEST_CHECKED:
            reason = f"only {len(x)} of the available runs lie inside the posterior"
            return BatchCheck(len(x), 0, None, False, (reason,))
        found = reweight(x, ratios)
        reasons = (*self._objections(found), *self._unsure())
        return BatchCheck(len(x), 0, found, not reasons, reasons)

    def _unsure(self) -> tuple[str, ...]:
        """Return a reason if the surrogate's own variance weighs too much: left-out runs only test where runs are."""
        assert self.state is not None
        ratios = np.exp(self.state.log_weights - self.state.log_weights_plug_in)
        share = float(1.0 / (np.exp(self.state.log_weights_plug_in) @ ratios**2))
        if share >= self.active.effective:
            return ()
        return (
            f"the surrogate's own uncertainty leaves only {share:.0%} effective draws, not {self.active.effective:.0%}",
        )

    def _objections(self, found: Reweighting) -> tuple[str, ...]:
        a, number = self.active, len(found.smoothed.log_weights)
        share, beyond = found.smoothed.ess / number, np.abs(found.shift) - found.shift_error
        out = []
        if found.smoothed.k_hat >= a.k_hat and share < NEARLY_EQUAL:
            out.append(f"Pareto k̂ is {found.smoothed.k_hat:.2f}, not below {a.k_hat:g}")
        if beyond.max() >= a.shift:
            worst = float(np.abs(found.shift[beyond.argmax()]))
            out.append(f"importance weights move a mean by {worst:.2f} standard deviations, more than {a.shift:g}")
        if share < a.effective:
            out.append(f"the effective sample size of the weights is {share:.0%} of the draws, not {a.effective:.0%}")
        return tuple(out)

    def _step(self, check: BatchCheck | None) -> Step:
        state = self.state
        assert state is not None
        weights, errors = np.exp(state.log_weights), state.knowledge.surrogate.predicted_error(state.positions)
        order = np.argsort(errors)
        half = int(np.searchsorted(np.cumsum(weights[order]), 0.5))
        kind, runs = self.batches[-1].kind, len(state.knowledge.x)
        before = [one for one in self._remembered if one.runs <= runs - self.space.dim]
        self._remembered = [*([] if kind == "check" else self._remembered), Remembered.of(state)]
        return Step(
            runs=runs,
            ok=int(state.knowledge.ok.sum()),
            kind=kind,
            mean=state.mean,
            sd=state.sd,
            error=float(errors[order[min(half, len(order) - 1)]]),
            moved=before[-1].moved(state.knowledge) if before else None,
            since=before[-1].runs if before else None,
            check=check,
        )

    def _stable(self) -> bool:
        """Return whether the posterior has moved little up to this step, and up to the step it is compared with.

        A check that has failed does not count as that step: two batches must follow it before the next check.
        """
        last = self.steps[-1]
        before = [step for step in self.steps if step.runs == last.since and step.kind != "check"]
        return self._calm(last) and any(self._calm(step) for step in before)

    def _calm(self, step: Step) -> bool:
        return step.moved is not None and self._quiet(step.moved)

    def _quiet(self, moved: Moved) -> bool:
        return max(moved.shift, moved.width) < self.active.change and moved.effective >= self.active.effective

    def _why_not(self, check: BatchCheck | None) -> tuple[str, ...]:
        left = self.active.runs - sum(len(batch.points) for batch in self.batches if batch.kind != "given")
        reasons = [
            f"all {self.active.runs} runs that were allowed are made"
            if left <= 0
            else f"{left} of the {self.active.runs} runs that were allowed are left, too few to go on to a check"
        ]
        last = self.steps[-1]
        both = [step.moved for step in self.steps if step is last or step.runs == last.since]
        unrest = [moved for moved in both if moved is not None and not self._quiet(moved)]
        if unrest:
            moved = unrest[-1]
            reasons.append(
                f"one of the last two batches still moved the posterior (by {moved.shift:.2f} standard deviations, its "
                f"width by {moved.width:.0%}, with {moved.effective:.0%} of its draws effective after it)"
            )
        elif not self._stable():
            reasons.append("the posterior has not stood still for two batches yet")
        return (*reasons, *(("no check on the true model was made",) if check is None else check.reasons))


def _require(right: bool, name: str, value: object, expected: str) -> None:
    if not right:
        raise InvalidInput(name, value=value, expected=expected, remedy="Change it.")
