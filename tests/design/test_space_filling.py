"""Designs: nested, equal to an independent Sobol generator, evenly spread."""

import numpy as np
import pytest
from scipy.stats import qmc

from strandline.design import sobol
from strandline.errors import InvalidInput


@pytest.mark.parametrize("scramble", [None, 7])
@pytest.mark.parametrize("dim", [1, 2, 7])
def test_larger_designs_begin_with_the_smaller_ones(dim, scramble):
    large = sobol(300, dim, scramble=scramble)
    for number in (1, 2, 3, 64, 65, 256, 299):
        assert np.array_equal(sobol(number, dim, scramble=scramble), large[:number])


@pytest.mark.parametrize("number", [1, 5, 64, 100])
def test_agrees_with_scipys_own_sequence(number):
    engine = qmc.Sobol(3, scramble=False)
    one_by_one = np.vstack([engine.random(1) for _ in range(number)])
    assert np.array_equal(sobol(number, 3), one_by_one)


def test_first_points_are_those_in_the_literature():
    assert sobol(4, 2).tolist() == [[0.0, 0.0], [0.5, 0.5], [0.75, 0.25], [0.25, 0.75]]


@pytest.mark.parametrize("scramble", [None, 3])
def test_every_dyadic_stratum_gets_its_share(scramble):
    """256 points: one in each of 256 equal slices of every axis, four in each square of an 8 × 8 grid."""
    points = sobol(256, 2, scramble=scramble)
    for k in range(2):
        assert np.array_equal(np.sort((points[:, k] * 256).astype(int)), np.arange(256))
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=8, range=[[0, 1], [0, 1]])
    assert (counts == 4).all()


def test_discrepancy_is_low_and_falls_faster_than_that_of_random_numbers():
    rng = np.random.default_rng(0)
    ours = [qmc.discrepancy(sobol(n, 4), method="L2-star") for n in (64, 512)]
    random = [np.median([qmc.discrepancy(rng.random((n, 4)), method="L2-star") for _ in range(9)]) for n in (64, 512)]
    assert ours[1] < 0.5 * random[1]
    assert ours[0] / ours[1] > 1.5 * random[0] / random[1]


def test_scrambling_is_reproducible_and_keeps_to_the_cube():
    assert np.array_equal(sobol(50, 2, scramble=1), sobol(50, 2, scramble=1))
    assert not np.array_equal(sobol(50, 2, scramble=1), sobol(50, 2, scramble=2))
    points = sobol(1000, 5, scramble=4)
    assert points.min() >= 0
    assert points.max() < 1


@pytest.mark.parametrize(("number", "dim"), [(0, 2), (-1, 2), (3, 0)])
def test_refuses_empty_designs(number, dim):
    with pytest.raises(InvalidInput, match="Sobol"):
        sobol(number, dim)
