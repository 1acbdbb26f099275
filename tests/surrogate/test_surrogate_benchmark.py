"""The benchmark of the fit on few runs: every peer must give our evidence, or it stops."""

import pytest
from verification.benchmarks import surrogate

from strandline.surrogate import KERNELS


@pytest.mark.parametrize("name", KERNELS)
def test_the_floor_has_the_same_evidence(name):
    assert surrogate.floor(name, 60).ours > 0


@pytest.mark.parametrize("name", ["matern32_ard", "matern32_product"])
def test_scikit_learn_has_the_same_evidence(name):
    assert surrogate.scikit_learn(name, 60).peer_name == "scikit-learn"
