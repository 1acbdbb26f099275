"""Settings of an active design."""

from dataclasses import dataclass

from strandline.design.active.checking import FEWEST_DRAWS, Tolerances, number_of_probes
from strandline.design.active.choice import criterion_named
from strandline.foundations import InvalidInput

FEWEST_CHECKED = 20
"""Smallest number of draws of a whole check."""
LARGEST_BATCH = 16
"""Largest number of runs that are chosen together if none is stated."""


@dataclass(frozen=True)
class Active:
    """How an active design goes on and when it stops.

    Args:
        runs: Maximum number of runs, those of the checks included; at least `initial` + 8. With fewer than `initial` +
            `check`, a check is smaller and settles less. Runs from an earlier ``study.yaml`` or a reused study do not
            count.
        initial: First runs, from the Sobol sequence, at least 3; default: 4 + 2 × number of inputs; with sensitivities
            half that, but at least 3.
        batch: Runs chosen together; default: number of workers, or 5 % of the runs so far if that is more; within
            2 to 16.
        explore: Share of runs placed where least is known, whatever the posterior, 0 to 0.5.
        criterion: How to choose the others: ``expected_variance`` most reduces the variance of the predicted interface
            over the posterior; ``repulsion`` takes the farthest from all runs; or ``module:name`` of a criterion of
            your own.
        check: Most posterior draws at which to run the true model before stopping, at least 20; fewer if they leave no
            doubt.
        unseen: Share of the prior's mass, 0.02 to 1: before it stops, the design looks for modes elsewhere until a
            region of this share holds a run with 95 % probability. Half the share costs about twice the runs; 1 looks
            nowhere.
        change: Largest change over each of the last two batches: of a mean in standard deviations, of a standard
            deviation in natural logarithms; batches with fewer runs than inputs count together, with sensitivities
            those with fewer than half as many.
        shift: Largest shift of a mean by the check's importance weights, in standard deviations beyond its standard
            error.
        width: Largest change of a standard deviation by these weights, in natural logarithms.
        k_hat: Upper limit for the Pareto shape of these weights, unless 98 % of draws are effective, or 1 % of as many
            weights without a heavy tail have a larger one.
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
    unseen: float = 0.1
    change: float = 0.1
    shift: float = 0.1
    width: float = 0.15
    k_hat: float = 0.5
    effective: float = 0.8
    patience: float = 3.0

    def __post_init__(self) -> None:
        first = self.initial or 3
        left, least = max(self.runs - first, 1), first + FEWEST_DRAWS
        criterion_named(self.criterion)
        for name, right, expected in (
            ("check", self.check >= FEWEST_CHECKED, f"at least {FEWEST_CHECKED} draws"),
            ("initial", self.initial is None or self.initial >= 3, "at least 3 runs"),
            ("batch", self.batch is None or self.batch >= 1, "at least 1 run"),
            ("explore", 0 <= self.explore <= 0.5, "a share from 0 to 0.5"),
            ("effective", 0 < self.effective < 1, "a share between 0 and 1"),
            ("unseen", 0.02 <= self.unseen <= 1, "a share from 0.02 to 1"),
            *((name, getattr(self, name) > 0, "a number above 0") for name in ("change", "shift", "width", "k_hat")),
            ("patience", self.patience >= 1, "at least 1"),
            (
                "batch",
                self.batch is None or self.batch <= left,
                f"at most {left}, the runs that are left of {self.runs} after the first {first}",
            ),
            ("runs", self.runs >= least, f"at least {least}: {first} first ones and a check of {FEWEST_DRAWS}"),
        ):
            if not right:
                raise InvalidInput(name, value=getattr(self, name), expected=expected, remedy="Change it.")

    def kept_for_check(self, dim: int) -> int:
        """Return the number of runs kept for a check: half of those after the first ones if these are few."""
        left = self.runs - (self.initial or 3)
        return self.check if left >= self.check else max(number_of_probes(dim, 0), left // 2)

    @property
    def tolerances(self) -> Tolerances:
        return Tolerances(self.shift, self.width, self.k_hat, self.effective)
