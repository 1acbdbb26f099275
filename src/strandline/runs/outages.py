"""A model's server that stops answering: the campaign waits for it, so that the rest of the design is not lost."""

import time
from collections.abc import Iterable

from strandline.errors import CampaignStopped, ForwardModelError
from strandline.models.offers import UNREACHED, UsesServer
from strandline.models.protocol import ForwardModel
from strandline.runs.record import RunRecord

__all__ = ["Outages"]

IN_A_ROW = 3
"""Runs in a row that do not reach the server before the campaign looks whether it answers."""
SECONDS_BETWEEN_PROBES = 5.0
LONGEST_SECONDS = 600.0
"""How long a server is waited for that has made a run of this campaign; a restart of it takes minutes."""


class Outages:
    """Counts the runs in a row that did not reach the server of `model`; models without one are left alone."""

    def __init__(self, model: ForwardModel) -> None:
        self.server = model if isinstance(model, UsesServer) else None
        self.in_a_row = 0
        self.reached = False

    def note(self, record: RunRecord) -> None:
        """Count the record of a run that has just ended."""
        self.in_a_row = self.in_a_row + 1 if record.failure_kind == UNREACHED else 0
        self.reached |= record.ok

    @property
    def suspected(self) -> bool:
        """Whether the server is to be probed before the next run."""
        return self.server is not None and self.in_a_row >= IN_A_ROW

    def before_trying_again(self, latest: Iterable[RunRecord]) -> None:
        """Wait for the server before runs are tried that did not reach it last time, of which `latest` may have some.

        Raises:
            CampaignStopped: It does not answer.
        """
        if any(record.failure_kind == UNREACHED for record in latest):
            self.wait()

    def wait(self) -> None:
        """Return as soon as the server answers.

        Raises:
            CampaignStopped: It does not, for ten minutes, or at once if it has made no run of this campaign.
        """
        begun = time.monotonic()
        while why := self._silence():
            if not self.reached or time.monotonic() - begun >= LONGEST_SECONDS:
                raise CampaignStopped(
                    f"stopped because runs do not reach the model's server: {why}\n"
                    "All finished runs are kept, the others are not lost. `strandline run` continues once it answers."
                )
            time.sleep(SECONDS_BETWEEN_PROBES)

    def _silence(self) -> str:
        """Return why the server does not answer; empty if it does, or if there is none."""
        try:
            if self.server is not None:
                self.server.require_server()
        except ForwardModelError as error:
            return error.message if error.kind in (UNREACHED, "timeout") else ""
        return ""
