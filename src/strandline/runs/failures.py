"""What a campaign does about runs that fail, by kind of failure.

The words are those of Dakota's failure capturing: `abort` ends the campaign, `retry` tries again, `continue` leaves the
run out. Dakota's fourth word, `recover`, would replace an interface by a number; it is not available.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from strandline.foundations import CampaignStopped, ForwardModelError, inputs_text, require, require_types
from strandline.models import ForwardModel
from strandline.runs.ledger.ledger_schema import EXCLUDED
from strandline.runs.ledger.record import RunRecord

LINES_SHOWN = 6
COMMON_KINDS = (
    *("exception", "not_an_interface", "invalid_interface", "non_finite", "conditions", "sensitivities"),
    *("timeout", "walltime", "worker_died", "out_of_memory", "node_failed", "cancelled", "preempted"),
    *("damaged_result", "not_comparable", "no_common_points"),
)
"""Kinds of failure of any model, in addition to those that the model itself defines."""
MISTAKES = (
    *("NameError", "UnboundLocalError", "AttributeError", "KeyError", "TypeError"),
    *("ImportError", "ModuleNotFoundError"),
)
"""Exceptions of a Python function that come from its text, not from the numbers that it is given."""
ALIKE = 5
"""First runs after which a campaign stops if each ended with one of these and the same words: a design begins with runs
far from each other, so that five in a row do not lie in one bad corner of the box."""
UNREACHED = "connection"
"""Failure kind of a run that did not reach its server."""
IN_A_ROW = 3
"""Runs in a row that do not reach the server before the campaign asks whether it answers."""
PAUSE_SECONDS = 5.0
PAUSES = 120
"""How often the campaign waits for a server that has made one of its runs: ten minutes, since a restart takes some."""


@dataclass(frozen=True)
class Retry:
    """Try again, up to `times` more times.

    Raises:
        InvalidInput: `times` is less than one.
    """

    times: int = 1

    def __post_init__(self) -> None:
        require(self.times >= 1, "retry of a failed run", self.times, "at least 1", "Use `continue` for none.")


@dataclass(frozen=True)
class FailurePolicy:
    """What to do about failed runs: by default they are data, and only a vanished process is tried again, twice.

    `actions` are by failure kind (``timeout``, ``exit_code``, …) or, for kinds without an entry, by state (``failed``,
    ``invalid``, …): ``"continue"``, ``"abort"`` or a `Retry`. Once `stop_after` runs are settled, the campaign stops if
    the share of failed ones reaches `stop_share`; above 1: never. `again` names kinds and states whose earlier failures
    are not final: these runs are made once more.

    Raises:
        InvalidInput: an unknown action, or bounds that make no sense.
    """

    actions: Mapping[str, "str | Retry"] = field(default_factory=dict)
    stop_after: int = 20
    stop_share: float = 0.95
    again: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        require_types(self)
        for kind, action in self.actions.items():
            known = isinstance(action, Retry) or action in ("continue", "abort")
            expected = "continue, abort, or {retry: N}"
            require(known, f"what is done about {kind}", action, expected, "Correct the action.")
        sound, what = self.stop_after >= 1 and self.stop_share > 0, "when a failing campaign is stopped"
        found = f"share {self.stop_share:g} after {self.stop_after} runs"
        remedy = "Correct the numbers; a share above 1 never stops it."
        require(sound, what, found, "a share above 0 and at least 1 run", remedy)

    def attempts(self, record: RunRecord, *, killed: int) -> int:
        """Return how often a run that ended like `record` may be tried in total; `killed` if its process vanished."""
        action = self._action(record)
        if isinstance(action, Retry):
            return 1 + action.times
        return killed if action is None and record.state == "killed" else 1

    def aborts(self, record: RunRecord) -> bool:
        """Return whether this outcome ends the campaign."""
        return not record.ok and self._action(record) == "abort"

    def tries_again(self, record: RunRecord) -> bool:
        """Return whether to repeat a failure of an earlier campaign: it ended that campaign, or `again` names it."""
        wanted = bool(self.again & {record.failure_kind, record.state})
        return not record.ok and record.state != EXCLUDED and (wanted or self.aborts(record))

    def require_worth_going_on(self, made: Sequence[RunRecord]) -> None:
        """Raise CampaignStopped, with a log, if nearly all runs so far fail, or the first ones by one mistake."""
        failed = [record for record in made if not record.ok]
        mostly = len(made) >= self.stop_after and len(failed) >= self.stop_share * len(made)
        mistakes = {_mistake(record) for record in made[:ALIKE]}
        alike = len(made) == ALIKE and self.stop_share <= 1 and len(mistakes) == 1 and None not in mistakes
        if mostly or alike:
            raise _mostly_failed(failed, len(made))

    def _action(self, record: RunRecord) -> "str | Retry | None":
        return self.actions.get(record.failure_kind or "", self.actions.get(record.state))


def counted(kinds: Mapping[str, int]) -> str:
    """Return how many runs failed for each reason, so that no number looks like a code: ``2 × exit_code``."""
    return ", ".join(f"{number} × {kind}" for kind, number in kinds.items())


def aborted(record: RunRecord) -> CampaignStopped:
    """Return the error that ends a campaign with `record`."""
    kind = record.failure_kind or record.state
    return CampaignStopped(
        f"a run ended with {kind}, which stops this study (failures.kinds.{kind}: abort)\n"
        f"{_told(record)}\n"
        "All finished runs are kept. Fix the cause and start again: this run is tried again, and so are those that "
        "were under way at the same time."
    )


def _mistake(record: RunRecord) -> str | None:
    """Return the words with which the model's own code ended the run; None if its inputs may be the cause."""
    words = (record.message or "").partition("\n")[0]
    return words if record.failure_kind == "exception" and words.partition(":")[0] in MISTAKES else None


def _mostly_failed(failed: Sequence[RunRecord], made: int) -> CampaignStopped:
    kinds = Counter(record.failure_kind or record.state for record in failed)
    (commonest, _), *_ = kinds.most_common()
    example = next(record for record in failed if (record.failure_kind or record.state) == commonest)
    shown = counted(dict(kinds.most_common(4)))
    advice = f"Fix the cause, then `strandline retry STUDY --kind {commonest}` repeats them and goes on."
    if commonest in COMMON_KINDS[-2:]:  # these runs ended ok, so that the ledger cannot go on with another model
        advice = "Correct the model and move ledger.sqlite away, then `strandline run STUDY` begins again."
    elif len(failed) < made:
        advice += " A changed model needs another ledger: move ledger.sqlite away, then `strandline run STUDY`."
    return CampaignStopped(
        f"stopped because {len(failed)} of {made} runs failed ({shown})\n{_told(example)}\n"
        f"All runs are kept. {advice} `failures: {{stop: never}}` lets the study go on by itself."
    )


def _told(record: RunRecord) -> str:
    """Return the inputs of a run, the reason why it failed, and the end of its log."""
    inputs = inputs_text(record.inputs)
    reason, *lines = (record.message or "no message").splitlines()
    last = [f"  {line.rstrip()}" for line in lines if line.strip()][-LINES_SHOWN:]
    return "\n".join([f"at {inputs}: {reason}", *last])


def require_kinds(again: Iterable[str], known: Iterable[str]) -> None:
    """Refuse a kind of failure that no run ended with; the message lists those that occurred."""
    present = sorted(set(known))
    for kind in again:
        expected = f"one of {', '.join(present)}" if present else "a failed run; there is none"
        remedy = "`strandline status` lists the kinds and how many there are."
        require(kind in present, "--kind", kind, expected, remedy)


class Outages:
    """Counts the runs in a row that did not reach the server of `model` (`require_server`), if any; waits for it."""

    def __init__(self, model: ForwardModel, wait: Callable[[float], None] = time.sleep) -> None:
        self.probe, self.wait = getattr(model, "require_server", None), wait
        self.in_a_row = 0
        self.reached = False

    def note(self, record: RunRecord) -> None:
        """Count the record of a run that has just ended."""
        self.in_a_row = self.in_a_row + 1 if record.failure_kind == UNREACHED else 0
        self.reached |= record.ok

    @property
    def suspected(self) -> bool:
        """Whether the server does not seem to answer."""
        return self.probe is not None and self.in_a_row >= IN_A_ROW

    def require_server(self, latest: Iterable[RunRecord] = ()) -> None:
        """Return at once; or once the server answers, if it is `suspected` or a run of `latest` did not reach it.

        Raises:
            CampaignStopped: It does not answer within ten minutes, or now, if it has made no run of this campaign.
        """
        if not self.suspected and all(record.failure_kind != UNREACHED for record in latest):
            return
        for _ in range(PAUSES if self.reached else 0):
            if not self._silence():
                return
            self.wait(PAUSE_SECONDS)
        if why := self._silence():
            raise CampaignStopped(
                f"stopped because runs do not reach the model's server: {why}\n"
                "All finished runs are kept, the others are not lost. `strandline run` continues once it answers."
            )

    def _silence(self) -> str:
        """Return why the server does not answer; empty if it does, or if there is none."""
        try:
            if self.probe is not None:
                self.probe()
        except ForwardModelError as error:
            return error.message if error.kind in (UNREACHED, "timeout") else ""
        return ""
