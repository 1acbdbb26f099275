"""`strandline next`: which experiment would teach most?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli.study_folder import STUDY

__all__ = ["command"]

SHOWN = 15
"""Candidates that are printed."""


@click.command("next")
@click.argument("study", type=STUDY)
@click.option(
    "--from",
    "source",
    type=click.Choice(["prior", "posterior"]),
    help="Where to begin; by default from the posterior if there is one.",
)
@click.option("--draws", type=int, default=1000, show_default=True, help="Draws of the posterior.")
@click.option("--runs", type=int, default=8, show_default=True, help="Draws of the prior at which candidates are run.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random numbers.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(study: Path, source: str | None, draws: int, runs: int, seed: int, quiet: bool) -> None:
    """Rank the candidates for the next experiment, which STUDY lists under `next`, by what they would teach.

    If the study is finished, a candidate costs one forward run or none; without sensitivities, one more for each input.
    Otherwise it is run at a few draws of the prior.
    """
    from strandline.cli.progress import observing
    from strandline.questions.next.next_experiment import next_experiment
    from strandline.studies import load_study

    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        found = next_experiment(loaded, source=source, draws=draws, runs=runs, seed=seed, observer=observer)
    _show(found.content, found.page)


def _show(content: Mapping[str, Any], page: Path) -> None:
    """Print the advice, the table of the candidates, and what the picture determines."""
    known = "from its posterior" if content["source"] == "posterior" else "before any data, from the prior (linearised)"
    click.echo(f"\n{content['study']}: the next experiment, {known}")
    click.echo(content["advice"])
    names = list(content["inputs"])
    heads = "".join(f"{f'sd({name})':>12}" for name in names)
    width = max(len(one["label"]) for one in content["candidates"][:SHOWN])
    click.echo(f"{'candidate':<{max(width, 9)}} {'gain, nats':>14}{heads}{'fails':>8}{'moved':>10}")
    now = "".join(f"{item['sd']:>12.3g}" for item in content["inputs"].values())
    click.echo(f"{'(now)':<{max(width, 9)}} {'':>14}{now}")
    for one in content["candidates"][:SHOWN]:
        click.echo(f"{one['label']:<{max(width, 9)}} {_row(one, names)}")
    rest = len(content["candidates"]) - SHOWN
    if rest > 0:
        click.echo(f"{rest} more in {page.with_suffix('.json')}")
    for line in content["identifiability"]:
        click.echo(line)
    for one in content["noise"]:
        click.echo(f"{one['condition'] or 'noise'}: {one['in_words']}")
    runs = content["runs"]
    click.echo(f"{runs['new']} new forward runs, {runs['reused']} known; {content['seconds']:.1f} s\npage: {page}")


def _row(one: Mapping[str, Any], names: list[str]) -> str:
    if one["gain"] is None:
        return str(one["problem"])
    gain = f"{one['gain']:.2f} ± {one['error']:.2f}" if one["error"] else f"{one['gain']:.2f}"
    sds = "".join(f"{one['sd'][name]:>12.3g}" for name in names)
    fails = "–" if one["failing"] is None else f"{100 * one['failing']:.0f} %"
    moved = "–" if one["displacement_in_sd"] is None else f"{one['displacement_in_sd']:.3g} sd"
    return f"{gain:>14}{sds}{fails:>8}{moved:>10}"
