"""From pictures to intervals: edges lie where the outline is, the needle gives the scale, and aims can be missed."""

from dataclasses import replace

import numpy as np
import pytest
from verification.validation import bubble
from verification.validation.bubble import NEEDLE, PHOTOGRAPH, TRUTH, VARIANTS, Found
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
COVER = Cover("good", EVEN, SURE, np.ones_like(EVEN), refused=0.0)
UNCOVERED = {
    "of the intervals of E": {"ranks": SURE},
    "of the intervals of ν": {"ranks": 0.5 + 0.5 * (EVEN - 0.5)},
    "control": {"control": EVEN},
    "refused": {"refused": 0.1},
}
FOUND = Found("good", 71.0, 1.0, 69.0, 73.0, flagged=False, verdict="fits")
MISSED = {
    "95 %": {"high": TRUTH - 0.1},
    "0.4 to 1.5": {"sd": 1.6},
    "0.5 standard": {"mean": 71.6},
    "within 25 %": {"sd": 0.7},
    "fits": {"flagged": True},
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


def test_what_is_in_the_photograph_is_where_the_variant_says_and_the_needle_gives_the_size_of_a_pixel():
    rows, columns = np.mgrid[:120, :160]
    at = np.array([100.0, 40.0])
    grey = 200 * np.exp(-((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / (2 * 4.0**2))
    for variant in VARIANTS:
        changed = variant.change(grey)
        weights = np.where(changed > 40, changed, 0.0)
        y, x = (float((weights * axis).sum() / weights.sum()) for axis in np.indices(changed.shape))
        np.testing.assert_allclose([x, y], variant.place(at, (160, 120)), atol=0.1, err_msg=variant.name)
    # A needle 100 px wide, leaning by 0.1 in x per pixel in y.
    y, x = np.mgrid[:200, :240].astype(float)
    across = (x - 0.1 * y - 50) / np.hypot(1, 0.1)
    grey = np.where((across > 0) & (across < 100), 20.0, 200.0)
    sides = np.array([[[53.0, 30.0], [67.0, 170.0]], [[153.5, 30.0], [167.5, 170.0]]])
    assert bubble.pixel(grey, sides) == pytest.approx(NEEDLE / 100, rel=2e-3)


def test_each_aim_can_be_missed():
    assert not COVER.missed()
    for said, change in UNCOVERED.items():
        assert any(said in one for one in replace(COVER, **change).missed())
    assert not bubble.missed(FOUND, FOUND)
    for said, change in MISSED.items():
        assert any(said in one for one in bubble.missed(replace(FOUND, **change), FOUND))


@pytest.mark.long
def test_intervals_from_pictures_of_a_camera_contain_the_truth(tmp_path):
    """40 pictures: 90 % of the intervals in the mean, with a standard deviation of 5 %."""
    use_double()
    found = covered(surrogate(32, tmp_path), "camera", KINDS["camera"], 40)
    assert (found.found > 0.75).all()
    assert (found.of_control < 0.6).all()
    assert found.refused == 0


@pytest.mark.long
@pytest.mark.skipif(not PHOTOGRAPH.exists(), reason="the photograph is not here")
def test_surface_tension_of_water_at_full_and_at_half_the_resolution(tmp_path):
    use_double()
    grey, some = bubble.grey_of(PHOTOGRAPH), ("original", "half the resolution")
    chosen = [one for one in VARIANTS if one.name in some]
    studies = [bubble.study(tmp_path / one.name, one, grey, particles=500) for one in chosen]
    found = [bubble.answer(study, one.name) for study, one in zip(studies, chosen, strict=True)]
    assert not [said for one in found for said in bubble.missed(one, found[0])]
