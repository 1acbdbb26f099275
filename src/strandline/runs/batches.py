"""A campaign in batches: each batch is chosen from what earlier runs returned."""

import math
import time
from collections.abc import Callable, Mapping, Sequence

from strandline.foundations import InvalidInput
from strandline.models import ForwardModel
from strandline.runs.campaign import Campaign, Progress, Starts
from strandline.runs.executors import Executor
from strandline.runs.failures import FailurePolicy
from strandline.runs.ledger.ledger import Ledger
from strandline.runs.ledger.record import RunRecord, RunRequest

Batch = Sequence[Mapping[str, float]]
"""Inputs by name of the runs that are chosen together."""


class PlainBatch(list[Mapping[str, float]]):
    """A batch of which no sensitivities are needed, whatever the model is asked for."""


Choose = Callable[[tuple[RunRecord, ...]], Batch]
"""Returns the batch that follows from these records; an empty one ends the campaign."""
SHORTEST_PATIENCE_SECONDS = 1.0
"""No run counts as slow before: a busy machine may take this long to hand over a run that takes no time."""


def run_batches(
    model: ForwardModel,
    batches: Sequence[Batch],
    choose: Choose,
    *,
    ledger: Ledger,
    executor: Executor,
    on_record: Callable[[RunRecord, Progress], None] | None = None,
    policy: FailurePolicy | None = None,
    patience: float = 3.0,
    maximum_attempts: int = 3,
) -> tuple[RunRecord, ...]:
    """Return one record per run, in the order of the design: `batches`, then those that `choose` adds, one by one.

    Whenever the last batch is closed and a worker is free, `choose` is called once for the next batch, in this thread,
    while runs may be under way; it may be slow. It gets the settled records of all batches, including failed runs, in
    the order of the design, but not the runs still under way. When it returns an empty batch, the campaign waits for
    the runs under way and ends.

    A batch is closed when all of its runs are settled. So that one slow run does not hold up the others, it is also
    closed when at least half of its distinct runs are settled and all others are slow. A run is slow if its present
    attempt has taken longer than a second and longer than `patience` times the longest time (`RunRecord.seconds`) of
    any settled run of this campaign, however it ended. Runs found in the ledger count like those made now.

    As long as no run is slow (no run is, with a `patience` of ``inf``), the batches depend only on the records and
    `choose`, not on the number of workers or the order in which runs end. If a campaign is killed and started again
    with the batches chosen before, at least one, however many of them were saved, it goes on exactly as it would have,
    bit for bit, provided that `choose` looks only at what a run yields and not at how long it took. Save a batch inside
    `choose`, before returning it.

    An executor that `asks_again` keeps its workers from batch to batch. Any other is called for each batch and makes
    all of its runs: the campaign waits for slow ones, whatever `patience` is.

    All other arguments, failed runs, runs whose process vanished, runs that go on without a driver and the ledger are
    as in `run_campaign`, but a run that deserves another attempt is tried again at once, after those already waiting.
    `Progress.total` grows with each batch.

    Raises:
        CampaignStopped: The `policy` ends the campaign; finished runs are in the ledger.
        InvalidInput: there is no first batch, a batch is empty, or `patience` is not above 0.
        LedgerError: the ledger belongs to another model, or cannot be written.
    """
    policy = policy or FailurePolicy(stop_share=2.0)
    campaign = Campaign(model, [], ledger, executor, on_record, maximum_attempts, policy)
    course = _BatchCourse(campaign, batches, choose, patience)
    further = course.further if getattr(executor, "asks_again", False) else None
    while course.goes_on():
        campaign.run_pending(further)
    return campaign.results()


class _BatchCourse:
    """Which batch is the last, whether it is closed, and what comes after it."""

    def __init__(self, campaign: Campaign, batches: Sequence[Batch], choose: Choose, patience: float) -> None:
        if not batches or not all(batches):
            raise InvalidInput(
                "batches to begin with",
                value=[len(batch) for batch in batches],
                expected="at least one, none of them empty",
                remedy="Choose the first batch before the campaign; leave out the empty one that ended an earlier one.",
            )
        if not patience > 0:
            raise InvalidInput(
                "patience with slow runs",
                value=patience,
                expected="a number above 0",
                remedy="Use inf to wait for all runs.",
            )
        self.campaign, self.choose, self.patience = campaign, choose, patience
        self.ended = False
        for batch in batches:
            campaign.pending += self._begun(batch)

    def goes_on(self) -> bool:
        """Return whether there are runs to make; choose new ones if all runs are settled."""
        while not self.campaign.pending and not self.ended:
            self.campaign.pending = self._next()
        return bool(self.campaign.pending)

    def further(self, starts: Starts) -> Sequence[RunRequest] | None:
        """Return the runs of the next batch: none as long as the last one is open; None if there are no more."""
        while not self.ended and self._closed(starts):
            if requests := self._next():
                return requests
        return None if self.ended else ()

    def _next(self) -> list[RunRequest]:
        """Choose the next batch; return those of its runs that must be made, if any."""
        try:
            batch = self.choose(self.campaign.results())
        except StopIteration as error:
            raise InvalidInput(
                "choice of the next batch",
                value="StopIteration",
                expected="inputs of runs, an empty list at the end",
                remedy="Return [] when all batches are chosen; give `next` a default.",
            ) from error
        self.ended = not batch
        return self._begun(batch)

    def _begun(self, batch: Batch) -> list[RunRequest]:
        """Make `batch` the last one; return those of its runs that must be made."""
        before = len(self.campaign.order)
        requests = self.campaign.add(batch, plain=isinstance(batch, PlainBatch))
        self.last = frozenset(self.campaign.order[before:])
        return requests

    def _closed(self, starts: Starts) -> bool:
        """Return whether the last batch, all of whose runs are started, is settled except for slow runs."""
        settled = self.campaign.settled
        others = self.last - settled.keys()
        if not others:
            return True
        if 2 * len(others) > len(self.last) or math.isinf(self.patience):
            return False
        longest = self.patience * max(record.seconds for record in settled.values())
        now = time.monotonic()
        return all(now - starts.begun[key] > max(longest, SHORTEST_PATIENCE_SECONDS) for key in others)
