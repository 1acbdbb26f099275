"""`strandline specimens`: many specimens, analysed with the runs of one finished study."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli.study_folder import STUDY
from strandline.text import with_sd

__all__ = ["command"]


@click.command("specimens")
@click.argument("study", type=STUDY)
@click.option(
    "--refine",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Largest number of further runs, made where the surrogate is too coarse.",
)
@click.option("--watch", is_flag=True, help="Wait for new files and analyse each as it arrives, until Ctrl-C.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random numbers.")
@click.option("--measure", metavar="NAME", help="A measure of the study; its first by default.")
@click.option("--processes", type=click.IntRange(min=1), help="Processes that share the work; by default one per core.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(
    study: Path, refine: int, watch: bool, seed: int, measure: str | None, processes: int | None, quiet: bool
) -> None:
    """Analyse all specimens that STUDY names, through the surrogate of its finished runs, and their population.

    Without --refine, no forward run is made. Run it again to resume, or after adding specimens.
    """
    from strandline.cli.progress import observing
    from strandline.questions.specimens.study_specimens import specimens
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
        found = specimens(loaded, refine=refine, seed=seed, measure=measure, processes=processes, observer=observer)
    _show(found.content, found.page)


def _show(content: Mapping[str, Any], page: Path) -> None:
    """Print the counts, the population and the remarks."""
    counts, surrogate = content["counts"], content["surrogate"]
    made = f", {surrogate['made']} of them new" if surrogate["made"] else ""
    click.echo(
        f"\n{content['study']}: {counts['analysed']} specimens from {surrogate['runs']} runs{made}; "
        f"{counts['good']} good, {counts['refine']} to refine, {counts['set_aside']} set aside"
    )
    if content["population"] is not None:
        click.echo(f"{'population':>10} {'unit':>7} {'mean':>22} {'spread':>22}")
        for line in _population(content):
            click.echo(line)
        if not content["population"]["outliers"]:
            click.echo("no outliers")
    for remark in content["remarks"]:
        click.echo(remark)
    for one in content["set_aside"]:
        click.echo(f"{one['specimen']}: {one['why']}")
    click.echo(f"table: {page.with_suffix('.csv')}\npage: {page}")


def _population(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each input: mean and spread with their standard deviations."""
    for name, item in content["population"]["inputs"].items():
        unit = content["inputs"][name]["unit"]
        parts = (with_sd(item[part]["mean"], item[part]["sd"]) for part in ("mean", "spread"))
        mean, spread = parts
        yield f"{name:>10} {'' if unit == '1' else unit:>7} {mean:>22} {spread:>22}"


def _watch(study: Any, seed: int, measure: str | None) -> None:
    """Print a line for each specimen as it arrives."""
    from strandline.population import Refused
    from strandline.questions.specimens.watch import watch_specimens

    def ready(known: int) -> None:
        click.echo(f"{study.name}: {known} specimens known; waiting for new ones (Ctrl-C ends)")

    for arrived in watch_specimens(study, seed=seed, measure=measure, ready=ready):
        one = arrived.answer
        if isinstance(one, Refused):
            click.echo(f"{one.name}: set aside: {one.why}")
            continue
        pairs = zip(one.space.names, one.mean, one.sd, strict=True)
        values = ", ".join(f"{name} {with_sd(mean, sd)}" for name, mean, sd in pairs)
        click.echo(f"{one.name}: {values}; {one.certified.verdict} ({arrived.seconds:.2f} s)")
