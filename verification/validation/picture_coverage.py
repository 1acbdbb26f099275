"""How often 90 % intervals contain the truth on the biofilm if all that is known of the noise comes from one picture.

The field surrogate learns from Sobol runs of the real model. Truths are drawn from the prior. Each predicted outline is
shifted, turned, scaled and offset at random and rendered as a camera or an OCT scan sees it; 12 clicks, off by 2.5 px,
begin the search for its edge. The sd, correlation length and offset of the edge are those that the picture shows.
Shift, rotation and scale have the priors from which they were drawn. The offset is drawn with the sd that the method
states, and the method's own bias comes on top. Posteriors are integrated on a grid around the estimate.

    python -m verification.validation.picture_coverage [--pictures 200] [--runs 64] [--ledger FOLDER] [KIND ...]
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from verification.validation.noise_coverage import GLOBAL, HIGH, LOW, figures, limit, posterior, surrogate
from verification.validation.rendered import PIXEL, Camera, Scan, clicks
from verification.validation.tables import arguments, finish, kept_or_scratch, show, table

from strandline.discrepancy import NormalOffset
from strandline.foundations import InvalidInput, use_double
from strandline.imaging.edges.edge import Edge, find_edge
from strandline.imaging.edges.edge_methods import EDGES
from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood import FieldLikelihood
from strandline.posterior.rank_tests import coverage_of
from strandline.surrogate.field import FieldSurrogate

MARGIN = 20
"""Rows and columns of the picture beyond the outline."""
FINE = 3
"""Nodes of the rendered outline per pixel."""
AIM, CONTROL = (0.85, 0.95), 0.60
"""Coverage of 90 % intervals that is wanted, and below which the control with independent points must be."""
MOST_REFUSED = 0.05


@dataclass(frozen=True)
class Kind:
    """A kind of picture, the way its edge is found, and whether aims are set for it."""

    render: Camera | Scan
    method: str
    judged: bool = True

    @property
    def method_bias(self) -> float:
        """Standard deviation of the offset that the method states, px."""
        return float(EDGES[self.method].bias)


KINDS = {
    "camera": Kind(Camera(), "erf"),
    "OCT 10 dB": Kind(Scan(), "path"),
    "OCT 10 dB, shadows anywhere": Kind(Scan(over=(0.0, 1.0)), "path", judged=False),
    "OCT 6 dB": Kind(Scan(contrast=6.0), "path", judged=False),
}


@dataclass(frozen=True, eq=False)
class Cover:
    """Ranks of the truths, those if points are taken as independent, sds, and the share of pictures without an edge."""

    kind: str
    ranks: Float[np.ndarray, "picture 2"]
    control: Float[np.ndarray, "picture 2"]
    sds: Float[np.ndarray, "picture 2"]
    refused: float

    @property
    def found(self) -> Float[np.ndarray, " 2"]:
        """Share of the 90 % intervals that contain the truth, for E and for ν."""
        return np.asarray(coverage_of(self.ranks, 0.9).found)

    @property
    def of_control(self) -> Float[np.ndarray, " 2"]:
        return np.asarray(coverage_of(self.control, 0.9).found)

    def row(self) -> tuple[str | float, ...]:
        cover, others = np.split(np.array(figures(self.ranks, self.sds, np.ones(2))), [2])
        shares = [*cover.tolist(), *(100 * self.of_control).tolist()]
        return self.kind, len(self.ranks), 100 * self.refused, *shares, *others.tolist()

    def missed(self) -> list[str]:
        said = []
        for name, share, control in zip(("E", "ν"), self.found, self.of_control, strict=True):
            if not AIM[0] <= share <= AIM[1]:
                said.append(f"{self.kind}: {100 * share:.1f} % of the intervals of {name} contain the truth")
            if control >= CONTROL:
                said.append(f"{self.kind}: the control covers {name} in {100 * control:.1f} %")
        if self.refused > MOST_REFUSED:
            said.append(f"{self.kind}: {100 * self.refused:.1f} % of the pictures refused")
        return said


def seen_in(true: Interface, kind: Kind, random: np.random.Generator) -> tuple[Interface, Edge]:
    """Return the edge in a picture of the region under an outline, in the model's coordinates and in pixels.

    Its errors are in mm; the search begins at clicks along the outline. A picture may show no edge: `InvalidInput`.
    """
    fine = true.resampled(round(FINE * float(true.lengths.sum()) / PIXEL)).points
    low, high = fine.min(axis=0), fine.max(axis=0)
    columns, rows = np.ceil((high - low) / PIXEL).astype(int) + 2 * MARGIN
    origin = np.array([MARGIN - low[0] / PIXEL, rows - MARGIN + low[1] / PIXEL]) + random.uniform(-0.5, 0.5, 2)
    line = origin + fine * [1, -1] / PIXEL
    region = np.concatenate([line, [[line[-1, 0], rows + 40.0], [line[0, 0], rows + 40.0]]])
    picture = kind.render(region, (int(rows), int(columns)), random)
    path = np.clip(clicks(line, random), 0.0, np.array([columns, rows]) - 1.0)
    edge = find_edge(picture, path, method=kind.method, pixel=(PIXEL, PIXEL))
    return Interface.polyline((edge.points - origin) * [PIXEL, -PIXEL]), edge


def covered(field: FieldSurrogate, name: str, kind: Kind, pictures: int) -> Cover:
    """Return the ranks of truths in the posteriors from so many pictures."""
    truths = LOW + (HIGH - LOW) * np.random.default_rng(12).random((pictures, 2))
    known = {what: GLOBAL[what] for what in ("shift", "rotation", "scale")}
    moving, found, control = PointErrors(PIXEL, **(GLOBAL | {"offset": PIXEL * kind.method_bias})), [], []
    for k, truth in enumerate(truths):
        random = np.random.default_rng([13, k])
        placed = moving.moved(field.interfaces(truth)[""], random.standard_normal(5))
        try:
            seen, edge = seen_in(placed, kind, random)
        except InvalidInput as refusal:
            print(f"  {name}, picture {k}: {str(refusal).partition('.')[0]}", flush=True)
            continue
        own = edge.errors
        errors = PointErrors(own.sd, own.length, offset=own.offset, **known)
        for noise, kept in ((errors, found), (PointErrors(own.sd), control)):
            likelihood = FieldLikelihood(field, (Observation(seen, noise),), NormalOffset())
            kept.append(posterior(likelihood, truth, *limit(field, seen, noise)))
    (ranks, sds), (of_control, _) = ([np.array(part) for part in zip(*some, strict=True)] for some in (found, control))
    return Cover(name, ranks, of_control, sds, 1 - len(ranks) / pictures)


HEADING = (
    "picture | found {d} | refused, % {.1f} | E covered, % {.1f} | ν covered, % {.1f} | control: E, % {.1f} "
    "| ν, % {.1f} | p(E) {.3f} | p(ν) {.3f} | sd(E), Pa {.1f} | sd(ν) {.3f}"
)


def _main() -> None:
    options = arguments(__doc__, words=KINDS, pictures=200, runs=64, ledger=Path)
    use_double()
    with kept_or_scratch(options.ledger) as folder:
        field = surrogate(options.runs, folder)
    kinds = options.words or [name for name, kind in KINDS.items() if kind.judged]
    found = (covered(field, name, KINDS[name], options.pictures) for name in kinds)
    missed = []

    def rows() -> Iterator[tuple[str | float, ...]]:
        for one in found:
            missed.extend(one.missed() if KINDS[one.kind].judged else [])
            yield one.row()

    show([table("picture_coverage", "Coverage from pictures", HEADING, rows(), live=True)])
    finish(missed)


if __name__ == "__main__":
    _main()
