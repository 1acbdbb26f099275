"""`strandline report`: write the results again from finished runs."""

from pathlib import Path

import click

from strandline.cli import device as devices
from strandline.cli.study_folder import STUDY

__all__ = ["command"]


@click.command("report")
@click.argument("study", type=STUDY)
@devices.option
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(study: Path, device: str | None, quiet: bool) -> None:
    """Write posterior, figures and report of STUDY again from its ledger; no forward run is made."""
    devices.use(device)
    from strandline.cli.progress import observing
    from strandline.cli.results import show, shown_also_if_incomplete
    from strandline.studies import load_study, run_study

    loaded = load_study(study)
    loaded.runs.require_finished()
    with shown_also_if_incomplete(), observing(quiet=quiet) as observer:
        outcome = run_study(loaded, observer=observer)
    show(outcome.summary, outcome.report)
