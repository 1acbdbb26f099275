"""`strandline noise`: the errors of measured contours, as the key `noise` of study.yaml."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.errors import InvalidInput

if TYPE_CHECKING:
    from strandline.discrepancy import Repeats, Roughness
    from strandline.interface import Interface, PointErrors


@click.command("noise")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--unit",
    required=True,
    metavar="UNIT",
    help="Unit of the coordinates: mm, um (or µm) or m.",
)
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
    from strandline.readers.options import TO_MM

    if unit not in TO_MM:
        raise _refused("--unit", unit, f"one of {', '.join(TO_MM)}", "Correct the option.")
    paths, options = _files(files), _options(reading)
    contours = [_contour(path, unit, options) for path in paths]
    if len(contours) == 1:
        found = errors_from_roughness(contours[0], window=None if window is None else TO_MM[unit] * window)
        _show(_of_one(found, len(contours[0].points), unit), found, unit)
        return
    if window is not None:
        raise _refused("--window", f"{window:g} with {len(contours)} files", "a single file", "Leave it out.")
    repeats = errors_from_repeats(contours)
    _show(_of_several(repeats, len(contours), unit), repeats, unit)


def _of_one(found: "Roughness", points: int, unit: str) -> str:
    step, window = _length(found.spacing, unit), _length(found.window, unit)
    return f"1 contour of {points} points {step} apart, compared with itself smoothed over {window}"


def _of_several(found: "Repeats", contours: int, unit: str) -> str:
    return f"{contours} contours, compared at {found.places} places {_length(found.spacing, unit)} apart"


def _show(compared: str, found: "Roughness | Repeats", unit: str) -> None:
    """Print what was compared, the errors, remarks, and the key for study.yaml."""
    errors = found.errors
    alone = " (independent points: half their distance)" if errors.length < 0.501 * found.spacing else ""
    click.echo(compared)
    click.echo(f"  sd of a point along the normal: {_length(errors.sd, unit)}")
    click.echo(f"  correlation length: {_length(errors.length, unit)}{alone}")
    common, units = _common(errors, unit), {"rotation": " degrees", "scale": ""}
    if common:
        shown = ", ".join(f"{name} {_digits(value)}{units.get(name, f' {unit}')}" for name, value in common.items())
        click.echo(f"  common to all points of a contour, sd over the contours: {shown}")
    for note in found.notes:
        click.echo(f"  note: {note}")
    click.echo(f"for study.yaml:\n{_key(errors, unit)}")


def _common(errors: "PointErrors", unit: str) -> dict[str, float]:
    """Return the errors that all points of a contour share, as the key `noise` has them."""
    units = {"shift": _in_mm(unit), "rotation": 1.0, "scale": 1.0, "offset": _in_mm(unit)}
    found = {name: float(getattr(errors, name)) / size for name, size in units.items()}
    return {name: value for name, value in found.items() if value > 0}


def _key(errors: "PointErrors", unit: str) -> str:
    """Return the key `noise` with these errors."""
    unknown = ", ".join(f"{name}: {_digits(value)}" for name, value in _common(errors, unit).items())
    common, mm = f", unknown: {{{unknown}}}" if unknown else "", _in_mm(unit)
    return f"noise: {{sd: {_digits(errors.sd / mm)}, length: {_digits(errors.length / mm)}, unit: {unit}{common}}}"


def _length(mm: float, unit: str) -> str:
    return f"{_digits(mm / _in_mm(unit))} {unit}"


def _in_mm(unit: str) -> float:
    from strandline.readers.options import TO_MM

    return TO_MM[unit]


def _digits(value: float) -> str:
    """Return a number with three digits, without an exponent where that is short."""
    return f"{float(f'{value:.3g}'):g}"


def _contour(path: Path, unit: str, options: Mapping[str, Any]) -> "Interface":
    from strandline.studies.observed import read_points

    return read_points(path, unit, what="contour", options=options)


def _files(given: Sequence[Path]) -> list[Path]:
    """Return the files, those of a folder by name."""
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(one for one in path.iterdir() if one.is_file() and not one.name.startswith("."))
            if not inside:
                raise _refused("folder of contours", f"{path}, without files", "a file for each contour", "Correct it.")
            found += inside
        else:
            found.append(path)
    return found


def _options(reading: Sequence[str]) -> dict[str, Any]:
    """Return how to read the files, with values as in study.yaml; what is no YAML, like a comma, is a text."""
    from strandline.studies.text import load_yaml

    found: dict[str, Any] = {}
    for text in reading:
        name, equals, value = text.partition("=")
        if not (equals and name.strip() and value.strip()):
            raise _refused("--read", text, "NAME=VALUE, e.g. columns=[x,y]", "Correct the option.")
        try:
            found[name.strip()] = load_yaml(value)
        except InvalidInput:
            found[name.strip()] = value.strip()
    return found


def _refused(what: str, value: str, expected: str, remedy: str) -> InvalidInput:
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
