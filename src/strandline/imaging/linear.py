"""Numbers of a file → intensity: colours become grey, and the scale is undone."""

import numpy as np
from jaxtyping import Float, Shaped

from strandline.imaging.reading import PictureReading
from strandline.readers.contents import refused

LUMA = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in grey, Rec. 709."""
COLOURS = ("red", "green", "blue")
MOST_DECIBELS = 200.0
"""Largest range of a picture in decibels; a screen's 8 bits taken for decibels span 255."""
Values = Float[np.ndarray, "row column"]


def intensity(
    raw: Shaped[np.ndarray, "row column *channel"], how: PictureReading, name: str
) -> tuple[Values, tuple[str, ...]]:
    """Return the intensity of each pixel, and sentences that say what was done.

    Args:
        raw: Numbers of the file, shape (row, column) or (row, column, channel).
        how: How to read the picture; its channel and its scale count.
        name: Name of the file in messages.
    """
    if raw.dtype.kind not in "fiub":
        raise refused(f"{name} holds no picture", f"numbers of the type {raw.dtype}", "real numbers")
    channels = raw.shape[2] if raw.ndim == 3 else 1
    if raw.ndim not in (2, 3) or channels > 4 or channels < 1:
        raise refused(f"{name} holds no picture", f"the shape {raw.shape}", "grey, or red, green and blue")
    colours = raw[..., None] if raw.ndim == 2 else raw[..., : 1 if channels < 3 else 3]
    notes = ["the alpha channel is left out"] if channels in (2, 4) else []
    values, of_colours = _chosen(colours, how, name)
    return values, (*notes, *of_colours, _scale_note(how.scale, coloured=channels > 2))


def _chosen(
    colours: Shaped[np.ndarray, "row column channel"], how: PictureReading, name: str
) -> tuple[Values, tuple[str, ...]]:
    """Return the channel that the study asks for, or grey."""
    wanted = how.channel or "grey"
    if colours.shape[2] == 1:
        if wanted != "grey":
            raise refused(f"{name} has no colours", f"channel: {wanted}", "channel: grey", "Remove `channel`.")
        return _linear(colours[..., 0], how.scale, name), ()
    if wanted != "grey":
        return _linear(colours[..., COLOURS.index(wanted)], how.scale, name), (f"the {wanted} channel",)
    total = np.zeros(colours.shape[:2])
    for k, weight in enumerate(LUMA):
        total += weight * _linear(colours[..., k], how.scale, name)
    shares = ", ".join(f"{weight:.4f} {colour}" for weight, colour in zip(LUMA, COLOURS, strict=True))
    return total, (f"RGB converted to grey by Rec. 709 luma: {shares}",)


def _scale_note(scale: str | None, *, coloured: bool) -> str:
    if scale is None:
        advice = "; `scale: sRGB` undoes the code of a camera's colours" if coloured else ""
        return f"grey values taken as intensity, because the study states no scale{advice}"
    return f"scale {scale} from the study" + ("" if scale == "intensity" else ", undone")


def _linear(raw: Shaped[np.ndarray, "row column"], scale: str | None, name: str) -> Values:
    """Return the intensity; pixels that are not finite stay so, but for the logarithm of nothing."""
    values = raw.astype(np.float64)
    if scale == "amplitude":
        if (values < 0).any():
            expected, remedy = "amplitudes from 0", "Correct `scale`."
            raise refused(f"{name} has negative amplitudes", float(values.min()), expected, remedy)
        return values**2
    if scale in ("log10", "dB"):
        return _of_decibels(values if scale == "dB" else 10 * values, name)
    return _of_srgb(values, raw.dtype, name) if scale == "sRGB" else values


def _of_decibels(values: Values, name: str) -> Values:
    """Return 10^(v/10); a range that no detector has is refused."""
    seen = values[values > -np.inf]
    if seen.size and (np.ptp(seen) > MOST_DECIBELS or abs(seen).max() > 10 * MOST_DECIBELS):
        raise refused(
            f"{name} has no logarithms of intensities",
            f"{seen.min():g} to {seen.max():g} dB",
            f"a range below {MOST_DECIBELS:g} dB",
            "A picture for the screen has lost its scale: export the numbers, or correct `scale`.",
        )
    return np.asarray(10.0 ** (values / 10))


def _of_srgb(values: Values, kind: np.dtype, name: str) -> Values:
    """Return the intensity from 0 to 1 of numbers coded for a screen (IEC 61966-2-1)."""
    coded = values / (np.iinfo(kind).max if kind.kind == "u" else 1)
    if coded.min() < 0 or coded.max() > 1 or kind.kind not in "uf":
        expected = "unsigned whole numbers, or numbers from 0 to 1"
        raise refused(f"{name} is not coded as sRGB", f"{values.min():g} to {values.max():g}", expected)
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
