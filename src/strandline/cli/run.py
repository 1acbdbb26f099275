"""`strandline run`: the whole study."""

from pathlib import Path

import click

from strandline.cli import device as devices

__all__ = ["command"]


@click.command("run")
@click.argument("study", type=click.Path(path_type=Path))
@click.option("--workers", type=click.IntRange(min=1), help="Worker processes, if not as study.yaml says.")
@devices.option
@click.option("--quiet", is_flag=True, help="Tell only the result.")
def command(study: Path, workers: int | None, device: str | None, quiet: bool) -> None:
    """Do the whole of STUDY (a folder): forward runs, surrogate, posterior, figures, report.

    Finished runs are kept: started again, it goes on where it was stopped.
    """
    devices.use(device)
    from dataclasses import replace

    from strandline.cli.progress import observing
    from strandline.cli.results import show
    from strandline.runs import LocalProcesses
    from strandline.studies import load_study, run_study

    loaded = load_study(study)
    executor = loaded.executor
    if workers is not None and isinstance(executor, LocalProcesses):
        executor = replace(executor, workers=workers)
    with observing(quiet=quiet) as observer:
        outcome = run_study(loaded, executor=executor, observer=observer)
    show(outcome.summary, outcome.report)
