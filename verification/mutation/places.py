"""Which files are changed, and where tests are that should notice."""

from pathlib import Path

import numpy as np
from verification.mutation.operators import Mutant, mutants

__all__ = ["FAR", "NEAR", "PARTS", "drawn", "part_of"]

PARTS = {
    "sampler": ("smc",),
    "posterior": ("posterior",),
    "likelihood": ("likelihood",),
    "discrepancy": ("discrepancy", "discrepancy/contours", "discrepancy/products", "discrepancy/search"),
    "active design": ("design/active",),
    "field surrogate": ("surrogate/field",),
}
"""What a posterior is trusted for: names of parts, and folders of the package."""
NEAR = {
    "sampler": ("smc",),
    "posterior": ("posterior",),
    "likelihood": ("likelihood",),
    "discrepancy": ("discrepancy",),
    "active design": ("design/active",),
    "field surrogate": ("surrogate/field",),
}
"""Folders of tests of each part."""
FAR = ("smc", "posterior", "likelihood", "discrepancy", "design/active", "surrogate", "interface", "calibration")
"""Folders of tests that may notice too."""


def part_of(file: Path) -> str:
    """Return the part of a file, from the package's folder."""
    return next(part for part, folders in PARTS.items() if str(file.parent) in folders)


def drawn(package: Path, number: int, seed: int) -> list[tuple[Path, Mutant]]:
    """Return mutants drawn at random: one of each file, the others in proportion to the places for changes.

    Args:
        package: Folder of the package.
        number: Number of mutants.
        seed: Seed of the draw.
    """
    random, first, others = np.random.default_rng(seed), [], []
    for folder in (folder for part in PARTS.values() for folder in part):
        for file in sorted((package / folder).glob("*.py")):
            places = mutants(file.read_text("utf-8"))
            order = [places[i] for i in random.permutation(len(places))]
            picked = [(file.relative_to(package), place[random.integers(len(place))]) for place in order]
            first += picked[:1]
            others += picked[1:]
    rest = random.permutation(len(others))[: max(number - len(first), 0)]
    chosen = first[:number] + [others[i] for i in sorted(rest)]
    return sorted(chosen, key=lambda one: (str(one[0]), one[1].start))
