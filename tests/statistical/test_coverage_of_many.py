"""Many repeated experiments: ranks stay inside their bands, and small mistakes leave them."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.calibration.arches import SD
from tests.unit.calibration.test_coverage import from_prior, least_p, repeated

from strandline.discrepancy import NormalOffset
from strandline.interface import GaussianNoise, Noise, PointErrors

pytestmark = pytest.mark.long
ALL = PointErrors(SD, 0.05, shift=0.02, offset=0.03)


def test_many_replicates_are_inside_the_bands() -> None:
    source = from_prior(PointErrors(SD, 0.05, shift=0.02, offset=0.01), NormalOffset())
    found = repeated(source, number=300)
    assert least_p(found) > 1e-3
    assert np.abs(found.z.std(axis=0) - 1).max() < 0.15
    for one in found.intervals:
        assert (one.low < one.level + 0.03).all()
        assert (one.high > one.level - 0.03).all()


@pytest.mark.parametrize(
    ("noise", "analysed", "number", "word"),
    [
        (ALL, PointErrors(SD**2), 25, "narrow"),
        (PointErrors(SD), GaussianNoise(0.5 * SD**2), 400, "narrow"),
        (ALL, replace(ALL, offset=0.0), 300, "leave the 95 % band"),
    ],
    ids=["σ² given for σ", "½ forgotten", "offset dropped"],
)
def test_mistakes_show_in_many_replicates(
    noise: PointErrors, analysed: Noise | PointErrors, number: int, word: str
) -> None:
    """Planted: posteriors a hundred times too narrow, √2 times, and without one of the errors."""
    found = repeated(from_prior(noise, NormalOffset()), analysed, number)
    assert not found.calibrated
    assert word in found.verdict
