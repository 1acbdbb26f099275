"""The page on which a person marks a picture: one HTML file that needs no server and loads nothing."""

import base64
import io
import math
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from strandline.foundations import InvalidInput
from strandline.imaging import Clicks, as_json
from strandline.report.html import embedded, script_hash, template

SCRIPTS = ("marks.js", "editing.js")
MOST_PIXELS, LONGEST_SIDE = 6_000_000, 8192
"""Largest picture that is shown as it is, in pixels."""
ENDS = (0.2, 99.8)
"""Percentiles of the values that become black and white."""
SAMPLED = 1_000_000
"""Number of values from which percentiles are taken."""
DARK = 0.1
"""Median below which a picture is brightened, as intensities of coherent light need it."""
BRIGHTEST_POWER = 0.25


class ScreenPicture(NamedTuple):
    """A picture for the screen as a PNG file; each pixel stands for `factor` of the original in each direction."""

    png: bytes
    factor: int


def click_page(
    values: Float[np.ndarray, "row column"],
    *,
    name: str,
    sha256: str,
    clicks: Clicks | None = None,
    pixel_mm: tuple[float, float] | None = None,
    most_pixels: int = MOST_PIXELS,
) -> str:
    """Return the page for one picture of grey values, with a checksum of its file in hexadecimal, as HTML.

    The page saves a file that `strandline.imaging.clicks.read_clicks` reads, and nothing that it would refuse. `clicks`
    are what was marked before in the same picture. With width and height of a pixel, mm, the page shows the picture in
    its true shape; one of more than `most_pixels` is reduced.
    """
    height, width = values.shape
    if clicks is not None:
        clicks.require_picture(sha256, (width, height))
    png, factor = for_screen(values, most_pixels=most_pixels)
    given = {
        "name": name,
        "sha256": sha256.lower(),
        "size": [width, height],
        "factor": factor,
        "pixel_mm": pixel_mm,
        "file": f"{PurePath(name).stem}.path.json",
        "clicks": None if clicks is None else as_json(clicks),
        "picture": f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}",
    }
    folder = Path(__file__).parent / "templates" / "clicks"
    script = '\n"use strict";\n' + "\n".join((folder / part).read_text(encoding="utf-8") for part in SCRIPTS)
    return str(
        template("clicks.html.j2").render(
            name=name,
            file=given["file"],
            width=width,
            height=height,
            factor=factor,
            given=embedded(given),
            script=Markup(script),
            script_hash=Markup(script_hash(script)),
        )
    )


def for_screen(values: Float[np.ndarray, "row column"], *, most_pixels: int = MOST_PIXELS) -> ScreenPicture:
    """Return a picture for the screen, reduced if it has more pixels; values that are not finite are black."""
    from PIL import Image

    height, width = values.shape
    factor = _factor(height, width, most_pixels)
    means = np.asarray(Image.fromarray(255 * _shaded(values)).reduce(factor))
    buffer = io.BytesIO()
    Image.fromarray(np.round(means).astype(np.uint8)).save(buffer, format="png")
    return ScreenPicture(buffer.getvalue(), factor)


def _factor(height: int, width: int, most_pixels: int) -> int:
    factor = max(1, math.ceil(max(height, width) / LONGEST_SIDE))
    while math.ceil(height / factor) * math.ceil(width / factor) > most_pixels:
        factor += 1
    return factor


def _shaded(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Return brightness from 0 to 1, single precision."""
    sample = values[:: max(1, math.isqrt(values.size // SAMPLED)), :: max(1, math.isqrt(values.size // SAMPLED))]
    finite = sample[np.isfinite(sample)]
    if finite.size == 0:
        raise InvalidInput(
            "values of the picture",
            value=f"{values.shape[1]} × {values.shape[0]} px without a finite value",
            expected="numbers",
            remedy="Look at the picture, its page and its scale.",
        )
    low, middle, high = np.percentile(finite, [ENDS[0], 50, ENDS[1]])
    if not high > low:
        low, high = float(finite.min()), float(finite.max())
    range_ = (high - low) or 1.0
    brightness = np.clip((values - low) / range_, 0.0, 1.0).astype(np.float32)
    median = (middle - low) / range_
    if 0 < median < DARK:
        brightness **= max(BRIGHTEST_POWER, math.log(3 * DARK) / math.log(median))
    return np.asarray(np.nan_to_num(brightness, copy=False))
