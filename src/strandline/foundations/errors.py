"""Every exception that strandline raises on purpose.

```
StrandlineError
├── InvalidInput            the caller can fix it: exit code 2, one line, nothing written
│   ├── InvalidStudy        study.yaml or the study folder
│   ├── InvalidInterface    an observed or supplied polyline
│   │   └── NoCommonPoints  interfaces of runs that cannot be brought to common points
│   ├── LedgerError         a ledger that is locked, unreadable, of another model or of a newer version
│   └── TooFewRuns          not enough successful forward runs to go on
├── ForwardModelError       one forward run failed: this is data and does not end a campaign
├── CampaignStopped         a campaign ended before its last run, as its failure policy requires
├── ResultsNotWritten       some result files could not be written; the others were
└── NumericsError           a numerical method could not deliver what it promises
```
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

EndState = Literal["failed", "timeout", "killed", "invalid"]
LONGEST_VALUE, LONGEST_PART = 160, 1000
"""Maximum number of characters in a message: for the value found, and for each other part."""


class StrandlineError(Exception):
    """Root of all exceptions raised on purpose."""


class InvalidInput(StrandlineError, ValueError):
    """Something the caller supplied cannot be used.

    Args:
        what: what is wrong, with the place it was found.
        value: the value that was found.
        expected: what would have been right.
        remedy: what to do next.
    """

    def __init__(self, what: str, *, value: object, expected: str, remedy: str) -> None:
        self.what, self.value, self.expected, self.remedy = what, value, expected, remedy
        super().__init__(f"{_line(what)}: got {_shown(value)}; expected {_line(expected)}. {_line(remedy)}")

    def __reduce__(self) -> tuple[Any, ...]:
        rebuild = partial(type(self), value=self.value, expected=self.expected, remedy=self.remedy)
        return rebuild, (self.what,)


class InvalidStudy(InvalidInput):
    """The study file or folder cannot be used."""


class InvalidInterface(InvalidInput):
    """Points that do not form an interface."""


class NoCommonPoints(InvalidInterface):
    """Interfaces of different runs that cannot be brought to common points."""


class LedgerError(InvalidInput):
    """The ledger of runs cannot be used."""


class TooFewRuns(InvalidInput):
    """Not enough successful forward runs."""


class ForwardModelError(StrandlineError):
    """One forward run did not yield an interface.

    Args:
        kind: short machine-readable reason, e.g. ``newton_stalled``.
        message: one sentence for a person.
        evidence: numbers that support the kind, e.g. the load reached.
        state: how the run ended: ``failed`` | ``timeout`` | ``killed`` by something other than itself, so that it
            deserves another try | ``invalid``, with a result that cannot be used. Default: ``timeout`` if `kind` is
            ``timeout``, else ``failed``.
        log: end of the simulator's output.
    """

    def __init__(
        self,
        kind: str,
        message: str,
        evidence: Mapping[str, float] | None = None,
        *,
        state: EndState | None = None,
        log: str = "",
    ) -> None:
        self.kind, self.message, self.evidence = kind, message, dict(evidence or {})
        self.state: EndState = state or ("timeout" if kind == "timeout" else "failed")
        self.log = log
        super().__init__(f"{kind}: {message}")

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), state=self.state, log=self.log), (self.kind, self.message, self.evidence)


class CampaignStopped(StrandlineError):
    """A campaign ended before its last run, as its failure policy requires; the message says why and what to do."""


class ResultsNotWritten(StrandlineError):
    """Some files of a finished study could not be written; the others were.

    Args:
        folder: the study folder.
        missing: reason why each file is missing, by file name.
        outcome: the outcome that `run_study` would have returned.
    """

    def __init__(self, folder: Path, missing: Mapping[str, str], outcome: Any) -> None:
        self.folder, self.missing, self.outcome = folder, dict(missing), outcome
        files = "; ".join(f"{name}: {why}" for name, why in missing.items())
        super().__init__(
            f"some results could not be written: {_shown(files)}. The others are in {folder}. Fix that and run "
            "`strandline report` again: finished forward runs are kept."
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.folder, self.missing, self.outcome)


class NumericsError(StrandlineError):
    """A numerical method cannot deliver what it promises; the message says what to do."""


def _shown(value: object) -> str:
    """Return `value` on one line of reasonable length."""
    if value is None:
        return "nothing"
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):  # a number with thousands of digits, a list that contains itself
        text = f"a {type(value).__name__} too long to show"
    return _line(text, LONGEST_VALUE)


def _line(text: str, longest: int = LONGEST_PART) -> str:
    """Return `text` on one line, shortened, with control characters escaped."""
    words = " ".join(text[: 4 * longest].split())
    plain = "".join(c if c.isprintable() else repr(c)[1:-1] for c in words)
    return plain if len(plain) <= longest else plain[: longest - 3] + "…"
