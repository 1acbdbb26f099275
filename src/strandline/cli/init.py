"""`strandline init`: a commented study folder that runs."""

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from strandline.cli import options
from strandline.foundations import suggestion
from strandline.studies import EXAMPLES, OWN, Observed, write_example


class _Size(click.FloatRange):
    """A number in a range, or `unknown`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number or the word."""
        return value if value == "unknown" else super().convert(value, param, ctx)


NOT_NEGATIVE, SD, LENGTH = click.FloatRange(min=0), _Size(min=0, min_open=True), _Size(min=0)
QUESTIONS: dict[str, tuple[str, click.FloatRange]] = {
    "length": (
        "Over what length along the interface do neighbouring points err together, in µm? (0: not at all)",
        LENGTH,
    ),
    "shift": ("How far may the whole interface be shifted, in µm?", NOT_NEGATIVE),
    "rotation": ("How far may it be turned, in degrees?", NOT_NEGATIVE),
    "scale": ("How wrong may its scale be, as a share? (0.005: half a per cent)", NOT_NEGATIVE),
    "offset": ("How far may all points be too far in or out, in µm? (a threshold: never 0)", NOT_NEGATIVE),
}
"""Questions about the errors of the observed points that have a default: none."""


class _Init(click.Command):
    """The command, whose help lists the examples."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Examples"):
            formatter.write_dl(list(EXAMPLES.items()))


class _Example(click.Choice[str]):
    """The name of an example; for an unknown one, the nearest is suggested."""

    def get_invalid_choice_message(self, value: Any, ctx: click.Context | None) -> str:
        """Return the message for an unknown example."""
        return f"{super().get_invalid_choice_message(value, ctx)} {suggestion(str(value), EXAMPLES, '')}".rstrip()


@click.command("init", cls=_Init)
@click.argument("folder", type=options.PATH)
@click.option("--example", type=_Example(list(EXAMPLES)), help="Which example to write; by default the first.")
@click.option(
    "--observed",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Your interface: a file with a point x, y per line.",
)
@click.option("--unit", type=options.UNIT, help="Unit of its coordinates.")
@click.option("--sd", type=SD, help="Standard deviation of one of its points, in µm, or `unknown`.")
@click.option("--length", type=LENGTH, help="Length over which neighbouring points err together, in µm, or `unknown`.")
@click.option("--shift", type=NOT_NEGATIVE, help="Standard deviation of its position, in µm.")
@click.option("--rotation", type=NOT_NEGATIVE, help="Standard deviation of its rotation, in degrees.")
@click.option("--scale", type=NOT_NEGATIVE, help="Standard deviation of its scale, as a share.")
@click.option("--offset", type=NOT_NEGATIVE, help="Standard deviation of a common offset along the normals, in µm.")
def init(folder: Path, example: str | None, observed: Path | None, **stated: Any) -> None:
    """Write FOLDER/study.yaml, a commented study that runs as it is (a biofilm, at most 80 forward runs).

    With --example it writes all files of another example. With --observed it is a study of your own interface, which
    --example python or command combines with your own simulator; what you do not state about its errors, it asks.
    """
    given = [f"--{name}" for name, value in stated.items() if value is not None]
    if observed is None and given:
        raise click.UsageError(f"{' and '.join(given)}: only for an observed interface; add --observed FILE.")
    if observed is not None and example not in (None, *OWN):
        raise click.UsageError(
            f"--example {example} has an observation of its own: take one of {', '.join(OWN)}, or leave out --observed."
        )
    path = write_example(example or "biofilm", folder, None if observed is None else _asked(observed, stated))
    name = shlex.quote(str(folder))
    click.echo(f"wrote {path}")
    if observed is not None:
        click.echo("adapt there: model, fixed and inputs with their comments, an example's and not read from your file")
    click.echo(f"next: strandline check {name}, then strandline run {name}")


def _asked(observed: Path, stated: dict[str, Any]) -> Observed:
    """Return what is known about the observed interface; ask for the rest if somebody can answer."""
    ask, found = sys.stdin.isatty(), dict(stated)
    missing = [f"--{name}" for name in ("unit", "sd") if found[name] is None]
    if missing and not ask:
        raise click.UsageError(f"Nobody is there to ask: add {' and '.join(missing)}, such as --unit mm --sd 3 (µm).")
    if found["unit"] is None:
        found["unit"] = click.prompt(f"Unit of the coordinates in {observed.name}", type=options.UNIT)
    if found["sd"] is None:
        text = "How far may one point be off, as a standard deviation in µm? (`unknown`: estimate it)"
        found["sd"] = click.prompt(text, type=SD)
    for name, (text, kind) in QUESTIONS.items():
        if found[name] is None:
            found[name] = click.prompt(text, "0", type=kind) if ask else 0.0
    known: dict[str, Any] = {name: None if value == "unknown" else value for name, value in found.items()}
    return Observed(observed, **known)
