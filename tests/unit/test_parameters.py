"""Parameters and their space: maps between cube and box, joint prior, refusals."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, Normal, ScaledBeta, Uniform

E = Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0))
NU = Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5))
SPACE = ParameterSpace((E, NU))


def test_box_defaults_to_the_support_of_the_prior():
    assert NU.interval == (-0.8, 0.5)
    assert NU.truncated_prior is NU.prior
    assert NU.mass_cut == 0.0


def test_prior_is_truncated_to_the_box_and_the_mass_cut_is_told():
    base = stats.lognorm(s=0.4, scale=math.exp(5.86))
    cut = base.cdf(100) + base.sf(800)
    assert E.mass_cut == pytest.approx(cut)
    assert float(E.truncated_prior.log_density(400.0)) == pytest.approx(base.logpdf(400) - math.log1p(-cut))
    assert float(E.truncated_prior.log_density(801.0)) == -math.inf


def test_labels():
    assert E.label() == "E [Pa]"
    assert NU.label() == "nu"


def test_order_and_access_by_name():
    assert SPACE.names == ("E", "nu")
    assert SPACE.dim == 2
    assert list(SPACE) == [E, NU]
    assert SPACE["nu"] is NU
    assert SPACE.low.tolist() == [100.0, -0.8]
    assert SPACE.high.tolist() == [800.0, 0.5]
    assert SPACE.as_mapping(np.array([400.0, 0.3])) == {"E": 400.0, "nu": 0.3}


def test_corners_of_the_cube_are_corners_of_the_box():
    corners = SPACE.to_physical(np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5]]))
    assert corners == pytest.approx(np.array([[100.0, -0.8], [800.0, 0.5], [450.0, -0.15]]))
    assert SPACE.to_unit(corners) == pytest.approx(np.array([[0.0, 0.0], [1.0, 1.0], [0.5, 0.5]]))
    assert SPACE.to_physical(np.array([1.0, 0.0])) == pytest.approx([800.0, -0.8])


def test_joint_prior_is_the_sum_of_independent_ones_on_numpy_and_jax():
    x = SPACE.to_physical(np.random.default_rng(0).random((3, 4, 2)))
    exact = sum(np.asarray(p.truncated_prior.log_density(x[..., i])) for i, p in enumerate(SPACE))
    assert SPACE.log_prior(x) == pytest.approx(exact)
    assert np.asarray(jax.jit(SPACE.log_prior)(jnp.asarray(x))) == pytest.approx(exact, rel=1e-12)


def test_joint_prior_integrates_to_one_over_the_box():
    nodes, weights = np.polynomial.legendre.leggauss(60)
    u = 0.5 * (nodes + 1)
    grid = SPACE.to_physical(np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1))
    volume = np.prod(SPACE.high - SPACE.low)
    total = 0.25 * volume * weights @ np.exp(SPACE.log_prior(grid)) @ weights
    assert total == pytest.approx(1.0, rel=1e-4)


def test_each_input_has_numbers_of_its_own():
    p = np.array([[0.1, 0.9], [0.5, 0.2], [0.8, 0.6]])
    draws = SPACE.prior_quantiles(p)
    for i, parameter in enumerate(SPACE):
        assert np.asarray(parameter.truncated_prior.cdf(draws[:, i])) == pytest.approx(p[:, i])


def ks_p_values(draws) -> list[float]:
    """Return Kolmogorov–Smirnov p-values of draws against references built with scipy alone."""
    base = stats.lognorm(s=0.4, scale=math.exp(5.86))
    low, high = base.cdf([100.0, 800.0])
    beta = stats.beta(43 / 13, 22 / 13, loc=-0.8, scale=1.3)
    return [
        stats.kstest(draws[:, 0], lambda x: (base.cdf(x) - low) / (high - low)).pvalue,
        stats.kstest(draws[:, 1], beta.cdf).pvalue,
    ]


def test_draws_follow_the_priors():
    draws = SPACE.prior_quantiles(np.random.default_rng(12).random((20000, 2)))
    assert min(ks_p_values(draws)) > 1e-3
    assert draws.min(axis=0)[0] >= 100.0
    assert draws.max(axis=0)[0] <= 800.0


@pytest.mark.parametrize(
    "planted",
    [
        ParameterSpace((E, Parameter("nu", ScaledBeta(22 / 13, 43 / 13, -0.8, 0.5)))),
        ParameterSpace((Parameter("E", LogNormal(5.86, 0.4**2), "Pa", (100.0, 800.0)), NU)),
        ParameterSpace((Parameter("E", LogNormal(5.86, 0.42), "Pa", (100.0, 800.0)), NU)),
        ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), NU)),
    ],
    ids=["beta's exponents swapped", "variance for deviation", "deviation 5 % too large", "uniform"],
)
def test_the_test_of_draws_catches_planted_bugs(planted):
    draws = planted.prior_quantiles(np.random.default_rng(12).random((20000, 2)))
    assert min(ks_p_values(draws)) < 1e-3


def test_calibrated_and_nuisance_inputs_keep_their_columns():
    flow = Parameter("V", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm²/s", nuisance=True)
    inputs = (Parameter("E", Uniform(100.0, 800.0), "Pa"), flow, Parameter("nu", Uniform(-0.8, 0.5)))
    space = ParameterSpace(inputs)
    assert (space.calibrated, space.nuisance) == ((0, 2), (1,))
    assert space.calibrated_space == ParameterSpace((inputs[0], inputs[2]))
    assert space.calibrated_space.nuisance == ()


def nuisances(names: str) -> ParameterSpace:
    return ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0), nuisance=True) for name in names))


WRONG_BOXES = [(2.0, 1.0), (1.0, 1.0), (0.0, math.inf)]
UNSHOWN = ["weight", "draw", "chain", "particle", "a/b", "", "a\nb", "a$", "nuisance_values"]
REFUSED = [
    *((r"design box of x.*Give x a box", Parameter, "x", prior) for prior in (Normal(0.0, 1.0), LogNormal(0.0, 1.0))),
    *(("design box", Parameter, "x", Uniform(0.0, 3.0), "", box) for box in WRONG_BOXES),
    ("no mass", Parameter, "x", Uniform(0.0, 1.0), "", (2.0, 3.0)),
    *(("names of the inputs", ParameterSpace, given) for given in ((), (E, E))),
    ("got mu; expected one of E, nu", SPACE.__getitem__, "mu"),
    *((r"inputs to calibrate: got none: a.* nuisance; expected at least one", nuisances, one) for one in ("a", "ab")),
    *(("name of an input", Parameter, name, Uniform(0.0, 1.0)) for name in UNSHOWN),
    *(("unit of E", Parameter, "E", Uniform(0.0, 1.0), unit) for unit in ("$\\frac{$", "m\ns", "\x1b[1m")),
    ("bounds that differ", Parameter, "E", Normal(400.0, 50.0), "Pa", (400.0, 400.00000000000006)),
    *(
        (r"bounds that differ|in magnitude", Parameter, "E", Normal(400.0, 50.0), "Pa", box)
        for box in ((-1e308, 1e308), (0.0, 1e-200))
    ),
]


def test_what_is_no_parameter_or_space_is_refused():
    for words, make, *given in REFUSED:
        with pytest.raises(InvalidInput, match=words):
            make(*given)
