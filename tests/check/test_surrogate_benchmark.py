"""The benchmark of the fit on few runs: every peer must give our evidence, or it stops."""

from verification.benchmarks import surrogate

from strandline.surrogate import KERNELS


def test_peers_have_the_same_evidence():
    assert all(surrogate.floor(name, 60).ours > 0 for name in KERNELS)
    for name in ("matern32_ard", "matern32_product"):
        assert surrogate.scikit_learn(name, 60).peer_name == "scikit-learn"
