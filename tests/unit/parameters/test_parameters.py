"""Parameters and their space: maps between cube and box, joint prior, refusals."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from strandline.foundations import InvalidInput
from strandline.parameters import LogNormal, Normal, Parameter, ParameterSpace, ScaledBeta, Uniform

E = Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0))
NU = Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5))
SPACE = ParameterSpace((E, NU))
BASE, BETA = stats.lognorm(s=0.4, scale=math.exp(5.86)), stats.beta(43 / 13, 22 / 13, loc=-0.8, scale=1.3)
CUT = BASE.cdf(100) + BASE.sf(800)


def test_the_box_defaults_to_the_support_of_the_prior_which_is_truncated_to_it():
    assert NU.interval == (-0.8, 0.5)
    assert NU.truncated_prior is NU.prior
    assert (NU.mass_cut, E.mass_cut) == (0.0, pytest.approx(CUT))
    assert float(E.truncated_prior.log_density(801.0)) == -math.inf


def test_order_and_access_by_name():
    assert (SPACE.names, SPACE.dim, list(SPACE)) == (("E", "nu"), 2, [E, NU])
    assert SPACE["nu"] is NU
    assert (SPACE.low.tolist(), SPACE.high.tolist()) == ([100.0, -0.8], [800.0, 0.5])
    assert SPACE.as_mapping(np.array([400.0, 0.3])) == {"E": 400.0, "nu": 0.3}


def test_corners_of_the_cube_are_corners_of_the_box():
    cube = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5]])
    box = SPACE.to_physical(cube)
    assert box == pytest.approx(np.array([[100.0, -0.8], [800.0, 0.5], [450.0, -0.15]]))
    assert SPACE.to_unit(box) == pytest.approx(cube)
    assert SPACE.to_physical(np.array([1.0, 0.0])) == pytest.approx([800.0, -0.8])


@settings(max_examples=40, deadline=None)
@given(low=st.floats(-100.0, 100.0), width=st.floats(0.01, 100.0), u=st.tuples(*[st.floats(0.0, 1.0)] * 2))
def test_unit_cube_round_trip(low, width, u):
    space = ParameterSpace((Parameter("a", Uniform(low, low + width)), Parameter("b", Uniform(0.0, 1.0))))
    x = space.to_physical(np.array(u))
    assert space.to_unit(x) == pytest.approx(np.array(u), abs=1e-9)
    assert math.isfinite(float(space.log_prior(np.clip(x, space.low, space.high))))


def test_the_joint_prior_is_the_sum_of_independent_truncated_ones_on_numpy_and_jax():
    x = SPACE.to_physical(np.random.default_rng(0).random((3, 4, 2)))
    exact = BASE.logpdf(x[..., 0]) - math.log1p(-CUT) + BETA.logpdf(x[..., 1])
    assert SPACE.log_prior(x) == pytest.approx(exact)
    assert np.asarray(jax.jit(SPACE.log_prior)(jnp.asarray(x))) == pytest.approx(exact, rel=1e-12)


PLANTED = {
    "beta's exponents swapped": ParameterSpace((E, Parameter("nu", ScaledBeta(22 / 13, 43 / 13, -0.8, 0.5)))),
    "variance for deviation": ParameterSpace((Parameter("E", LogNormal(5.86, 0.4**2), "Pa", (100.0, 800.0)), NU)),
    "deviation too large": ParameterSpace((Parameter("E", LogNormal(5.86, 0.42), "Pa", (100.0, 800.0)), NU)),
    "uniform": ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), NU)),
}


def test_each_input_has_numbers_of_its_own_whose_draws_follow_its_prior():
    p = np.random.default_rng(12).random((50, 2))

    def probabilities(space: ParameterSpace) -> np.ndarray:
        """Return those of the draws, by scipy."""
        draws = space.prior_quantiles(p)
        return np.stack([(BASE.cdf(draws[:, 0]) - BASE.cdf(100)) / (1 - CUT), BETA.cdf(draws[:, 1])], axis=1)

    assert probabilities(SPACE) == pytest.approx(p, abs=1e-10)
    for name, planted in PLANTED.items():
        assert np.abs(probabilities(planted) - p).max() > 1e-3, name


def test_calibrated_and_nuisance_inputs_keep_their_columns():
    flow = Parameter("V", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm²/s", nuisance=True)
    space = ParameterSpace((E, flow, NU))
    assert (space.calibrated, space.nuisance) == ((0, 2), (1,))
    assert space.calibrated_space == SPACE
    assert SPACE.nuisance == ()


def nuisances(names: str) -> ParameterSpace:
    return ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0), nuisance=True) for name in names))


REFUSED = [
    *((r"design box of x.*Give x a box", Parameter, "x", prior) for prior in (Normal(0.0, 1.0), LogNormal(0.0, 1.0))),
    (r"design box of x.*the lower one first\. Exchange", Parameter, "x", Uniform(0.0, 3.0), "", (2.0, 1.0)),
    *((r"box of x.*Correct", Parameter, "x", Uniform(0.0, 3.0), "", box) for box in ((1.0, 1.0), (0.0, math.inf))),
    (r"prior of x: got 5; expected a distribution", Parameter, "x", 5),
    ("no mass", Parameter, "x", Uniform(0.0, 1.0), "", (2.0, 3.0)),
    *(("names of the inputs", ParameterSpace, inputs) for inputs in ((), (E, E))),
    ("got mu; expected one of E, nu", SPACE.__getitem__, "mu"),
    (r"inputs to calibrate: got none: a.* nuisance; expected at least one", nuisances, "ab"),
    *(("name of an input", Parameter, name, Uniform(0.0, 1.0)) for name in ("draw", "a/b", "nuisance_values")),
    ("unit of E", Parameter, "E", Uniform(0.0, 1.0), "m\ns"),
    *(
        (r"bounds that differ|in magnitude", Parameter, "E", Normal(400.0, 50.0), "Pa", box)
        for box in ((400.0, 400.00000000000006), (-1e308, 1e308), (0.0, 1e-200))
    ),
]


@pytest.mark.stand_in
def test_what_is_no_parameter_or_space_is_refused():
    for words, make, *wrong in REFUSED:
        with pytest.raises(InvalidInput, match=words):
            make(*wrong)
