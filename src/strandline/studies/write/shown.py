"""What is shown of pictures and stacks: behind the interfaces, in summary.json, and what `strandline image` writes."""

import base64
import io
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from strandline.discrepancy import Discrepancy, KnowsPointErrors, NormalOffset, unit_of
from strandline.foundations import whole_file, write_json
from strandline.imaging import FrameErrors
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood import adapted
from strandline.report import DOTS_PER_INCH, click_page, plot_picture, plot_stack, save_page
from strandline.studies.keys.folder import require_writable, told_if_unwritable
from strandline.studies.keys.observation import ImageFile
from strandline.studies.keys.parse import in_words, refused_at
from strandline.studies.load.observed import Scanned
from strandline.studies.load.photographed import UNDEFORMED, Photographed, Undeformed, clicked, read_only_picture
from strandline.studies.load.provenance import named
from strandline.studies.load.study import Study


def read_how(study: Study) -> list[dict[str, Any]]:
    """Return condition, file, checksum and notes of each picture and stack, the one of the outline first."""
    first = {} if study.undeformed is None else {UNDEFORMED: study.undeformed.picture}
    found = [(name, one.name, one.picture.sha256, one.notes) for name, one in {**first, **study.pictures}.items()]
    found += [(name, one.name, one.stack.sha256, one.notes) for name, one in study.stacks.items()]
    keys = ("condition", "file", "sha256", "notes")
    return [{**dict(zip(keys, one, strict=True)), "notes": list(one[3])} for one in found]


def read_lines(study: Study) -> Iterator[str]:
    """Yield a line on each picture and stack."""
    for one in read_how(study):
        of = f"{one['condition']}: " if one["condition"] else ""
        yield f"{of}{one['file']}: {'; '.join(one['notes'])}; sha256 {one['sha256'][:12]}…"


DARKEST = 0.5, 99.5  # percentiles of the grey values that are shown black and white
MOST_PIXELS, MOST_IN_PAGE = 1600, 1000  # longest side of a picture on the live page and in a report, pixels
QUALITY = 80  # quality of the JPEG in a report


def picture_behind(study: Study, condition: str, source: str) -> dict[str, Any] | None:
    """Return size, place and address of a condition's picture, or None; m, mm, is at pixel `matrix` m + `origin`."""
    found = study.pictures.get(condition)
    if found is None:
        return None
    rows, columns = found.picture.values.shape
    frame = found.frame
    return {
        "width": columns,
        "height": rows,
        "matrix": np.linalg.inv(frame.matrix).tolist(),
        "origin": list(frame.origin),
        "pixel": list(frame.pixel),
        "name": found.name,
        "source": source,
    }


def picture_png(study: Study, condition: str) -> bytes | None:
    """Return a condition's picture in grey, made smaller if it is large; None if it has none."""
    found = study.pictures.get(condition)
    return None if found is None else _saved(_small(found.picture.values, MOST_PIXELS), "PNG")


def pictures_in_page(study: Study) -> dict[str, dict[str, Any]]:
    """Return the pictures by condition as `picture_behind` does, each with a small JPEG as its address."""
    out = {}
    for condition, found in study.pictures.items():
        jpeg = _saved(_small(found.picture.values, MOST_IN_PAGE), "JPEG", quality=QUALITY)
        source = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode('ascii')}"
        behind = picture_behind(study, condition, source)
        if behind is not None:
            out[condition] = behind
    return out


def _small(values: Float[np.ndarray, "row column"], most: int) -> Image.Image:
    """Return the picture in grey; of a large one, each pixel is the mean of those that it stands for."""
    some = values[:: -(-values.shape[0] // most), :: -(-values.shape[1] // most)]
    black, white = np.nanpercentile(some, DARKEST)
    share = np.nan_to_num((values - black) / max(white - black, 1e-12))
    image = Image.fromarray(np.round(255 * np.clip(share, 0.0, 1.0)).astype(np.uint8))
    image.thumbnail((most, most), Image.Resampling.BOX)
    return image


def _saved(image: Image.Image, kind: str, **options: Any) -> bytes:
    out = io.BytesIO()
    image.save(out, kind, **options)
    return out.getvalue()


ERRORS = ("sd", "length", "shift", "rotation", "scale", "offset")
IMAGE = "image"  # folder, in the study's, of what is written


@dataclass(frozen=True)
class PictureFiles:
    """The condition of a picture, its errors as in ``image.json``, and the names of the files in the study."""

    condition: str
    content: Mapping[str, Any]
    files: tuple[str, ...]


def write_pictures(study: Study) -> list[PictureFiles]:
    """Write each edge and surface into ``image/`` of the study's folder: a table or a mesh, a picture, its errors."""
    require_writable(study.folder)
    target, measures, out = study.folder / IMAGE, study.discrepancies, []
    with told_if_unwritable(target):
        target.mkdir(exist_ok=True)
        if study.undeformed is not None:
            out.append(_write_outline(target, study.undeformed))
        out += [_write_edge(target, condition, one, measures) for condition, one in study.pictures.items()]
        out += [_write_surface(target, condition, one, measures) for condition, one in study.stacks.items()]
    return out


def _write_edge(target: Path, condition: str, one: Photographed, measures: Mapping[str, Discrepancy]) -> PictureFiles:
    stem, content = f"{condition}-edge" if condition else "edge", described(one, measures)
    rows = np.column_stack([one.interface.points, *_along(one)])
    with whole_file(target / f"{stem}.csv") as path:
        np.savetxt(path, rows, delimiter=",", header="x,y,sd,arc", comments="", fmt="%.7g")
    names = _write_shown(target, stem, plot_picture(one.picture, one.path, one.edge), content)
    return PictureFiles(condition, content, (f"{IMAGE}/{stem}.csv", *names))


def _write_surface(target: Path, condition: str, one: Scanned, measures: Mapping[str, Discrepancy]) -> PictureFiles:
    stem, content = f"{condition}-surface" if condition else "surface", described_stack(one, measures)
    with whole_file(target / f"{stem}.vtu") as path:
        path.write_text(vtu(one.interface), encoding="utf-8")
    names = _write_shown(target, stem, plot_stack(one.stack, one.surface.mesh), content)
    return PictureFiles(condition, content, (f"{IMAGE}/{stem}.vtu", *names))


def _write_shown(target: Path, stem: str, figure: Any, content: Mapping[str, Any]) -> tuple[str, str]:
    with whole_file(target / f"{stem}.png") as path:
        figure.savefig(path, dpi=DOTS_PER_INCH, format="png", metadata={"Software": None})
    write_json(target / f"{stem}.json", content)
    return f"{IMAGE}/{stem}.png", f"{IMAGE}/{stem}.json"


def _write_outline(target: Path, undeformed: Undeformed) -> PictureFiles:
    written, outline = _write_edge(target, UNDEFORMED, undeformed.picture, {}), undeformed.outline
    name = f"{UNDEFORMED}-outline.csv"
    with whole_file(target / name) as path:
        np.savetxt(path, outline.points, delimiter=",", header="x,y", comments="", fmt="%.7g")
    content = {**written.content, "outline": {"sd": outline.sd, "length": outline.length}}
    return PictureFiles(UNDEFORMED, content, (*written.files, f"{IMAGE}/{name}"))


def write_page(folder: Path, given: ImageFile) -> Path:
    """Write the page on which a person marks a picture, with the marks of the file that `path` names if it exists."""
    require_writable(folder)
    picture, known = read_only_picture(folder, given)
    with refused_at():
        named = isinstance(given.path, str) and (folder / given.path).is_file()
        clicks = clicked(folder, given) if named else None
        target = folder / f"{Path(picture.name).stem}.mark.html"
        with told_if_unwritable(target):
            pixel = picture.pixel if known else None
            page = click_page(picture.values, name=picture.name, sha256=picture.sha256, clicks=clicks, pixel_mm=pixel)
            return save_page(target, page)


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
        **named(e, "sd", "length", "offset", "spacing", "blur"),
        "smallest_radius": e.radius,
        **named(e, "contrast_to_noise", "limit_share", "facts"),
        "frames": None if one.repeated is None else _of_frames(one.repeated),
        "registration": None if one.registration is None else asdict(one.registration),
        "checks": [named(check, "name", "value", "limit", "verdict", "shown", "expected") for check in one.edge.checks],
        "noise_variance": variances(one.interface, one.errors, measures),
    }


def _of_frames(found: FrameErrors) -> dict[str, Any]:
    """Return the errors that frames of one state show, lengths in mm, and those of their mean picture alone."""
    return {
        "frames": found.frames,
        "compared": found.compared,
        "one_frame": named(found.one, *ERRORS),
        "mean": named(found.mean, *ERRORS),
        "picture_alone": {"sd": found.picture_sd, "length": found.picture_length},
        "used": "frames" if found.larger else "picture",
    }


def _along(one: Photographed) -> tuple[np.ndarray, np.ndarray]:
    turned = not one.frame.mirrors
    sds, arc = one.edge.sds, one.edge.arc
    return (sds[::-1], arc[-1] - arc[::-1]) if turned else (sds, arc - arc[0])


def variances(seen: Interface, errors: PointErrors, measures: Mapping[str, Discrepancy]) -> dict[str, dict[str, Any]]:
    """Return σ_N² that fits the errors of observed points by its closed form, by measure with its options.

    Each entry holds the `value`, None without one, its `unit`, and a `note` that says why there is none. The measure
    `normal_offset` is always among them: it needs none.
    """
    found = {}
    for name, measure in {**measures, "normal_offset": measures.get("normal_offset", NormalOffset())}.items():
        fitted = adapted(measure, Observation(seen, errors))
        options = in_words(fitted).partition(": ")[2]
        shown = f"{name}, {options}" if options and not isinstance(fitted, NormalOffset) else name
        value, note = _variance(fitted, seen, errors)
        found[shown] = {"value": value, "unit": unit_of(fitted, seen) if value is not None else None, "note": note}
    return found


def _variance(measure: Discrepancy, seen: Interface, errors: PointErrors) -> tuple[float | None, str | None]:
    if isinstance(measure, NormalOffset):
        return None, "none needed, it weighs the points by their errors"
    closed = measure.noise_variance(errors, seen) if isinstance(measure, KnowsPointErrors) else None
    return closed, None if closed is not None else "no closed form holds, a run of the study computes it"


TRIANGLE = 5  # VTK's number of the kind of a cell


def described_stack(one: Scanned, measures: Mapping[str, Discrepancy]) -> dict[str, Any]:
    """Return the errors of a surface, lengths in mm, and σ_N² of measures that fit them."""
    e = one.surface.errors
    return {
        "stack": one.name,
        "sha256": one.stack.sha256,
        "voxel_mm": list(one.stack.voxel),
        "notes": list(one.notes),
        "triangles": len(one.interface.cells),
        "points": len(one.interface.points),
        "closed": one.interface.closed,
        **named(e, "sd", "length", "offset", "blur", "contrast_to_noise", "open_share", "facts"),
        "noise_variance": variances(one.interface, one.errors, measures),
    }


def vtu(surface: Interface) -> str:
    """Return a surface as the text of a file .vtu, in mm."""
    number = len(surface.cells)
    arrays = {
        "Points": _array("Points", "Float64", (" ".join(f"{x:.9g}" for x in row) for row in surface.points), 3),
        "Cells": _array("connectivity", "Int64", (" ".join(map(str, row)) for row in surface.cells.tolist()))
        + _array("offsets", "Int64", map(str, range(3, 3 * number + 1, 3)))
        + _array("types", "UInt8", [str(TRIANGLE)] * number),
    }
    inner = "".join(f"<{name}>\n{text}</{name}>\n" for name, text in arrays.items())
    return (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">\n'
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(surface.points)}" NumberOfCells="{number}">\n{inner}'
        "</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
    )


def _array(name: str, kind: str, rows: Any, components: int = 1) -> str:
    several = f' NumberOfComponents="{components}"' if components > 1 else ""
    body = "\n".join(rows)
    return f'<DataArray type="{kind}" Name="{name}"{several} format="ascii">\n{body}\n</DataArray>\n'
