"""Which files are changed, and where tests are that should notice."""

from pathlib import Path
from zlib import crc32

import numpy as np
from verification.mutation.operators import Mutant, mutants

PARTS = {
    "sampler": ("smc",),
    "posterior": ("posterior",),
    "likelihood": ("likelihood",),
    "discrepancy": ("discrepancy",),
    "active design": ("design/active",),
    "field surrogate": ("surrogate/field",),
    "runs": ("runs",),
    "readers": ("readers",),
    "pictures": ("imaging",),
    "studies": ("studies",),
}
"""What a posterior is trusted for, and what brings runs, files and pictures to it: names of parts, and folders of the
package with all that is in them."""
USED_IN = {
    "active design": ("calibration",),
    "field surrogate": ("calibration",),
    "runs": ("slurm",),
    "studies": ("questions", "cli"),
}
"""Rooms whose tests should notice changes of a part, too."""
TIERS = ("unit", "study", "doors")
"""Folders of tests, quick ones first."""


def part_of(file: Path) -> str:
    """Return the part of a file, from the package's folder."""
    return next(part for part, folders in PARTS.items() if any(file.is_relative_to(one) for one in folders))


def near(part: str) -> list[str]:
    """Return the folders of tests of a part, quick ones first."""
    rooms = {folder.partition("/")[0] for folder in PARTS[part]} | {*USED_IN.get(part, ())}
    return [f"{tier}/{room}" for tier in TIERS for room in sorted(rooms)]


def drawn(package: Path, number: int, seed: int) -> list[tuple[Path, Mutant]]:
    """Return mutants drawn at random: one of each file, the others in proportion to the places for changes.

    What is drawn of a file depends on this file alone, but for how many: after a change of one file, the results of the
    others still count.
    """
    first: list[tuple[Path, Mutant]] = []
    others: list[tuple[float, Path, Mutant]] = []
    for folder in (folder for part in PARTS.values() for folder in part):
        for file in sorted((package / folder).rglob("*.py")):
            path, places = file.relative_to(package), mutants(file.read_text("utf-8"))
            random = np.random.default_rng([seed, crc32(str(path).encode())])
            ranks = random.random(len(places))
            picked = [(path, places[i][random.integers(len(places[i]))]) for i in np.argsort(ranks)]
            first += picked[:1]
            others += [(float(rank), *one) for rank, one in zip(np.sort(ranks)[1:], picked[1:], strict=True)]
    rest = sorted(others, key=lambda one: one[0])[: max(number - len(first), 0)]
    chosen = first[:number] + [(path, mutant) for _, path, mutant in rest]
    return sorted(chosen, key=lambda one: (str(one[0]), one[1].start))
