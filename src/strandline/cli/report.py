"""`strandline report`: write the results again from finished runs."""

from pathlib import Path

import click

from strandline.cli import options


@click.command("report")
@options.study
@options.device
@options.quiet
def command(study: Path, device: str | None, quiet: bool) -> None:
    """Write posterior, figures and report of STUDY again from its ledger; no forward run is made."""
    options.use_device(device)
    from strandline.cli.progress import observing
    from strandline.cli.results import show, shown_also_if_incomplete
    from strandline.studies import load_study, run_study

    loaded = load_study(study)
    loaded.runs.require_finished()
    with shown_also_if_incomplete(), observing(quiet=quiet) as observer:
        outcome = run_study(loaded, observer=observer)
    show(outcome.summary, outcome.report)
