"""A model's server that stops answering: the campaign waits for it, so that the rest of the design is not lost."""

import time
from collections.abc import Callable, Iterable

from strandline.errors import CampaignStopped, ForwardModelError
from strandline.models.protocol import ForwardModel
from strandline.runs.record import RunRecord

__all__ = ["Outages"]

UNREACHED = "connection"
"""Failure kind of a run that did not reach its server."""
IN_A_ROW = 3
"""Runs in a row that do not reach the server before the campaign asks whether it answers."""
PAUSE_SECONDS = 5.0
PAUSES = 120
"""How often the campaign waits for a server that has made one of its runs: ten minutes, since a restart takes some."""


class Outages:
    """Counts the runs in a row that did not reach the server of `model`, and waits for it.

    Args:
        model: The simulator; one without `require_server` is left alone.
        wait: Function that waits for some seconds.
    """

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
