"""`strandline compare`: which model do the data prefer, of those of several finished studies?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli.study_folder import STUDY

__all__ = ["command"]


@click.command("compare")
@click.argument("studies", nargs=-1, type=STUDY)
@click.option(
    "--to", type=click.Path(path_type=Path), default="comparison", show_default=True, help="Folder of the result."
)
@click.option("--odds", metavar="NUMBERS", help="Prior odds of the models in their order, e.g. 2:1; equal by default.")
@click.option(
    "--separate", is_flag=True, help="Rank the candidates under `next` by how well they tell the models apart."
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random numbers.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(studies: tuple[Path, ...], to: Path, odds: str | None, separate: bool, seed: int, quiet: bool) -> None:
    """Compare the models of finished STUDIES of the same data: evidences, Bayes factors, averaged posterior.

    The surrogate of the interface stands in for the simulator: without --separate, no forward run is made.
    """
    from strandline.cli.progress import observing
    from strandline.questions.compare.study_comparison import compare, odds_in

    given = odds_in(odds)
    with observing(quiet=quiet) as observer:
        found = compare(studies, to=to, odds=given, separate=separate, seed=seed, observer=observer)
    _show(found.content, found.page)


def _show(content: Mapping[str, Any], page: Path) -> None:
    """Print the verdict, the models, the Bayes factors, the averaged posterior and what would separate the models."""
    click.echo(f"\n{content['verdict']}")
    for remark in content["remarks"]:
        click.echo(remark)
    width = max(8, *map(len, content["models"]))
    click.echo(f"{'model':>{width}} {'log-evidence':>15} {'best log L':>11} {'probability':>12}   misfit")
    for name, one in content["models"].items():
        evidence = f"{one['log_evidence']:.2f} ± {one['error']:.2f}"
        misfit = "not judged" if one["misfit"] is None else "noticed" if one["misfit"]["flagged"] else "none"
        click.echo(
            f"{name:>{width}} {evidence:>15} {one['best_log_likelihood']:>11.2f} {one['probability']:>12.1%}   {misfit}"
        )
    for one in content["bayes_factors"]:
        flat = "" if one["flat_ln"] is None else f"; with uniform priors {one['flat_ln']:.2f}, {one['flat_words']}"
        parts = f"fit {one['fit']:.2f}, prior {one['prior']:.2f}{flat}"
        bayes = f"ln B = {one['ln']:.2f} ± {one['error']:.2f}, {one['words']}"
        click.echo(f"{one['of']} over {one['over']}: {bayes} ({parts})")
    if content["averaged"]:
        click.echo(f"{'averaged':>10} {'unit':>7} {'mean':>10} {'sd':>9} {'5 %':>10} {'95 %':>10}")
    for name, item in content["averaged"].items():
        unit = "" if item["unit"] == "1" else item["unit"]
        mean, sd, low, high = (f"{item[key]:.4g}" for key in ("mean", "sd", "q05", "q95"))
        click.echo(f"{name:>10} {unit:>7} {mean:>10} {sd:>9} {low:>10} {high:>10}")
    for one in content["separate"]:
        click.echo(f"{one['candidate']}: {_separation(one)}")
    click.echo(f"page: {page}")


def _separation(one: Mapping[str, Any]) -> str:
    """Return what a candidate is expected to tell about the models, in words."""
    if one["nats"] is None:
        return str(one["problem"])
    doubt = "" if one["reliable"] else " (few draws)"
    often = f"{one['clearly_right']:.0%} of cases{doubt}"
    return f"{one['nats']:.2f} nats about which model is right; it becomes clear in {often}"
