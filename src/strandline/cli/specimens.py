"""`strandline specimens`: many specimens, analysed with the runs of one finished study."""

from pathlib import Path
from typing import Any

import click

from strandline.cli import options
from strandline.text import with_sd


@click.command("specimens")
@options.study
@click.option(
    "--refine",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Largest number of further runs, made where the surrogate is too coarse.",
)
@click.option("--watch", is_flag=True, help="Wait for new files and analyse each as it arrives, until Ctrl-C.")
@options.seed
@options.measure
@click.option("--processes", type=click.IntRange(min=1), help="Processes that share the work; by default one per core.")
@options.quiet
def command(
    study: Path, refine: int, watch: bool, seed: int, measure: str | None, processes: int | None, quiet: bool
) -> None:
    """Analyse all specimens that STUDY names, through the surrogate of its finished runs, and their population.

    Without --refine, no forward run is made. Run it again to resume, or after adding specimens.
    """
    from strandline.cli.progress import observing
    from strandline.questions.specimens import specimens
    from strandline.studies import load_study

    loaded = load_study(study)
    if watch:
        if refine:
            raise click.UsageError("--watch makes no forward runs: run `strandline specimens --refine` first.")
        if processes is not None:
            raise click.UsageError("--watch analyses one file at a time: leave out --processes.")
        _watch(loaded, seed, measure)
        return
    with observing(quiet=quiet) as observer:
        answer = specimens(loaded, refine=refine, seed=seed, measure=measure, processes=processes, observer=observer)
    click.echo(answer)


def _watch(study: Any, seed: int, measure: str | None) -> None:
    """Print a line for each specimen as it arrives."""
    from strandline.questions.many import RefusedSpecimen
    from strandline.questions.specimens import watch_specimens

    def ready(known: int) -> None:
        click.echo(f"{study.name}: {known} specimens known; waiting for new ones (Ctrl-C ends)")

    for arrived in watch_specimens(study, seed=seed, measure=measure, ready=ready):
        one = arrived.answer
        if isinstance(one, RefusedSpecimen):
            click.echo(f"{one.name}: set aside: {one.why}")
            continue
        pairs = zip(one.space.names, one.mean, one.sd, strict=True)
        values = ", ".join(f"{name} {with_sd(mean, sd)}" for name, mean, sd in pairs)
        click.echo(f"{one.name}: {values}; {one.certified.verdict} ({arrived.seconds:.2f} s)")
