"""Aims for the figures of the benchmark, and which figures each aim applies to.

An aim applies to every figure of its part whose text (task, then case) matches its pattern, ignoring case. Aims for a
ratio, of wall seconds or of the seconds of all cores, apply to figures with a peer whose name matches the last pattern;
aims for a value apply to the others, in the unit of the aim. If several aims apply, the first one counts.
"""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

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

    def applies(self, record: Mapping[str, Any]) -> bool:
        """Return whether the aim applies to this figure."""
        text = f"{record['what']}, {record.get('case', '')}"
        if record["part"] != self.part or not re.search(self.task, text, re.IGNORECASE):
            return False
        peer = record.get("peer_name")
        if self.kind in (RATIO, PER_CORE):
            return bool(peer) and re.search(self.peer_or_unit, str(peer), re.IGNORECASE) is not None
        return not peer and record.get("unit") == self.peer_or_unit

    def met(self, record: Mapping[str, Any]) -> bool | None:
        """Return whether the figure meets the aim; None if it was not measured."""
        figure = record.get(FIGURES[self.kind])
        if figure is None:
            return None
        return bool(figure <= self.bound if self.kind == MOST else figure >= self.bound)


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


def aim_of(record: Mapping[str, Any]) -> Aim | None:
    """Return the first aim that applies to this figure."""
    return next((aim for aim in AIMS if aim.applies(record)), None)
