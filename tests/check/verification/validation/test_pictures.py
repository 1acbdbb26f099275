"""From pictures to intervals: edges lie where the outline is, and intervals contain the truth."""

import numpy as np
import pytest
from verification.validation import bubble
from verification.validation.bubble import PHOTOGRAPH, VARIANTS
from verification.validation.noise_coverage import surrogate
from verification.validation.picture_coverage import KINDS, covered, seen_in
from verification.validation.rendered import PIXEL

from strandline.discrepancy import signed_distances
from strandline.foundations import use_double
from strandline.interface import PointErrors
from strandline.models.biofilm.mesh.outline import Outline

TRUE = Outline(nodes=66).interface()


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
