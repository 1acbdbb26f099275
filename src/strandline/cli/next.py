"""`strandline next`: which experiment would teach most?"""

from pathlib import Path

import click

from strandline.cli import options


@click.command("next")
@options.study
@click.option(
    "--from",
    "source",
    type=click.Choice(["prior", "posterior"]),
    help="Where to begin; by default from the posterior if there is one.",
)
@click.option("--draws", type=int, default=1000, show_default=True, help="Draws of the posterior.")
@click.option("--runs", type=int, default=8, show_default=True, help="Draws of the prior at which candidates are run.")
@options.seed
@options.quiet
def command(study: Path, source: str | None, draws: int, runs: int, seed: int, quiet: bool) -> None:
    """Rank the candidates for the next experiment, which STUDY lists under `next`, by what they would teach.

    If the study is finished, a candidate costs one forward run or none; without sensitivities, one more for each input.
    Otherwise it is run at a few draws of the prior.
    """
    from strandline.cli.progress import observing
    from strandline.questions.next import next_experiment
    from strandline.studies import load_study

    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        answer = next_experiment(loaded, source=source, draws=draws, runs=runs, seed=seed, observer=observer)
    click.echo(answer)
