"""Designs: nested, equal to an independent Sobol generator, evenly spread."""

import numpy as np
import pytest
from scipy.stats import qmc

from strandline.design import sobol
from strandline.errors import InvalidInput


@pytest.mark.parametrize("scramble", [None, 7])
def test_larger_designs_begin_with_the_smaller_ones(scramble):
    for dim in (1, 7):
        large = sobol(300, dim, scramble=scramble)
        for number in (1, 2, 3, 64, 65, 299):
            assert np.array_equal(sobol(number, dim, scramble=scramble), large[:number])


def test_it_is_the_sequence_in_the_literature_and_scipys_own():
    assert sobol(4, 2).tolist() == [[0.0, 0.0], [0.5, 0.5], [0.75, 0.25], [0.25, 0.75]]
    engine = qmc.Sobol(3, scramble=False)
    assert np.array_equal(sobol(100, 3), np.vstack([engine.random(1) for _ in range(100)]))


@pytest.mark.parametrize("scramble", [None, 3])
def test_every_dyadic_stratum_gets_its_share(scramble):
    """256 points: one in each of 256 equal slices of every axis, four in each square of an 8 × 8 grid."""
    points = sobol(256, 2, scramble=scramble)
    for column in points.T:
        assert np.array_equal(np.sort((column * 256).astype(int)), np.arange(256))
    counts, _, _ = np.histogram2d(*points.T, bins=8, range=[[0, 1], [0, 1]])
    assert (counts == 4).all()


def test_scrambling_is_reproducible_and_keeps_to_the_cube():
    assert np.array_equal(sobol(50, 2, scramble=1), sobol(50, 2, scramble=1))
    assert not np.array_equal(sobol(50, 2, scramble=1), sobol(50, 2, scramble=2))
    points = sobol(1000, 5, scramble=4)
    assert 0 <= points.min() < points.max() < 1


def test_empty_designs_are_refused():
    for number, dim in [(0, 2), (-1, 2), (3, 0)]:
        with pytest.raises(InvalidInput, match="Sobol"):
            sobol(number, dim)
