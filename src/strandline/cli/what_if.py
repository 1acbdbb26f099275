"""`strandline what-if`: how would the posterior of a finished study change with other assumptions?"""

from pathlib import Path
from typing import Any

import click

from strandline.cli import options


@click.command("what-if")
@options.study
@click.option(
    "--ask",
    "asked",
    multiple=True,
    metavar="CHANGE",
    help="Ask only this, with the keys of what_if: '{noise: {sd: 5, unit: um}}'. May be repeated.",
)
@options.seed
@options.quiet
def command(study: Path, asked: tuple[str, ...], seed: int, quiet: bool) -> None:
    """Ask how the posterior of STUDY changes with its priors, noise, measure and nuisance inputs.

    The draws of the posterior get other weights, or new ones come from the surrogate: no forward run is made.
    """
    from strandline.cli.progress import observing
    from strandline.questions.what_if import what_if
    from strandline.studies import load_study

    alternatives = [_change(text) for text in asked] or None
    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        answer = what_if(loaded, alternatives, seed=seed, observer=observer)
    click.echo(answer)


def _change(text: str) -> dict[str, Any]:
    from strandline.errors import InvalidInput
    from strandline.studies.text import load_yaml

    found = load_yaml(text)
    if not isinstance(found, dict):
        raise InvalidInput(
            "--ask", value=text, expected="keys with values", remedy="Write e.g. --ask '{noise: {sd: 5, unit: um}}'."
        )
    return found
