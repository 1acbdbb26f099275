"""`strandline image`: the edge in the picture of a study, the surface in its stack, or the page to mark a picture."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.foundations import InvalidInput, InvalidStudy

if TYPE_CHECKING:
    from strandline.studies import PictureFiles

from strandline.cli import options


@click.command("image")
@options.study
@click.option("--edit", is_flag=True, help="Write a page on which to mark path, scale, origin and regions instead.")
@click.option(
    "--condition",
    default=None,
    metavar="NAME",
    help="With --edit and several pictures: which one; `undeformed` is that of the model's outline.",
)
@click.option("--reference", is_flag=True, help="With --edit: the picture to which that one is registered.")
def command(study: Path, edit: bool, condition: str | None, reference: bool) -> None:
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
    if not loaded.pictures and not loaded.stacks and loaded.undeformed is None:
        raise InvalidStudy(
            "observation",
            value="no picture",
            expected="`image: {file: …, path: …, solid: …}`, or `stack: {file: …, solid: …}`",
            remedy='See the guide "Your observation", docs/how-to/picture.md.',
        )
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
        yield from _of_picture(found)
    if "outline" in found:
        smooth = {name: f"{1e3 * found['outline'][name]:.3g} µm" for name in ("sd", "length")}
        yield f"  smooth outline: sd of a point {smooth['sd']}, correlation length {smooth['length']};"
        yield "  these errors are added to the noise of the observation"
        return
    yield "  as `noise: {sd: image, unit: um, unknown: {shift: …, rotation: …, scale: …}}` states it"
    for name, one_of in found["noise_variance"].items():
        said = one_of["note"] if one_of["value"] is None else f"{one_of['value']:.3g} {one_of['unit']}".strip()
        yield f"  σ_N² for {name}: {said}"


def _of_picture(found: Mapping[str, Any]) -> Iterator[str]:
    yield from _of_frames(found["frames"])
    yield from (
        f"  {check['verdict']}: {check['name']} {check['shown']} ({check['expected']})" for check in found["checks"]
    )
    if found["registration"] is not None:
        yield _moved(found["registration"], 1e3 * min(found["pixel_mm"]))


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
