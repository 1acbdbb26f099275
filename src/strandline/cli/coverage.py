"""`strandline coverage`: would the intervals of a finished study contain the truth as often as they say?"""

from pathlib import Path

import click

from strandline.cli import options


@click.command("coverage")
@options.study
@click.option("--replicates", type=int, default=200, show_default=True, help="Repetitions, at least 20.")
@click.option(
    "--from",
    "source",
    type=click.Choice(["prior", "posterior"]),
    default="prior",
    show_default=True,
    help="Where the true inputs come from.",
)
@options.seed
@options.measure
@options.quiet
def command(study: Path, replicates: int, source: str, seed: int, measure: str | None, quiet: bool) -> None:
    """Repeat the experiment of STUDY at other true inputs and count how often its intervals contain them.

    The surrogate of the interface stands in for the simulator: no forward run is made. Run it again to resume.
    """
    from strandline.cli.progress import observing
    from strandline.questions.coverage import coverage
    from strandline.studies import load_study

    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        answer = coverage(loaded, replicates=replicates, source=source, seed=seed, measure=measure, observer=observer)
    click.echo(answer)
