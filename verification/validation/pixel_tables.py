"""What the pixels on each normal of an edge say about its place there: tables log p(pixels | place).

Cameras: blurred steps in Gaussian noise, with levels that are smooth along the edge. OCT: gamma with the picture's own
mean profile. The tables treat samples as independent; the share of them that counts is returned as well.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.special import ndtr
from verification.validation.rendered import Scan

from strandline.imaging.edge import Edge
from strandline.imaging.noise_covariance import autocovariance, sum_to_first_zero
from strandline.imaging.template import learnt_template, levelled

CANDIDATES = np.arange(-80, 81) * 0.05
"""Places of the edge on a normal, px from the edge's smoothed course."""


@dataclass(frozen=True, eq=False)
class Tables:
    """Log-likelihoods of all samples as if independent, and estimated and known shares of samples that count."""

    values: Float[np.ndarray, "normal candidate"]
    estimated: float
    known: float


def tables(edge: Edge, places: Float[np.ndarray, " normal"], kind: str) -> Tables:
    """Return what the pixels of each kept normal say, with all levels estimated around an edge at these places."""
    strip, kept = edge.strip, edge.kept
    offsets = np.interp(np.arange(len(kept)), np.flatnonzero(kept), places)
    at = strip.places - CANDIDATES[:, None]
    if kind == "camera":
        phi = ndtr((strip.places - offsets[:, None]) / edge.errors.blur)
        one, up, two, z, zp = (
            gaussian_filter1d((strip.usable * part).sum(axis=1), 5.0)
            for part in (np.ones_like(phi), phi, phi**2, strip.samples, strip.samples * phi)
        )
        jump = (one * zp - up * z) / (one * two - up**2)
        low = (z - jump * up) / one
        residuals = np.where(strip.usable, strip.samples - low[:, None] - jump[:, None] * phi, 0.0)
        f, w = ndtr(at / edge.errors.blur).T, strip.usable
        above = np.where(w, strip.samples - low[:, None], 0.0)
        values = (above @ f) * jump[:, None] - 0.5 * jump[:, None] ** 2 * (w @ f**2)
        area, white = 1.0, strip.kept
    else:
        even = strip
        for _ in range(3):
            template, shift = learnt_template(even, offsets)
            expected = template.at(strip.places - (offsets + shift)[:, None])
            even = levelled(even, expected, relative=True)
        residuals = np.where(strip.usable, even.samples / expected - 1, 0.0)
        m = template.at(at)
        values = -(even.samples @ (1 / m).T + strip.usable @ np.log(m).T)
        area, white = 2 * math.pi * Scan().speckle ** 2, 1.0
    residuals, size = residuals[kept], (7.5, 7.5 / strip.step)
    usable = strip.usable[kept]
    variance = float((residuals**2).sum() / usable.sum())
    slow = gaussian_filter(residuals, size) / np.maximum(gaussian_filter(usable.astype(float), size), 1e-9)
    lags = autocovariance(np.where(usable, residuals - slow, 0.0), usable)
    together = math.prod(2 * sum_to_first_zero(one / one[0]) for one in (lags[:9, 0], lags[0, : round(8 / strip.step)]))
    return Tables(values[kept] / variance, 1 / together, strip.step * white / area)
