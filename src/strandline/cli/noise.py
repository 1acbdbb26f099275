"""`strandline noise`: the errors of measured contours, as the key `noise` of study.yaml."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.foundations import InvalidInput

if TYPE_CHECKING:
    from strandline.discrepancy import Repeats, Roughness


@click.command("noise")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(exists=True, path_type=Path))
@click.option("--unit", required=True, type=click.Choice(["mm", "um", "µm", "m"]), help="Unit of the coordinates.")
@click.option("--window", type=float, metavar="LENGTH", help="One contour only: smooth it over this length, in UNIT.")
@click.option(
    "--read",
    "reading",
    multiple=True,
    metavar="NAME=VALUE",
    help="How to read the files, e.g. columns=[x,y]; repeatable.",
)
def command(files: tuple[Path, ...], unit: str, window: float | None, reading: tuple[str, ...]) -> None:
    """Estimate the errors of the points in FILEs, and print the key `noise` for study.yaml.

    Several files, or a folder of them, are contours of one state from repeated pictures. A single file is compared with
    itself smoothed, which shows less.
    """
    from strandline.discrepancy import errors_from_repeats, errors_from_roughness
    from strandline.readers import TO_MM
    from strandline.studies import read_points

    paths, options = _files(files), _options(reading)
    contours = [read_points(path, unit, what="contour", options=options) for path in paths]
    if len(contours) == 1:
        found = errors_from_roughness(contours[0], window=None if window is None else TO_MM[unit] * window)
        points = f"{len(contours[0].points)} points {_length(found.spacing, unit)} apart"
        click.echo(f"1 contour of {points}, compared with itself smoothed over {_length(found.window, unit)}")
        _show(found, unit)
        return
    if window is not None:
        raise click.UsageError(f"--window smooths a single contour, not {len(contours)}: leave it out.")
    repeats = errors_from_repeats(contours)
    spacing = _length(repeats.spacing, unit)
    click.echo(f"{len(contours)} contours, compared at {repeats.places} places {spacing} apart")
    _show(repeats, unit)


def _show(found: "Roughness | Repeats", unit: str) -> None:
    """Print the errors, remarks, and the key for study.yaml."""
    errors, mm = found.errors, _in_mm(unit)
    alone = " (independent points: half their distance)" if errors.length < 0.501 * found.spacing else ""
    every = {"shift": errors.shift / mm, "rotation": errors.rotation, "scale": errors.scale}
    every["offset"] = errors.offset / mm
    common = {name: _digits(value) for name, value in every.items() if value > 0}
    units = {"shift": f" {unit}", "offset": f" {unit}", "rotation": " degrees", "scale": ""}
    click.echo(f"  sd of a point along the normal: {_length(errors.sd, unit)}")
    click.echo(f"  correlation length: {_length(errors.length, unit)}{alone}")
    if common:
        shown = ", ".join(f"{name} {digits}{units[name]}" for name, digits in common.items())
        click.echo(f"  common to all points of a contour, sd over the contours: {shown}")
    for note in found.notes:
        click.echo(f"  note: {note}")
    unknown = ", ".join(f"{name}: {digits}" for name, digits in common.items())
    stated = f"sd: {_digits(errors.sd / mm)}, length: {_digits(errors.length / mm)}, unit: {unit}"
    click.echo(f"for study.yaml:\nnoise: {{{stated}{f', unknown: {{{unknown}}}' if unknown else ''}}}")


def _length(mm: float, unit: str) -> str:
    return f"{_digits(mm / _in_mm(unit))} {unit}"


def _in_mm(unit: str) -> float:
    from strandline.readers import TO_MM

    return TO_MM[unit]


def _digits(value: float) -> str:
    """Return a number with three digits, without an exponent where that is short."""
    return f"{float(f'{value:.3g}'):g}"


def _files(given: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(one for one in path.iterdir() if one.is_file() and not one.name.startswith("."))
            if not inside:
                raise click.UsageError(f"{path} has no files: give a folder with a file for each contour.")
            found += inside
        else:
            found.append(path)
    return found


def _options(reading: Sequence[str]) -> dict[str, Any]:
    """Return how to read the files, with values as in study.yaml; what is no YAML, like a comma, is a text."""
    from strandline.studies import load_yaml

    found: dict[str, Any] = {}
    for text in reading:
        name, equals, value = text.partition("=")
        if not (equals and name.strip() and value.strip()):
            raise click.UsageError(f"--read: got {text}; expected NAME=VALUE, such as columns=[x,y].")
        try:
            found[name.strip()] = load_yaml(value)
        except InvalidInput:
            found[name.strip()] = value.strip()
    return found
