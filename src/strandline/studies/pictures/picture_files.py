"""What `strandline image` writes: the edge as a table, a picture of it, and its errors in numbers."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from strandline.discrepancy import Discrepancy, KnowsPointErrors, NormalOffset, Whitens, unit_of
from strandline.imaging import FrameErrors
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.compared import adapted
from strandline.report.click_page import write_click_page
from strandline.report.plots.picture import plot_picture
from strandline.report.plots.style import DOTS_PER_INCH
from strandline.studies.chosen import in_words, refused_at
from strandline.studies.folder import require_writable, told_if_unwritable, whole_file, write_json
from strandline.studies.keys.image import ImageFile
from strandline.studies.pictures.frame_note import UNDEFORMED
from strandline.studies.pictures.photographed import Photographed, clicked, read_only_picture
from strandline.studies.pictures.undeformed import Undeformed

__all__ = ["IMAGE", "UNDEFORMED", "PictureFiles", "described", "variances", "write_page", "write_pictures"]

IMAGE = "image"
"""Folder, in the study's, of what is written."""


@dataclass(frozen=True)
class PictureFiles:
    """What was written on one picture.

    Args:
        condition: The observed condition.
        content: Errors of the edge and where they come from, as in ``image.json``.
        files: Names of the files, relative to the study's folder.
    """

    condition: str
    content: Mapping[str, Any]
    files: tuple[str, ...]


def write_pictures(
    folder: Path,
    pictures: Mapping[str, Photographed],
    undeformed: Undeformed | None = None,
    *,
    measures: Mapping[str, Discrepancy] = MappingProxyType({}),
) -> list[PictureFiles]:
    """Write table, picture and numbers of the edge of each condition into ``image/`` of the study's folder.

    Args:
        folder: Folder of the study.
        pictures: The pictures with the observed interfaces, by condition.
        undeformed: The undeformed outline from a picture, whose files begin with ``undeformed-``.
        measures: The measures of the study, by name, whose noise variances are given.

    Raises:
        InvalidStudy: The folder cannot be written to.
    """
    require_writable(folder)
    target, out = folder / IMAGE, []
    with told_if_unwritable(target):
        target.mkdir(exist_ok=True)
        first = {} if undeformed is None else {UNDEFORMED: undeformed.picture}
        for condition, one in {**first, **pictures}.items():
            stem = f"{condition}-edge" if condition else "edge"
            content = described(one, {} if condition == UNDEFORMED else measures)
            rows = np.column_stack([one.interface.points, *_along(one)])
            with whole_file(target / f"{stem}.csv") as path:
                np.savetxt(path, rows, delimiter=",", header="x,y,sd,arc", comments="", fmt="%.7g")
            figure: Any = plot_picture(one.picture, one.path, one.edge)
            with whole_file(target / f"{stem}.png") as path:
                figure.savefig(path, dpi=DOTS_PER_INCH, format="png", metadata={"Software": None})
            write_json(target / f"{stem}.json", content)
            names = tuple(f"{IMAGE}/{stem}.{suffix}" for suffix in ("csv", "png", "json"))
            out.append(PictureFiles(condition, content, names))
        if undeformed is not None:
            out[0] = _with_outline(target, out[0], undeformed)
    return out


def _with_outline(target: Path, written: PictureFiles, undeformed: Undeformed) -> PictureFiles:
    """Write the smooth outline too."""
    name = f"{UNDEFORMED}-outline.csv"
    with whole_file(target / name) as path:
        np.savetxt(path, undeformed.outline.points, delimiter=",", header="x,y", comments="", fmt="%.7g")
    smooth = {"sd": undeformed.outline.sd, "length": undeformed.outline.length}
    return replace(written, content={**written.content, "outline": smooth}, files=(*written.files, f"{IMAGE}/{name}"))


def write_page(folder: Path, given: ImageFile) -> Path:
    """Write the page on which a person marks a picture, with the marks of the file that `path` names if it exists.

    Raises:
        InvalidStudy: The picture or that file cannot be read, or the folder cannot be written to.
    """
    require_writable(folder)
    picture, known = read_only_picture(folder, given)
    with refused_at():
        named = isinstance(given.path, str) and (folder / given.path).is_file()
        clicks = clicked(folder, given) if named else None
        target = folder / f"{Path(picture.name).stem}.mark.html"
        with told_if_unwritable(target):
            return write_click_page(
                picture.values,
                target,
                name=picture.name,
                sha256=picture.sha256,
                clicks=clicks,
                pixel_mm=picture.pixel if known else None,
            )


def described(one: Photographed, measures: Mapping[str, Discrepancy]) -> dict[str, Any]:
    """Return the errors of an edge, lengths in mm, what `check` thinks of it, and σ_N² of measures that fits it."""
    e = one.edge.errors
    return {
        "picture": one.picture.name,
        "sha256": one.picture.sha256,
        "pixel_mm": list(one.picture.pixel),
        "notes": list(one.notes),
        "points": len(one.edge.points),
        "edge_length": float(one.interface.lengths.sum()),
        "sd": e.sd,
        "length": e.length,
        "offset": e.offset,
        "spacing": e.spacing,
        "blur": e.blur,
        "smallest_radius": e.radius,
        "contrast_to_noise": e.contrast_to_noise,
        "limit_share": e.limit_share,
        "facts": e.facts,
        "frames": None if one.repeated is None else _of_frames(one.repeated),
        "registration": None if one.registration is None else asdict(one.registration),
        "checks": [
            {key: getattr(check, key) for key in ("name", "value", "limit", "verdict", "shown", "expected")}
            for check in one.edge.checks
        ],
        "noise_variance": variances(one.interface, one.errors, measures),
    }


def _of_frames(found: FrameErrors) -> dict[str, Any]:
    """Return the errors that frames of one state show, lengths in mm, and those of their mean picture alone."""
    return {
        "frames": found.frames,
        "compared": found.compared,
        "one_frame": _stated(found.one),
        "mean": _stated(found.mean),
        "picture_alone": {"sd": found.picture_sd, "length": found.picture_length},
        "used": "frames" if found.larger else "picture",
    }


def _stated(errors: PointErrors) -> dict[str, float]:
    return {name: getattr(errors, name) for name in ("sd", "length", "shift", "rotation", "scale", "offset")}


def _along(one: Photographed) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviations and arc lengths in the order of the interface."""
    turned = not one.frame.mirrors
    sds, arc = one.edge.sds, one.edge.arc
    return (sds[::-1], arc[-1] - arc[::-1]) if turned else (sds, arc - arc[0])


def variances(seen: Interface, errors: PointErrors, measures: Mapping[str, Discrepancy]) -> dict[str, dict[str, Any]]:
    """Return σ_N² that fits the errors of observed points by its closed form, by measure with its options.

    Each entry holds the `value`, None without one, its `unit`, and a `note` that says why there is none. The measure
    `normal_offset` is always among them: it needs none.

    Args:
        seen: The observed interface.
        errors: The errors of its points.
        measures: The measures of a study, by name.
    """
    found = {}
    for name, measure in {**measures, "normal_offset": measures.get("normal_offset", NormalOffset())}.items():
        fitted = adapted(measure, Observation(seen, errors))
        options = in_words(fitted).partition(": ")[2]
        shown = f"{name}, {options}" if options and not isinstance(fitted, Whitens) else name
        value, note = _variance(fitted, seen, errors)
        found[shown] = {"value": value, "unit": unit_of(fitted, seen) if value is not None else None, "note": note}
    return found


def _variance(measure: Discrepancy, seen: Interface, errors: PointErrors) -> tuple[float | None, str | None]:
    """Return σ_N² of a measure, or why there is none."""
    if isinstance(measure, Whitens):
        return None, "none needed, it weighs the points by their errors"
    closed = measure.noise_variance(errors, seen) if isinstance(measure, KnowsPointErrors) else None
    return closed, None if closed is not None else "no closed form holds, a run of the study computes it"
