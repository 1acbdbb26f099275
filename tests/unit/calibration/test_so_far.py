"""The posterior of the runs so far against quadrature of the true model, and against a planted fault."""

import numpy as np
import pytest
from tests.unit.calibration.arches import SD, SPACE, TRACKED, Exact, knowledge, seen

from strandline.calibration.so_far import posterior_so_far
from strandline.design.active import Knowledge
from strandline.interface import GaussianNoise, Observation, PointErrors


def test_it_is_the_posterior_of_the_true_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the draws are not weighted by the likelihood that they lack."""
    observation = Observation(seen(PointErrors(SD)), GaussianNoise((5 * SD) ** 2))
    known, exact = knowledge(TRACKED, {"": observation}), Exact(SPACE, (observation,))
    found, again, other = (posterior_so_far(known, SPACE, seed=seed) for seed in (1, 1, 2))
    assert np.abs((found.mean - exact.mean) / exact.sd).max() < 0.1
    assert np.abs(np.log(found.sd / exact.sd)).max() < 0.08
    assert found.log_evidence == pytest.approx(exact.log_evidence, abs=0.1)
    assert found.quality is not None
    assert found.quality.good
    np.testing.assert_array_equal(found.draws, again.draws)
    assert not np.array_equal(found.draws, other.draws)

    nearly = Knowledge.nearly_expected
    monkeypatch.setattr(Knowledge, "nearly_expected", lambda self, x: 0.5 * nearly(self, x))
    monkeypatch.setattr(Knowledge, "expected", lambda self, x, plug_in=None: 0.5 * nearly(self, x))
    planted = posterior_so_far(known, SPACE, seed=1)
    assert np.abs(np.log(planted.sd / exact.sd)).max() > 0.08
