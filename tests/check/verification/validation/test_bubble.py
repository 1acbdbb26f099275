"""The photograph of a bubble: variants of it lie where they should, the needle gives the scale, aims can be missed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verification.validation import bubble
from verification.validation.bubble import NEEDLE, PHOTOGRAPH, TRUTH, VARIANTS, Found, missed

from strandline.numerics.precision import use_double

GOOD = Found("good", 71.0, 1.0, 69.0, 73.0, flagged=False, verdict="fits")
MISSED = {
    "95 %": {"high": TRUTH - 0.1},
    "0.4 to 1.5": {"sd": 1.6},
    "0.5 standard": {"mean": 71.6},
    "within 25 %": {"sd": 0.7},
    "fits": {"flagged": True},
}


def test_what_is_in_the_photograph_is_where_the_variant_says():
    rows, columns = np.mgrid[:120, :160]
    at = np.array([100.0, 40.0])
    grey = 200 * np.exp(-((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / (2 * 4.0**2))
    for variant in VARIANTS:
        changed = variant.change(grey)
        weights = np.where(changed > 40, changed, 0.0)
        y, x = (float((weights * axis).sum() / weights.sum()) for axis in np.indices(changed.shape))
        np.testing.assert_allclose([x, y], variant.place(at, (160, 120)), atol=0.1, err_msg=variant.name)


def test_the_needle_gives_the_size_of_a_pixel():
    """A needle 100 px wide, leaning by 0.1 in x per pixel in y."""
    y, x = np.mgrid[:200, :240].astype(float)
    across = (x - 0.1 * y - 50) / np.hypot(1, 0.1)
    grey = np.where((across > 0) & (across < 100), 20.0, 200.0)
    sides = np.array([[[53.0, 30.0], [67.0, 170.0]], [[153.5, 30.0], [167.5, 170.0]]])
    assert bubble.pixel(grey, sides) == pytest.approx(NEEDLE / 100, rel=2e-3)


def test_each_aim_can_be_missed():
    assert not missed(GOOD, GOOD)
    for said, change in MISSED.items():
        assert any(said in one for one in missed(replace(GOOD, **change), GOOD))


@pytest.mark.long
@pytest.mark.skipif(not PHOTOGRAPH.exists(), reason="the photograph is not here")
def test_surface_tension_of_water_at_full_and_at_half_the_resolution(tmp_path: Path):
    use_double()
    grey = bubble.grey_of(PHOTOGRAPH)
    found = [
        bubble.answer(bubble.study(tmp_path / str(k), one, grey, particles=500), one.name)
        for k, one in enumerate(VARIANTS)
        if one.name in ("original", "half the resolution")
    ]
    assert not [said for one in found for said in missed(one, found[0])]
