"""From pictures to intervals: edges in rendered pictures lie where the outline is, aims can be missed, a short run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verification.validation.noise_coverage import surrogate
from verification.validation.picture_coverage import KINDS, Cover, covered, moving, seen_in
from verification.validation.rendered import PIXEL

from strandline.discrepancy import signed_distances
from strandline.interface import PointErrors
from strandline.models.biofilm.outline import Outline
from strandline.numerics.precision import use_double

TRUE = Outline(nodes=66).interface()
EVEN = np.stack([np.linspace(0.005, 0.995, 100)] * 2, axis=1)
"""Ranks of which 90 % are within the intervals."""
SURE = np.where(EVEN < 0.5, 0.15 * EVEN, 1 - 0.15 * (1 - EVEN))
"""Ranks of posteriors that are too narrow."""
GOOD = Cover("good", EVEN, SURE, np.ones_like(EVEN), refused=0.0)
MISSED = {
    "of the intervals of E": {"ranks": SURE},
    "of the intervals of ν": {"ranks": 0.5 + 0.5 * (EVEN - 0.5)},
    "control": {"control": EVEN},
    "refused": {"refused": 0.1},
}


@pytest.mark.parametrize("name", ["camera", "OCT 10 dB"])
def test_the_edge_in_a_rendered_picture_is_the_outline(name):
    kind = KINDS[name]
    seen, edge = seen_in(TRUE, kind, np.random.default_rng(1))
    off = signed_distances(seen.points, TRUE) / PIXEL
    assert abs(off.mean()) < 3 * kind.method_bias
    assert off.std() < 1.5 * edge.errors.sd / PIXEL + 0.1
    assert seen.lengths.sum() > 0.85 * TRUE.lengths.sum()


def test_an_outline_that_moved_is_seen_where_it_moved_to():
    moved = PointErrors(0.001, shift=0.02).moved(TRUE, np.array([1.0, -1.0, 0.0, 0.0, 0.0]))
    seen, _ = seen_in(moved, KINDS["camera"], np.random.default_rng(2))
    assert abs(signed_distances(seen.points, moved).mean()) < 0.1 * PIXEL
    assert signed_distances(seen.points, TRUE).std() > PIXEL
    # Places are drawn with the offset that the method states.
    assert moving(KINDS["OCT 10 dB"]).offset > moving(KINDS["camera"]).offset > 0


def test_each_aim_can_be_missed():
    assert not GOOD.missed()
    for said, change in MISSED.items():
        assert any(said in one for one in replace(GOOD, **change).missed())


@pytest.mark.long
def test_intervals_from_pictures_of_a_camera_contain_the_truth(tmp_path: Path):
    """40 pictures: 90 % of the intervals in the mean, with a standard deviation of 5 %."""
    use_double()
    found = covered(surrogate(32, tmp_path), "camera", KINDS["camera"], 40)
    assert (found.found > 0.75).all()
    assert (found.of_control < 0.6).all()
    assert found.refused == 0
