"""Designs: nested, equal to an independent Sobol generator, evenly spread."""

import numpy as np
import pytest
from scipy.stats import qmc

import strandline as sl
from strandline.design import over_prior, sobol
from strandline.foundations import InvalidInput


@pytest.mark.parametrize("scramble", [None, 7])
def test_larger_designs_begin_with_the_smaller_ones(scramble):
    for dim in (1, 7):
        large = sobol(300, dim, scramble=scramble)
        for number in (1, 2, 3, 64, 65, 299):
            assert np.array_equal(sobol(number, dim, scramble=scramble), large[:number])


@pytest.mark.parametrize("scramble", [None, 7])
def test_first_runs_of_an_active_design_lie_in_the_priors_quantiles_and_none_in_a_corner(scramble):
    """In ten dimensions, points even in a box of ±4 sds are seven sds from its middle."""
    space = sl.ParameterSpace(tuple(sl.Parameter(f"k{i}", sl.Normal(0.0, 1.0), box=(-4.0, 4.0)) for i in range(10)))
    points = over_prior(space, 64, scramble=scramble)
    assert np.array_equal(over_prior(space, 9, scramble=scramble), points[:9])
    assert np.linalg.norm(points, axis=1).mean() == pytest.approx(np.sqrt(10), rel=0.1)
    assert np.linalg.norm(space.to_physical(sobol(64, 10, scramble=scramble)), axis=1).mean() > 6
    assert np.abs(points).max() < 3.5


def test_it_is_the_sequence_in_the_literature_and_scipys_own():
    assert sobol(4, 2).tolist() == [[0.0, 0.0], [0.5, 0.5], [0.75, 0.25], [0.25, 0.75]]
    engine = qmc.Sobol(3, scramble=False)
    assert np.array_equal(sobol(100, 3), np.vstack([engine.random(1) for _ in range(100)]))


@pytest.mark.parametrize("scramble", [None, 3])
def test_every_dyadic_stratum_gets_its_share(scramble):
    """256 points: one in each of 256 equal slices of every axis, four in each square of an 8 × 8 grid."""
    points = sobol(256, 2, scramble=scramble)
    assert np.array_equal(np.sort((points * 256).astype(int), axis=0).T, [np.arange(256)] * 2)
    assert (np.histogram2d(*points.T, bins=8, range=[[0, 1], [0, 1]])[0] == 4).all()


def test_scrambling_keeps_to_the_cube_and_empty_designs_are_refused():
    points = sobol(1000, 5, scramble=4)
    assert 0 <= points.min() < points.max() < 1
    for number, dim in [(0, 2), (-1, 2), (3, 0)]:
        with pytest.raises(InvalidInput, match="Sobol"):
            sobol(number, dim)
