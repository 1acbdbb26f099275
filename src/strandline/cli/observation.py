"""`strandline init`, `noise`, `image`: a study that runs; errors of measured contours; edge or surface in pictures."""

import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.cli import options
from strandline.foundations import InvalidInput, InvalidStudy, require, suggestion
from strandline.studies import EXAMPLES, OWN, Observed, write_example

if TYPE_CHECKING:
    from strandline.discrepancy import Repeats, Roughness
    from strandline.studies import PictureFiles


class _Size(click.FloatRange):
    """A number in a range, or `unknown`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number or the word."""
        return value if value == "unknown" else super().convert(value, param, ctx)


NOT_NEGATIVE, SD, LENGTH = click.FloatRange(min=0), _Size(min=0, min_open=True), _Size(min=0)
UNIT = click.Choice(["mm", "um", "m"])
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
@click.option("--unit", type=UNIT, help="Unit of its coordinates.")
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
        found["unit"] = click.prompt(f"Unit of the coordinates in {observed.name}", type=UNIT)
    if found["sd"] is None:
        text = "How far may one point be off, as a standard deviation in µm? (`unknown`: estimate it)"
        found["sd"] = click.prompt(text, type=SD)
    for name, (text, kind) in QUESTIONS.items():
        if found[name] is None:
            found[name] = click.prompt(text, "0", type=kind) if ask else 0.0
    known: dict[str, Any] = {name: None if value == "unknown" else value for name, value in found.items()}
    return Observed(observed, **known)


@click.command("noise")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(exists=True, path_type=Path))
@click.option("--unit", required=True, type=click.Choice(["mm", "um", "µm", "m"]), help="Unit of the coordinates.")
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
