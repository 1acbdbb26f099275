"""`strandline what-if`: how would the posterior of a finished study change with other assumptions?"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from strandline.cli.study_folder import STUDY

__all__ = ["command"]

HOW = {"reweighting": "reweighting", "importance": "new draws", "smc": "new draws", None: "needs new runs"}
WIDEST = 44
"""Most characters of the name of an alternative."""


@click.command("what-if")
@click.argument("study", type=STUDY)
@click.option(
    "--ask",
    "asked",
    multiple=True,
    metavar="CHANGE",
    help="Ask only this, with the keys of what_if: '{noise: {sd: 5, unit: um}}'. May be repeated.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random numbers.")
@click.option("--quiet", is_flag=True, help="Print only the result.")
def command(study: Path, asked: tuple[str, ...], seed: int, quiet: bool) -> None:
    """Ask how the posterior of STUDY changes with its priors, noise, measure and nuisance inputs.

    The draws of the posterior get other weights, or new ones come from the surrogate: no forward run is made.
    """
    from strandline.cli.progress import observing
    from strandline.questions.what_if.study_what_if import what_if
    from strandline.studies import load_study

    alternatives = [_change(text) for text in asked] or None
    loaded = load_study(study)
    with observing(quiet=quiet) as observer:
        found = what_if(loaded, alternatives, seed=seed, observer=observer)
    _show(found.content, found.page)


def _change(text: str) -> dict[str, Any]:
    from strandline.errors import InvalidInput
    from strandline.studies.text import load_yaml

    found = load_yaml(text)
    if not isinstance(found, dict):
        raise InvalidInput(
            "--ask", value=text, expected="keys with values", remedy="Write e.g. --ask '{noise: {sd: 5, unit: um}}'."
        )
    return found


def _show(content: Mapping[str, Any], page: Path) -> None:
    """Print the conclusion and a row for each alternative."""
    some = content["alternatives"]
    number = f"{len(some)} alternative{'s' * (len(some) != 1)}"
    click.echo(f"\n{content['study']}: {number}, no forward run\n{content['conclusion']}")
    for remark in content["remarks"]:
        click.echo(remark)
    width = min(max([len("what changed"), *(len(one["name"]) for one in some)]), WIDEST)
    click.echo(f"\n{'what changed':<{width}}  {'by':<14} {'k̂':>6} {'draws':>6}  moves")
    for one in some:
        click.echo(
            f"{one['name']:<{width}}  {HOW[one['by']]:<14} {_k_hat(one):>6} {one['effective']:>6.0f}  {_effect(one)}"
        )
    click.echo(f"page: {page}")


def _k_hat(one: Mapping[str, Any]) -> str:
    value = one["k_hat"]
    return "–" if value is None else f"{value:.2f}"


def _effect(one: Mapping[str, Any]) -> str:
    """Return the inputs that move; else the largest shift."""
    if one["why_not"]:
        return str(one["why_not"])
    moving = {name: item for name, item in one["inputs"].items() if item["moves"]}
    if moving:
        return ", ".join(f"{name} {item['shift']:+.2f} sd ×{item['sd_ratio']:.2f}" for name, item in moving.items())
    name, item = max(one["inputs"].items(), key=lambda pair: abs(pair[1]["shift"]))
    return f"– ({name} {item['shift']:+.2f} sd ×{item['sd_ratio']:.2f})"
