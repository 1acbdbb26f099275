"""Many repeated experiments: ranks and intervals are what they say, right models are seldom flagged; mistakes show."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.calibration import test_misfit as misfit
from tests.unit.calibration.arches import SD
from tests.unit.calibration.test_coverage import from_prior, least_p, repeated
from tests.unit.likelihood import test_inferred_noise as inferred

from strandline.discrepancy import NormalOffset
from strandline.interface import GaussianNoise, PointErrors

pytestmark = pytest.mark.long
ALL = PointErrors(SD, 0.05, shift=0.02, offset=0.03)


def test_many_replicates_are_inside_the_bands():
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
        pytest.param(ALL, PointErrors(SD**2), 25, "narrow", id="σ² given for σ"),
        pytest.param(PointErrors(SD), GaussianNoise(0.5 * SD**2), 400, "narrow", id="½ forgotten"),
        pytest.param(ALL, replace(ALL, offset=0.0), 300, "leave the 95 % band", id="offset dropped"),
    ],
)
def test_mistakes_show_in_many_replicates(noise, analysed, number, word):
    """Planted: posteriors a hundred times too narrow, √2 times, and without one of the errors."""
    found = repeated(from_prior(noise, NormalOffset()), analysed, number)
    assert not found.calibrated
    assert word in found.verdict


def test_coverage_with_unknown_noise():
    """Planted: correlated points taken as independent, with an sd that is known."""
    scores, planted = [], []
    for seed in range(100):
        for found, noise in ((scores, inferred.UNKNOWN), (planted, PointErrors(inferred.ERRORS.sd))):
            mean, sd = inferred.grid(inferred.observed(seed, noise=noise), 41)
            found.append((inferred.TRUTH - mean) / sd)
    covered = (np.abs(scores) < 1.645).mean(axis=0)
    assert ((covered > 0.82) & (covered < 0.97)).all()
    assert (np.abs(planted) < 1.645).mean(axis=0).min() < 0.7


@pytest.mark.parametrize("errors", [misfit.LOCAL, misfit.ALL], ids=["local", "all"])
def test_a_right_model_is_flagged_in_one_case_of_twenty_at_most(errors):
    assert misfit.flagged(errors, 200, misfit.FULL) <= 10
