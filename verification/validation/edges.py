"""How well edges are found in rendered pictures, and how well their own errors are known.

Cameras (blur 1.5 px, contrast/noise 10) and OCT B-scans (10 dB, exponential speckle, three shadows) of arches like the
biofilm's. Paths are 12 clicks, off by 2.5 px; both ends are trimmed by 5 %.

    python -m verification.validation.edges [--pictures 40] [PART ...]
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from verification.validation.rendered import Camera, Scan, arch, clicks
from verification.validation.tables import arguments, show, table

from strandline.discrepancy.normal_offset import signed_distances
from strandline.foundations import InvalidInput
from strandline.imaging.edges.edge import Edge, find_edge
from strandline.imaging.edges.strip import EdgeMethod
from strandline.interface import Interface

CAMERA, SCAN = (136, 280), (170, 233)
"""Rows and columns."""
FAR = 4.0
"""Distance from the truth beyond which a point is wrong, px."""


@dataclass(frozen=True)
class Case:
    """Pictures of one kind and the way their edges are found."""

    name: str
    method: str | EdgeMethod
    render: Camera | Scan

    @property
    def shape(self) -> tuple[int, int]:
        return CAMERA if isinstance(self.render, Camera) else SCAN


CASES = (
    Case("camera, erf", "erf", Camera()),
    Case("camera, contour", "contour", Camera()),
    Case("camera, contrast/noise 3, erf", "erf", Camera(contrast_to_noise=3.0)),
    Case("camera, blur 4, erf", "erf", Camera(blur=4.0)),
    Case("OCT 10 dB, path", "path", Scan()),
    Case("OCT 10 dB, speckle 0.85 px, path", "path", Scan(speckle=0.85)),
    Case("OCT 10 dB, unshadowed noise floor, path", "path", Scan(floor=0.5)),
    Case("OCT 6 dB, path", "path", Scan(contrast=6.0)),
    Case("OCT 10 dB, shadows anywhere, path", "path", Scan(over=(0.0, 1.0))),
)


def found(case: Case, seed: int) -> tuple[np.ndarray, Edge, float] | None:
    """Return the edge in one picture with its signed distances from the truth, px, and seconds; None if refused."""
    random = np.random.default_rng([3, seed])
    line, region = arch(case.shape, random)
    picture, path = case.render(region, case.shape, random), clicks(line, random)
    path = np.clip(path, 0.0, np.array(case.shape[::-1]) - 1.0)
    start = time.perf_counter()
    try:
        edge = find_edge(picture, path, method=case.method)
    except InvalidInput as refusal:
        print(f"  {case.name}, picture {seed}: {str(refusal).partition('.')[0]}", flush=True)
        return None
    seconds = time.perf_counter() - start
    return signed_distances(edge.points, Interface.polyline(line[::3])), edge, seconds


def true_length(parts: Sequence[np.ndarray], spacing: float) -> float:
    """Return the integral correlation length of errors about their means, px, up to the first zero."""
    lags = min(min(len(part) for part in parts) - 1, 150)
    centred = [part - part.mean() for part in parts]
    products = np.array([np.mean([(one[: len(one) - k] * one[k:]).mean() for one in centred]) for k in range(lags)])
    below = np.flatnonzero(products <= 0)
    return spacing * (0.5 + float(products[1 : below[0] if below.size else None].sum() / products[0]))


def row(case: Case, pictures: int) -> tuple:
    """Return bias, its sd over pictures, s, ℓ, s²ℓ, own values over these, and wrong points for one kind of picture."""
    all_found = [one for one in (found(case, seed) for seed in range(pictures)) if one is not None]
    if not all_found:
        return case.name, 0, *([None] * 13)
    off, edges, seconds = zip(*all_found, strict=True)
    means, sds = (np.array([getattr(part, name)() for part in off]) for name in ("mean", "std"))
    s, errors = float(np.sqrt(np.mean(sds**2))), [edge.errors for edge in edges]
    length = true_length(off, errors[0].spacing)
    names = ("sd", "length", "level", "offset")
    own, own_length, level, offset = (np.array([getattr(e, name) for e in errors]) for name in names)
    of_truth = means.mean(), means.std(), np.sqrt(np.mean(offset**2)), s, length, s**2 * length
    of_own = own.mean() / s, (own / s).min(), (own / s).max(), own_length.mean() / length, level.mean() / of_truth[-1]
    wrong = 100 * (np.abs(np.concatenate(off)) > FAR).mean()
    return case.name, len(off), *map(float, (*of_truth, *of_own, wrong, np.median(seconds)))


HEADING = (
    "picture, method | found {d} | bias, px {+.3f} | its sd {.3f} | own offset {.2f} | s, px {.3f} | ℓ, px {.2f} "
    "| s²ℓ {.3f} | own s / s {.2f} | smallest {.2f} | largest {.2f} | own ℓ / ℓ {.2f} | own s²ℓ / s²ℓ {.2f} "
    "| points > 4 px off, % {.2f} | seconds {.3f}"
)


def _main() -> None:
    options = arguments(__doc__, words="PART", pictures=40)
    cases = [case for case in CASES if not options.words or any(word in case.name for word in options.words)]
    rows = (row(case, options.pictures) for case in cases)
    show([table("edges", "Edges in rendered pictures", HEADING, rows, live=True)])


if __name__ == "__main__":
    _main()
