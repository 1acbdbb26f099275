"""`strandline coverage`: would the intervals of a finished study contain the truth as often as they say?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli.study_folder import STUDY

__all__ = ["command"]


@click.command("coverage")
@click.argument("study", type=STUDY)
@click.option("--replicates", type=int, default=200, show_default=True, help="Repetitions, at least 20.")
@click.option(
    "--from",
    "source",
    type=click.Choice(["prior", "posterior"]),
    default="prior",
    show_default=True,
    help="Where the true inputs come from.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random numbers.")
@click.option("--measure", metavar="NAME", help="A measure of the study; its first by default.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(study: Path, replicates: int, source: str, seed: int, measure: str | None, quiet: bool) -> None:
    """Repeat the experiment of STUDY at other true inputs and count how often its intervals contain them.

    The surrogate of the interface stands in for the simulator: no forward run is made. Run it again to resume.
    """
    from strandline.cli.progress import observing
    from strandline.questions.coverage.study_coverage import coverage
    from strandline.studies import load_study

    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        found = coverage(loaded, replicates=replicates, source=source, seed=seed, measure=measure, observer=observer)
    _show(found.content, found.page)


def _show(content: Mapping[str, Any], page: Path) -> None:
    """Print the verdict, the table of the inputs, and what was drawn."""
    click.echo(f"\n{content['study']}: {content['replicates']} replicates, truths from the {content['source']}")
    for remark in content["remarks"]:
        click.echo(remark)
    heads = ("50 %", "90 %", "z mean", "z sd", "mean sd", "of limit")
    click.echo(f"{'input':>10} {'unit':>7} " + " ".join(f"{head:>9}" for head in heads))
    for name, item in content["inputs"].items():
        unit = "" if item["unit"] == "1" else item["unit"]
        shares = " ".join(f"{one['found']:>9.1%}" for one in item["intervals"])
        rest = f"{item['z_mean']:>+9.2f} {item['z_sd']:>9.2f} {item['sd']:>9.3g} {item['of_limit']:>9.2f}"
        click.echo(f"{name:>10} {unit:>7} {shares} {rest}")
    regions = " and ".join(f"{one['found']:.1%}" for one in content["log_likelihood"]["regions"])
    click.echo(f"truth among the 50 % and the 90 % of the draws that fit best: {regions}")
    for one in content["noise"]:
        click.echo(f"{one['condition'] or 'drawn with'}: {one['in_words']}")
    sampling = content["sampling"]
    click.echo(
        f"{sampling['importance']} posteriors by importance sampling, {sampling['smc']} by tempering\npage: {page}"
    )
