"""`strandline compare`: which model do the data prefer, of those of several finished studies?"""

from pathlib import Path

import click

from strandline.cli import options


@click.command("compare")
@click.argument("studies", nargs=-1, type=options.STUDY)
@click.option(
    "--to", type=click.Path(path_type=Path), default="comparison", show_default=True, help="Folder of the result."
)
@click.option("--odds", metavar="NUMBERS", help="Prior odds of the models in their order, e.g. 2:1; equal by default.")
@click.option(
    "--separate", is_flag=True, help="Rank the candidates under `next` by how well they tell the models apart."
)
@options.seed
@options.quiet
def command(studies: tuple[Path, ...], to: Path, odds: str | None, separate: bool, seed: int, quiet: bool) -> None:
    """Compare the models of finished STUDIES of the same data: evidences, Bayes factors, averaged posterior.

    The surrogate of the interface stands in for the simulator: without --separate, no forward run is made.
    """
    from strandline.cli.progress import observing
    from strandline.questions.compare import compare, odds_in

    given = odds_in(odds)
    with observing(quiet=quiet) as observer:
        answer = compare(studies, to=to, odds=given, separate=separate, seed=seed, observer=observer)
    click.echo(answer)
