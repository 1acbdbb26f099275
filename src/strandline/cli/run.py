"""`strandline run`: the whole study."""

from pathlib import Path

import click

from strandline.cli import device as devices
from strandline.cli.study_folder import STUDY

__all__ = ["command"]


@click.command("run")
@click.argument("study", type=STUDY)
@click.option("--workers", type=click.IntRange(min=1), help="Worker processes, if not as study.yaml says.")
@devices.option
@click.option("--detach", is_flag=True, help="Submit the runs of a SLURM array and leave; `run` again collects them.")
@click.option("--json", "as_json", is_flag=True, help="Print the content of summary.json as one JSON object.")
@click.option("--log", type=click.Path(path_type=Path, dir_okay=False), help="Add the progress, with times, to a file.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(
    study: Path, workers: int | None, device: str | None, detach: bool, as_json: bool, log: Path | None, quiet: bool
) -> None:
    """Do the whole of STUDY (a folder): forward runs, surrogate, posterior, figures, report.

    Finished runs are kept: started again, it goes on where it was stopped. A finished study is computed again only if
    its study.yaml, model, observation or runs have changed.
    """
    devices.use(device)
    from strandline.cli.detached import submit, told_what_goes_on
    from strandline.cli.journal import say_journal
    from strandline.cli.progress import observing, require_log
    from strandline.cli.results import show, shown_also_if_incomplete
    from strandline.runs.executors import with_workers
    from strandline.studies import load_study, run_study
    from strandline.studies.folder import REPORT
    from strandline.studies.unchanged import results_at_hand

    loaded = load_study(study)
    require_log(log)
    if (found := results_at_hand(loaded)) is not None:
        show(found, loaded.folder / REPORT, as_json=as_json)
        if not quiet and not as_json:
            click.echo(f"Nothing has changed since. To write the results again: strandline report {study}")
        return
    say_journal(loaded, quiet=quiet)
    executor = with_workers(loaded.executor, workers)
    with shown_also_if_incomplete(as_json=as_json), observing(quiet=quiet, log=log) as observer:
        if detach:
            submit(loaded, executor, observer)
            return
        with told_what_goes_on(loaded, executor):
            outcome = run_study(loaded, executor=executor, observer=observer)
    show(outcome.summary, outcome.report, as_json=as_json)
