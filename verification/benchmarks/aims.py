"""Aims for the figures of the benchmark, and which figures each aim applies to.

An aim applies to every figure of its part whose text (task, then case) matches its pattern, ignoring case. Aims for a
ratio, of wall seconds or of the seconds of all cores, apply to figures with a peer whose name matches the last pattern;
aims for a value apply to the others, in the unit of the aim. If several aims apply, the first one counts.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from verification.benchmarks.figures import Figure

RATIO, PER_CORE, MOST, LEAST = "ratio ≥", "ratio per core ≥", "value ≤", "value ≥"
FIGURES = {RATIO: "ratio", PER_CORE: "ratio_per_core", MOST: "ours", LEAST: "ours"}


class Aim(NamedTuple):
    """One line of the table below; its name is shown if the figure is missing."""

    name: str
    part: str
    task: str
    kind: str
    bound: float
    peer_or_unit: str

    def applies(self, figure: Figure) -> bool:
        """Return whether the aim applies to this figure."""
        if figure.part != self.part or not re.search(self.task, figure.task, re.IGNORECASE):
            return False
        if self.kind in (RATIO, PER_CORE):
            return bool(figure.peer_name) and bool(re.search(self.peer_or_unit, figure.peer_name, re.IGNORECASE))
        return not figure.peer_name and figure.unit == self.peer_or_unit

    def value(self, figure: Figure) -> float | None:
        """Return what the aim is for; None if it was not measured."""
        return getattr(figure, FIGURES[self.kind])

    def met(self, figure: Figure) -> bool | None:
        """Return whether the figure meets the aim; None if it was not measured."""
        value = self.value(figure)
        return None if value is None else value <= self.bound if self.kind == MOST else value >= self.bound


PRODUCT = r"evidence and gradient, matern32_product, n = 2000\b"
LARGE = r"evidence and gradient, matern32_product, n = 5000\b"
STUDY = r"SMC, .*ζ 0\.995"
LAPACK = round(1 / 1.4, 4)
AIMS = (
    # name, part, task, kind, bound, peer or unit
    Aim("evidence and gradient, 7-D, n = 2000, against JAX", "surrogate", PRODUCT, RATIO, 5, r"jax"),
    Aim("evidence and gradient, 7-D, n = 2000, against scikit-learn", "surrogate", PRODUCT, RATIO, 10, "scikit"),
    Aim("evidence and gradient, 7-D, n = 5000: 1.4 of LAPACK's time", "surrogate", LARGE, RATIO, LAPACK, "dpotrf"),
    Aim("GP mean, n = 1000, 2-D, per core", "sampler", r"GP mean.*n = 1000\b", PER_CORE, 12, "scikit"),
    Aim("GP mean, n = 2000, 7-D, per core", "sampler", r"GP mean.*n = 2000\b", PER_CORE, 9, "scikit"),
    Aim("SMC, the study's setting, BlackJAX that factorises", "sampler", STUDY, RATIO, 10, r"blackjax.*factori"),
    Aim("SMC, the study's setting, BlackJAX with a plain mean", "sampler", STUDY, RATIO, 3, "blackjax"),
    Aim("SMC, the study's setting, scikit-learn", "sampler", STUDY, RATIO, 15, "scikit"),
    Aim("SMC, cores kept busy", "sampler", r"cores kept busy", RATIO, 1.7, "one core"),
    Aim("SMC, economical setting against the study's", "sampler", r"SMC", RATIO, 20, "ours too"),
    Aim("currents, 10⁴ × 10⁴ triangles", "norms", r"currents.*\b1\d{4}²", RATIO, 5, "NumPy"),
    Aim("currents, 10⁵ × 10⁵ triangles, memory", "norms", r"currents.*\b1\d{5}²", MOST, 1000, "MiB"),
    Aim("closest points, 6600 to 2000 segments", "norms", r"closest.*6600.*2000", RATIO, 15, ""),
    Aim("overhead of a run, local processes", "executors", r"overhead.*worker processes", MOST, 5, "ms"),
    Aim("overhead of a run, Dask", "executors", r"overhead.*Dask", MOST, 20, "ms"),
    Aim("strandline --help", "startup", r"--help", MOST, 0.15, "s"),
    Aim("strandline status", "startup", r"status.*plan in the ledger", MOST, 0.6, "s"),
    Aim("runs of the coarse mesh", "forward", r"solves.*coarse", LEAST, 1100, "per minute"),
    Aim("runs of the default mesh", "forward", r"solves.*default", LEAST, 400, "per minute"),
)


def with_aims(figures: Sequence[Figure]) -> list[tuple[Figure, Aim]]:
    """Return the figures that have an aim, each with the first that applies, and an empty one for each other aim."""
    found = [(one, aim) for one in figures if (aim := next((aim for aim in AIMS if aim.applies(one)), None))]
    left = [aim for aim in AIMS if all(aim is not one for _, one in found)]
    return found + [(Figure(aim.name, remark="there is no such figure", part=aim.part), aim) for aim in left]
