"""`strandline init`: a commented study folder that runs."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.registry import suggestion
from strandline.studies.template import EXAMPLES, OWN, write_example

if TYPE_CHECKING:
    from strandline.studies.template import Observed

NOT_NEGATIVE = click.FloatRange(min=0)
QUESTIONS = {
    "length": "Over what length along the interface do neighbouring points err together, in µm? (0: not at all)",
    "shift": "How far may the whole interface be shifted, in µm?",
    "rotation": "How far may it be turned, in degrees?",
    "scale": "How wrong may its scale be, as a share? (0.005: half a per cent)",
    "offset": "How far may all points be too far in or out, in µm? (a threshold: never 0)",
}
"""Questions about the errors of the observed points that have a default: none."""


def _size(ctx: click.Context | None, param: click.Parameter | None, value: Any) -> float | str | None:
    """Return a number that is not negative, `unknown`, or None."""
    if value is None or value == "unknown":
        return value if value is None else "unknown"
    return float(NOT_NEGATIVE.convert(value, param, ctx))


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
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--example", type=_Example(list(EXAMPLES)), help="Which example to write; by default the first.")
@click.option("--observed", type=click.Path(path_type=Path), help="Your interface: a file with a point x, y per line.")
@click.option("--unit", type=click.Choice(["mm", "um", "m"]), help="Unit of its coordinates.")
@click.option("--sd", callback=_size, help="Standard deviation of one of its points, in µm, or `unknown`.")
@click.option(
    "--length", callback=_size, help="Length over which neighbouring points err together, in µm, or `unknown`."
)
@click.option("--shift", type=NOT_NEGATIVE, help="Standard deviation of its position, in µm.")
@click.option("--rotation", type=NOT_NEGATIVE, help="Standard deviation of its rotation, in degrees.")
@click.option("--scale", type=NOT_NEGATIVE, help="Standard deviation of its scale, as a share.")
@click.option("--offset", type=NOT_NEGATIVE, help="Standard deviation of a common offset along the normals, in µm.")
def command(folder: Path, example: str | None, observed: Path | None, **stated: Any) -> None:
    """Write FOLDER/study.yaml, a commented study that runs as it is (a biofilm, at most 80 forward runs).

    With --example it writes all files of another example. With --observed it is a study of your own interface, which
    --example python or command combines with your own simulator; what you do not state about its errors, it asks.
    """
    import shlex

    _require_own(example, {"observed": observed, **stated})
    _require_observed(observed, stated)
    path = write_example(example or "biofilm", folder, None if observed is None else _asked(observed, stated))
    name = shlex.quote(str(folder))
    click.echo(f"wrote {path}")
    if observed is not None:
        click.echo("adapt there: model, fixed and inputs with their comments, an example's and not read from your file")
    click.echo(f"next: strandline check {name}, then strandline run {name}")


def _require_own(example: str | None, others: dict[str, Any]) -> None:
    """Refuse options about an observed interface beside an example that is about its own."""
    from strandline.errors import InvalidStudy

    given = [f"--{name}" for name, value in others.items() if value is not None]
    if example is not None and example not in OWN and given:
        raise InvalidStudy(
            f"--example {example} comes with its own observation",
            value=", ".join(given),
            expected=f"--example alone, or one of {', '.join(OWN)}",
            remedy=f"Take --example command for a simulator of your own, or leave out {' and '.join(given)}.",
        )


def _require_observed(observed: Path | None, stated: dict[str, Any]) -> None:
    """Refuse errors without an observed interface, and a file that is not there."""
    from strandline.errors import InvalidStudy

    given = [f"--{name}" for name, value in stated.items() if value is not None]
    if observed is None and given:
        raise InvalidStudy(
            f"{given[0]} describes an observed interface",
            value="none",
            expected="--observed FILE too",
            remedy=f"Add --observed, or leave out {', '.join(given)}.",
        )
    if observed is not None and not observed.is_file():
        raise InvalidStudy(
            "--observed", value=str(observed), expected="a file with a point x, y per line", remedy="Correct the path."
        )


def _asked(observed: Path, stated: dict[str, Any]) -> "Observed":
    """Return what is known about the observed interface; ask for the rest if somebody can answer."""
    from strandline.errors import InvalidStudy
    from strandline.studies.template import Observed

    if not sys.stdin.isatty() and (stated["unit"] is None or stated["sd"] is None):
        missing = "--unit" if stated["unit"] is None else "--sd"
        raise InvalidStudy(
            f"{missing} of the observed interface",
            value="nothing",
            expected="--unit mm and --sd 3, say: nobody is there to ask",
            remedy=f"Add {missing}.",
        )
    ask, found = sys.stdin.isatty(), dict(stated)
    if found["unit"] is None:
        found["unit"] = click.prompt(
            f"Unit of the coordinates in {observed.name}", type=click.Choice(["mm", "um", "m"])
        )
    if found["sd"] is None:
        text = "How far may one point be off, as a standard deviation in µm? (`unknown`: estimate it)"
        found["sd"] = _answer(text)
    for name, text in QUESTIONS.items():
        if found[name] is None:
            found[name] = _answer(text, default="0") if ask else 0.0
    if found["sd"] == 0:
        raise InvalidStudy("--sd", value=0, expected="a number above 0, or `unknown`", remedy="Correct it.")
    for name in ("shift", "rotation", "scale", "offset"):
        if found[name] == "unknown":
            raise InvalidStudy(f"--{name}", value="unknown", expected="a number, 0 or above", remedy="Estimate it.")
    known: dict[str, Any] = {name: None if value == "unknown" else value for name, value in found.items()}
    return Observed(observed, **known)


def _answer(question: str, default: str | None = None) -> float | str | None:
    """Return the answer to a question about a size."""
    found: float | str | None = click.prompt(question, default, value_proc=lambda typed: _size(None, None, typed))
    return found
