"""The claims of the study, on evidence whose verdict, and the figures in its reason, are known by construction."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp
from verification.reproduction import claims
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid
from verification.reproduction.judgement import LikelihoodField

from strandline.design import sobol
from strandline.parameters import LogNormal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.posterior import Posterior, laplace
from strandline.runs import RunRecord

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))))
BETA = ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5)
INFORMED = ParameterSpace((Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)), Parameter("nu", BETA)))
PRIOR_OF_NU = stats.beta(43 / 13, 22 / 13, loc=-0.8, scale=1.3)
TRUTH = (400.0, 0.3)
E, NU = np.linspace(100.0, 800.0, 141), np.linspace(-0.8, 0.5, 131)
"""They contain the truth."""


def settled(claim, verdict, *figures):
    """Return the numbers of a claim as JSON gives them back, its verdict and the figures in its reason checked."""
    content = json.loads(json.dumps(claim.as_json()))
    assert content["verdict"] == claim.verdict == verdict
    assert [figure for figure in figures if figure not in claim.because] == []
    return content["numbers"]


def weighted(log_density, space=SPACE):
    """Return evenly spread draws with the weights of a density, which is the likelihood too."""
    draws = space.to_physical(sobol(8192, space.dim))
    values = np.asarray(log_density(*draws.T))
    return Posterior(space, draws, values - logsumexp(values), values, np.zeros(len(draws)), 0.0)


def by_measure(**functions):
    return {name: LikelihoodField(E, NU, np.asarray(function(E[:, None], NU))) for name, function in functions.items()}


def ridge(*, slope=100.0, bend=-100.0, at=TRUTH, sd=30.0):
    """log L of E normal about a parabola in ν, and of ν normal with sd 0.4; its peak is `at`."""

    def log_likelihood(e, nu):
        t = nu - at[1]
        return -0.5 * ((e - at[0] - slope * t - bend * t**2) / sd) ** 2 - 0.5 * (t / 0.4) ** 2

    return log_likelihood


def normal(e, e_sd, nu, nu_sd):
    return lambda x, y: -0.5 * ((x - e) / e_sd) ** 2 - 0.5 * ((y - nu) / nu_sd) ** 2


def test_c1_a_bent_ridge_with_its_peak_at_the_truth_and_what_lacks_one_of_the_three():
    def claim(function):
        fields = by_measure(currents=function, closest_point=function, measurement_lines=function)
        return claims.ridge_and_peak(fields, TRUTH, weighted(function), (22.0, 0.041))

    numbers = settled(claim(ridge()), "confirmed", "runs over 245 Pa", "at most 0 Pa and 0.000 from the truth")
    assert numbers["ridge_bend_Pa"] == pytest.approx(100 * (1.3 / 2) ** 2, abs=E[1] - E[0])  # off its chord
    for function, figure in (
        (ridge(bend=0.0), "130 Pa"),  # straight
        (ridge(sd=150.0), "explains"),  # so wide that E does not depend on ν
        (ridge(at=(425.0, 0.3)), "at most 25 Pa"),
    ):
        settled(claim(function), "refuted", figure)


def test_c3_failures_of_soft_unlikely_samples_confirm_and_others_refute():
    def claim(*failed, peak=600.0):
        ends = [(e, "failed", kind) for e, kind in failed] + [(400.0, "ok", None), (700.0, "ok", None)]
        records = [RunRecord("key", {"E": e, "nu": -0.2}, state, failure_kind=kind) for e, state, kind in ends]
        fields = by_measure(currents=normal(peak, 50.0, -0.2, 0.2), measurement_lines=normal(peak, 100.0, -0.2, 0.2))
        return claims.failed_where_unlikely(records, fields, ("E", "nu"))

    soft = claim((150.0, "limit_point"), (120.0, "limit_point"), (110.0, "continuation_stalled"))
    settled(soft, "confirmed", "3 of 5 runs", "limit_point: 2", "up to 150 Pa, 7 %", "fold", "4e-05")
    settled(claim((750.0, "mesh"), peak=300.0), "refuted", "up to 750 Pa, 93 %")  # unlikely, but not soft
    settled(claim((200.0, "mesh"), peak=300.0), "refuted", "0.6 of")
    settled(claim(), "differs", "None of 2 runs failed")


def test_c4_a_posterior_is_good_from_200_runs_on_or_is_not():
    good = (0.6, 0.18, 0.08, 0.05, 0.02)

    def claim(centre, best=(390.0, 0.25)):
        off = dict(zip((50, 100, 200, 500, 1000), centre, strict=False))
        variations = {"centre": off, "refined": {n: 0.5 * d for n, d in off.items()}}
        return claims.training_size(variations, {rule: dict.fromkeys(off, best) for rule in variations}, TRUTH)

    numbers = settled(claim(good), "confirmed", "from 200 runs is 0.08", "(390 Pa, 0.25)")
    assert numbers["runs_to_total_variation_0.1"] == {"centre": 200, "refined": 100}
    settled(claim((0.6, 0.4, 0.08, 0.2, 0.05)), "refuted", "0.1 from 1000 runs on")  # 200 were luck
    settled(claim(good, (460.0, 0.3)), "refuted", "(460 Pa, 0.30)")
    settled(claim((0.6, 0.18, 0.3)), "differs", "No design is larger")


def test_c5_one_mode_and_a_plateau():
    refined = weighted(normal(400.0, 60.0, -0.1, 0.1))
    flat = weighted(lambda e, nu: -0.5 * ((e - 400.0) / 60.0) ** 2 + 0.0 * nu)
    claim = claims.uniform_prior(flat, refined)
    numbers = settled(claim, "confirmed", "E has 1 mode.", "plateau here too", "sd is 0.375")  # 1.3 / √12
    assert numbers["plateau_refined"]["nu"] == pytest.approx(2 * np.sqrt(2 * np.log(1.25)), abs=0.15)
    settled(claims.uniform_prior(refined, refined), "differs", "no plateau", "(400 Pa, -0.10)")

    def two_modes(e, nu):
        return np.logaddexp(-0.5 * ((e - 250.0) / 30.0) ** 2, -0.5 * ((e - 600.0) / 30.0) ** 2 - 0.5)

    settled(claims.uniform_prior(weighted(two_modes), refined), "refuted", "E has 2 modes.")


def test_c6_an_axis_across_the_posterior_misleads_and_so_does_too_small_an_ellipse():
    posterior = weighted(normal(450.0, 0.1 * 700.0, -0.15, 0.05 * 1.3))

    def found(e, nu):
        """Return a calibration whose approximation has these variances in the unit square."""
        hessian = np.diag([-1 / (e * 700.0**2), -1 / (nu * 1.3**2)])
        return SimpleNamespace(posterior=posterior, laplace=laplace(hessian, np.array([450.0, -0.15])))

    def claim(e, nu):
        return claims.laplace_misleads({"centre": found(e, nu), "refined": found(0.1**2, 0.05**2)})

    figures = "main axis is 90° off", "it is 0° off and the ellipse holds 90 %"
    settled(claim(0.05**2, 0.1**2), "confirmed", *figures)
    settled(claim(0.1**2, 0.05**2), "refuted", "0° off")
    settled(claim(0.01**2, 0.005**2), "differs", "0° off", "holds 2 % of the posterior")  # 1 - 0.1^0.01
    settled(claim(0.1**2, -(0.1**2)), "differs", "no approximation at all")


def test_c7_the_marginal_is_the_prior_and_the_map_lower_or_not():
    uniform = weighted(normal(400.0, 30.0, 0.3, 0.2))

    def claim(log_density):
        return claims.informed_prior(weighted(log_density, INFORMED), uniform)

    same = claim(lambda e, nu: -0.5 * ((e - 385.0) / 30.0) ** 2 + PRIOR_OF_NU.logpdf(np.maximum(nu, -0.799)))
    numbers = settled(same, "confirmed", "nearly the same", f"(385, {PRIOR_OF_NU.mean():.2f})")
    assert numbers["nu_distance_to_prior"] < 0.03
    settled(claim(normal(385.0, 30.0, 0.2, 0.08)), "differs", "the data inform ν as well")
    for e, nu in ((420.0, 0.2), (385.0, 0.4), (399.7, 0.299)):  # the last moves by less than the noise of draws
        settled(claim(normal(e, 30.0, nu, 0.08)), "refuted", "The MAP moves by")


def test_c8_wider_and_lower_or_not():
    grid = product_grid(SPACE, panels=(48, 16, 1), rate=100.0)

    def of(density):
        return posterior_on_grid(lambda x: density(x[:, 0], x[:, 1]), SPACE, grid)

    def claim(joint):
        nu = {"mean": -0.1, "sd": 0.1, "map": -0.1}
        found = {"inputs": {"E": {"mean": 372.0, "sd": 45.0, "map": 360.0}, "nu": nu}}
        truth = {"joint": of(joint), "cut": of(normal(360.0, 60.0, -0.1, 0.1))}
        return claims.uncertain_inflow({"joint": found, "cut": found}, truth, of(normal(400.0, 20.0, -0.1, 0.1)))

    figures = "2.00 times", "from 400 to 370 Pa", "360 ± 60 Pa", "372 ± 45 Pa", "0.05 sd off."
    settled(claim(normal(370.0, 40.0, -0.1, 0.1)), "confirmed", *figures)
    settled(claim(normal(430.0, 40.0, -0.1, 0.1)), "differs", "2.00 times")
    settled(claim(normal(370.0, 19.6, -0.1, 0.1)), "refuted", "0.98 times")


NAMES = ("E1", "E2", "E3", "nu1", "nu2", "nu3")
INTERVALS = {"E1": (100.0, 800.0), "E2": (100.0, 800.0), "E3": (100.0, 1200.0)} | dict.fromkeys(NAMES[3:], (-0.8, 0.5))
PARTS = ParameterSpace(tuple(Parameter(name, Uniform(*INTERVALS[name])) for name in NAMES))
TRUE_PARTS = {"E1": 500.0, "nu1": 0.2, "E2": 200.0, "nu2": 0.1, "E3": 1000.0, "nu3": 0.3}
GATHERED = {"E2": (200.0, 80.0), "nu2": (0.1, 0.3)}


def heterogeneous(normals, verdict="good"):
    """Judge normal densities with these means and standard deviations; the other inputs are uniform."""

    def log_density(*columns):
        given = [(columns[NAMES.index(name)], *normals[name]) for name in normals]
        return sum(stats.norm.logpdf(column, mean, sd) for column, mean, sd in given)

    check = {"verdict": verdict, "k_hat": 0.3, "particles": {"true": [-2.0, -4.0, -3.0], "surrogate": [-1.0, -2.0]}}
    return claims.heterogeneous(weighted(log_density, PARTS), {"biofilm-parts": check}, TRUE_PARTS)


def test_c9_two_inputs_gather_and_the_others_stay_broad_and_a_bad_check_settles_nothing():
    settled(heterogeneous(GATHERED), "confirmed", "E2 and nu2 gather", "k̂ = 0.30", "at -1.5", "at -3.0")
    for changes, figure in (
        ({"E1": (500.0, 170.0)}, "E2 and nu2 and E1 gather"),
        ({"E3": (150.0, 250.0)}, "E2 and nu2 gather"),  # away from its truth, but not broad
        ({"E2": (600.0, 80.0)}, "nu2 gather"),  # E2 dominates, but away from its truth
        ({"nu2": (0.1, 0.05)}, "nu2 and E2 gather"),  # both gather, and ν2 dominates
    ):
        settled(heterogeneous(GATHERED | changes), "refuted", f". {figure} around the truth")
    settled(heterogeneous(GATHERED, verdict="bad"), "differs", "is not the true one")
