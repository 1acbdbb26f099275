"""`strandline noise`, `image`: errors of measured contours; edge or surface in pictures, or a page to mark them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.cli import options
from strandline.foundations import InvalidInput, InvalidStudy, require

if TYPE_CHECKING:
    from strandline.discrepancy import Repeats, Roughness
    from strandline.studies import PictureFiles


@click.command("noise")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(exists=True, path_type=Path))
@click.option("--unit", required=True, type=options.UNIT, help="Unit of the coordinates.")
@click.option("--window", type=float, metavar="LENGTH", help="One contour only: smooth it over this length, in UNIT.")
@options.repeatable("--read", "reading", "NAME=VALUE", "How to read the files, e.g. columns=[x,y]; repeatable.")
def noise(files: tuple[Path, ...], unit: str, window: float | None, reading: tuple[str, ...]) -> None:
    """Estimate the errors of the points in FILEs, and print the key `noise` for study.yaml.

    Several files, or a folder of them, are contours of one state from repeated pictures. A single file is compared with
    itself smoothed, which shows less.
    """
    from strandline.discrepancy import errors_from_repeats, errors_from_roughness
    from strandline.readers import TO_MM
    from strandline.studies import read_points

    how = _options(reading)
    contours = [read_points(path, unit, what="contour", options=how) for path in _files(files)]
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
    from strandline.readers import TO_MM

    errors, mm = found.errors, TO_MM[unit]
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
    from strandline.readers import TO_MM

    return f"{_digits(mm / TO_MM[unit])} {unit}"


def _digits(value: float) -> str:
    """Return a number with three digits, without an exponent where that is short."""
    return f"{float(f'{value:.3g}'):g}"


def _files(given: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in given:
        inside = path.iterdir() if path.is_dir() else ()
        files = sorted(one for one in inside if one.is_file() and not one.name.startswith("."))
        if path.is_dir() and not files:
            raise click.UsageError(f"{path} has no files: give a folder with a file for each contour.")
        found += files or [path]
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


@click.command("image")
@options.study
@click.option("--edit", is_flag=True, help="Write a page on which to mark path, scale, origin and regions instead.")
@click.option(
    "--condition",
    metavar="NAME",
    help="With --edit and several pictures: which one; `undeformed` is that of the model's outline.",
)
@click.option("--reference", is_flag=True, help="With --edit: the picture to which that one is registered.")
def image(study: Path, edit: bool, condition: str | None, reference: bool) -> None:
    """Find the edge in the picture of STUDY and write it into STUDY/image: a table, a picture, its errors.

    In a stack of pictures find the surface, and write a file for VTK instead of the table.

    With --edit, write a page instead. Open it in a browser, mark the picture, and save the file that `path` names.
    """
    if edit:
        page = _page(study, condition, reference=reference)
        click.echo(f"wrote {page}: open it in a browser, mark the picture, and save the marks next to study.yaml")
        return
    from strandline.studies import IMAGE, load_study, write_pictures

    try:
        loaded = load_study(study)
    except InvalidInput as error:
        earlier = sorted(one.name for one in (study / IMAGE).glob("*.png"))
        if not earlier:
            raise
        remedy = f"{error.remedy} ({study / IMAGE / earlier[0]} still shows an earlier edge.)"
        raise InvalidStudy(error.what, value=error.value, expected=error.expected, remedy=remedy) from None
    pictured = loaded.pictures or loaded.stacks or loaded.undeformed is not None
    expected = "`image: {file: …, path: …, solid: …}`, or `stack: {file: …, solid: …}`"
    remedy = 'See the guide "Your observation", docs/how-to/picture.md.'
    require(pictured, "observation", "no picture", expected, remedy, InvalidStudy)
    for one in write_pictures(loaded):
        click.echo("\n".join([*_lines(one), *(f"  wrote {study / file}" for file in one.files)]))
    click.echo(f"next: strandline check {study}")


def _lines(one: "PictureFiles") -> Iterator[str]:
    found, of = one.content, f"{one.condition}: " if one.condition else ""
    if "stack" in found:
        extent = f"{found['triangles']} triangles, {'closed' if found['closed'] else 'open'}"
        yield f"{of}{found['stack']}: surface of {extent}"
    else:
        yield f"{of}{found['picture']}: edge of {found['points']} points, {found['edge_length']:.4g} mm long"
    yield from (f"  {note}" for note in found["notes"])
    yield f"  sha256 {found['sha256']}"
    micrometres = {name: f"{1e3 * found[name]:.3g} µm" for name in ("sd", "length", "offset", "blur")}
    yield f"  sd of a point along the normal: {micrometres['sd']}; correlation length: {micrometres['length']}"
    yield f"  sd of a common offset: {micrometres['offset']}; blur: {micrometres['blur']}"
    if "stack" in found:
        yield f"  contrast over noise: {found['contrast_to_noise']:.3g}"
    else:
        yield from _of_frames(found["frames"])
        for check in found["checks"]:
            yield f"  {check['verdict']}: {check['name']} {check['shown']} ({check['expected']})"
        if found["registration"] is not None:
            yield _moved(found["registration"], 1e3 * min(found["pixel_mm"]))
    if "outline" in found:
        smooth = {name: f"{1e3 * found['outline'][name]:.3g} µm" for name in ("sd", "length")}
        yield f"  smooth outline: sd of a point {smooth['sd']}, correlation length {smooth['length']};"
        yield "  these errors are added to the noise of the observation"
        return
    yield "  as `noise: {sd: image, unit: um, unknown: {shift: …, rotation: …, scale: …}}` states it"
    for name, one_of in found["noise_variance"].items():
        said = one_of["note"] if one_of["value"] is None else f"{one_of['value']:.3g} {one_of['unit']}".strip()
        yield f"  σ_N² for {name}: {said}"


def _of_frames(found: Mapping[str, Any] | None) -> Iterator[str]:
    """Yield what several frames of one state show, beside what their mean picture alone shows."""
    if found is None:
        return
    one, mean, alone = found["one_frame"], found["mean"], found["picture_alone"]
    compared = "" if found["compared"] == found["frames"] else f", {found['compared']} of them compared"
    yield f"  from {found['frames']} frames{compared}: {_pair(mean)}; in one frame {1e3 * one['sd']:.3g} µm"
    yield f"  from their mean alone: {_pair(alone)}"
    yield f"  the {'frames' if found['used'] == 'frames' else 'mean alone'} set sd and length: s²ℓ is larger"
    if one["shift"] or one["rotation"]:
        moved = f"{1e3 * one['shift']:.3g} µm and {one['rotation']:.2g}°"
        left = f"{1e3 * mean['shift']:.3g} µm and {mean['rotation']:.2g}°"
        yield f"  frames differ in place by {moved} (sd), their mean by {left}: take these up in `unknown`"


def _pair(errors: Mapping[str, float]) -> str:
    return f"sd {1e3 * errors['sd']:.3g} µm, correlation length {1e3 * errors['length']:.3g} µm"


def _moved(found: Mapping[str, Any], unit: float) -> str:
    """Return where the set-up is in the picture; `unit` is the smaller side of a pixel in µm."""
    right, down = (f"{unit * value:.3g}" for value in found["shift"])
    shift = f"{right} µm to the right and {down} µm down, sd {unit * found['shift_sd']:.2g} µm"
    return f"  set-up moved by {shift}; turned by {found['rotation']:.3g}°, sd {found['rotation_sd']:.2g}°"


def _page(study: Path, condition: str | None, *, reference: bool) -> Path:
    from strandline.studies import UNDEFORMED, parse_study, picture_of, reference_of, undeformed_picture, write_page

    content, _ = parse_study(study)
    undeformed = undeformed_picture(content.model)
    given = undeformed if condition == UNDEFORMED else None
    given = given or picture_of(content.observation, condition)
    return write_page(study, reference_of(given) if reference else given)
