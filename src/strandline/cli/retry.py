"""`strandline retry`: make failed runs again."""

from pathlib import Path

import click

from strandline.cli import options


@click.command("retry")
@options.study
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    required=True,
    metavar="KIND",
    help="Kind of failure, or a state: failed, timeout, killed, invalid. May be given several times.",
)
@options.workers
@options.quiet
def command(study: Path, kinds: tuple[str, ...], workers: int | None, quiet: bool) -> None:
    """Make the runs of STUDY that failed with KIND again, then the runs still missing, then the results.

    The earlier outcomes stay in the ledger; the last one of each run counts.
    """
    from dataclasses import replace

    from strandline.cli.progress import observing, say_journal
    from strandline.cli.results import show, shown_also_if_incomplete
    from strandline.runs.executors import with_workers
    from strandline.runs.failures import require_kinds
    from strandline.studies import load_study, run_study

    loaded = load_study(study)
    require_kinds(kinds, loaded.runs.failure_kinds)
    say_journal(loaded, quiet=quiet)
    policy = replace(loaded.settings.failures, again=frozenset(kinds))
    loaded = replace(loaded, settings=replace(loaded.settings, failures=policy))
    executor = with_workers(loaded.executor, workers)
    with shown_also_if_incomplete(), observing(quiet=quiet) as observer:
        outcome = run_study(loaded, executor=executor, observer=observer)
    show(outcome.summary, outcome.report)
