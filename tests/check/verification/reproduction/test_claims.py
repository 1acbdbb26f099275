"""The claims C1 to C10, each on evidence whose verdict, and the figures in its reason, are known by construction."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp
from verification.reproduction import claims, claims_parts
from verification.reproduction.grid_posterior import posterior_on_grid, product_grid
from verification.reproduction.judgement import Claim, LikelihoodField

from strandline.design import sobol
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior, laplace
from strandline.priors import LogNormal, ScaledBeta, Uniform
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
    content = json.loads(json.dumps(claim.as_json(), allow_nan=False))
    assert content["verdict"] == claim.verdict == verdict
    assert claim.because.endswith(".")
    assert [figure for figure in figures if figure not in claim.because] == []
    return content["numbers"]


def weighted_draws(space, draws, values):
    """Return draws with the weights of a log-density, which is the likelihood too."""
    return Posterior(space, draws, values - logsumexp(values), values, np.zeros(len(draws)), 0.0)


def weighted(log_density, space=SPACE):
    """Return evenly spread draws with the weights of a density."""
    draws = space.to_physical(sobol(8192, space.dim))
    return weighted_draws(space, draws, np.asarray(log_density(draws[:, 0], draws[:, 1])))


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
    def claim(function, truth=TRUTH, lines=None):
        fields = by_measure(currents=function, closest_point=function, measurement_lines=lines or function)
        return claims.ridge_and_peak(fields, truth, weighted(function), (22.0, 0.041))

    numbers = settled(claim(ridge()), "confirmed", "runs over 245 Pa", "at most 0 Pa and 0.000 from the truth")
    assert numbers["ridge_bend_Pa"] == pytest.approx(100 * (1.3 / 2) ** 2, abs=E[1] - E[0])  # off its chord
    middle = (250.0, -0.15)  # a ridge that turns back couples though nothing correlates
    numbers = settled(claim(ridge(slope=0.0, bend=600.0, at=middle), middle), "confirmed")
    assert abs(numbers["correlation"]) < 0.1
    for function, figure in (
        (ridge(bend=0.0), "130 Pa"),  # straight
        (ridge(slope=10.0, bend=0.0, sd=3.0), "up to 3 Pa"),  # straight; on the grid a stair
        (ridge(slope=0.0, bend=0.0), "runs over 0 Pa"),  # no ridge
        (ridge(sd=150.0), "explains"),  # so wide that E does not depend on ν
        (ridge(at=(425.0, 0.3)), "at most 25 Pa"),
        (ridge(at=(400.0, 0.35)), "0.050 from the truth"),
    ):
        settled(claim(function), "refuted", figure)
    settled(claim(ridge(), lines=ridge(at=(430.0, 0.3))), "refuted", "at most 30 Pa")


def test_c2_measures_that_are_narrower_are_more_peaked():
    def compared(**scale):
        fields = by_measure(**{n: normal(400.0, 80.0 * s, -0.1, 0.15 * s) for n, s in scale.items()})
        return claims.measures_compared(fields)

    scales = {"currents": 0.5, "measurement_lines": 1.0, "closest_point": 0.7}
    shares = settled(compared(**scales), "confirmed", "(measurement lines)")["share_of_box_above_half"]
    area = 2 * np.log(2) * np.pi * 80.0 * 0.15  # of the ellipse where a normal density is above half
    for name, scale in scales.items():
        assert shares[name] == pytest.approx(scale**2 * area / (700.0 * 1.3), rel=0.06)
    for wide in ("currents", "closest_point"):
        settled(compared(**scales | {wide: 1.1}), "refuted")


def test_c3_failures_of_soft_unlikely_samples_confirm_and_others_refute():
    def claim(*failed, peak=600.0):
        ends = [(e, "failed", kind) for e, kind in failed] + [(400.0, "ok", None), (700.0, "ok", None)]
        records = [RunRecord("key", {"E": e, "nu": -0.2}, state, failure_kind=kind) for e, state, kind in ends]
        fields = by_measure(currents=normal(peak, 50.0, -0.2, 0.2), measurement_lines=normal(peak, 100.0, -0.2, 0.2))
        return claims.failed_where_unlikely(records, fields, ("E", "nu"))

    soft = claim((150.0, "limit_point"), (120.0, "limit_point"), (110.0, "continuation_stalled"))
    numbers = settled(soft, "confirmed", "3 of 5 runs", "limit_point: 2", "up to 150 Pa, 7 %", "fold", "4e-05")
    assert numbers["likelihood_there"]["measurement_lines"] == pytest.approx(np.exp(-0.5 * 4.5**2))
    other = claim((150.0, "limit_point"), (120.0, "newton_stalled"))
    settled(other, "confirmed", "newton_stalled: 1")
    assert "fold" not in other.because
    settled(claim((750.0, "mesh"), peak=300.0), "refuted", "up to 750 Pa, 93 %")
    settled(claim((200.0, "mesh"), peak=300.0), "refuted", "0.6 of")
    assert settled(claim(), "differs", "None of 2 runs failed") == {"failed": 0, "runs": 2}


def test_c4_a_posterior_is_good_from_200_runs_on_or_is_not():
    good = (0.6, 0.18, 0.08, 0.05, 0.02)

    def claim(centre, best=(390.0, 0.25)):
        off = dict(zip((50, 100, 200, 500, 1000), centre, strict=False))
        variations = {"centre": off, "refined": {n: 0.5 * d for n, d in off.items()}}
        return claims.training_size(variations, {rule: dict.fromkeys(off, best) for rule in variations}, TRUTH)

    figures = "from 200 runs is 0.08", "0.1 from 200 runs on", "(390 Pa, 0.25)"
    numbers = settled(claim(good), "confirmed", *figures)
    assert numbers["runs_to_total_variation_0.1"] == {"centre": 200, "refined": 100}
    for centre, good_from in (
        ((0.6, 0.4, 0.3, 0.05, 0.02), 500),
        ((0.6, 0.4, 0.3, 0.3, 0.3), "more than 1000"),  # little gain, but no shape
        ((0.6, 0.4, 0.08, 0.2, 0.05), 1000),  # 200 were luck
    ):
        settled(claim(centre), "refuted", f"0.1 from {good_from} runs on")
    settled(claim(good, (460.0, 0.3)), "refuted", "(460 Pa, 0.30)", "the truth is (400 Pa, 0.30)")
    settled(claim(good, (400.0, 0.15)), "refuted", "(400 Pa, 0.15)")
    for centre in ((0.01,), (0.6, 0.02), (0.6, 0.18, 0.3)):
        settled(claim(centre), "differs", "No design is larger")


def test_c5_one_mode_and_a_plateau():
    refined = weighted(normal(400.0, 60.0, -0.1, 0.1))

    def claim(log_density):
        return claims.uniform_prior(weighted(log_density), refined)

    flat = claim(lambda e, nu: -0.5 * ((e - 400.0) / 60.0) ** 2 + 0.0 * nu)
    numbers = settled(flat, "confirmed", "E has 1 mode.", "plateau here too", "sd is 0.375")  # 1.3 / √12
    assert 2.9 < numbers["plateau"]["nu"] < np.sqrt(12) + 0.02
    assert numbers["plateau_refined"]["nu"] == pytest.approx(2 * np.sqrt(2 * np.log(1.25)), abs=0.15)

    def triangle(e, nu):
        return -0.5 * ((e - 400.0) / 60.0) ** 2 + np.log(np.maximum(1 - np.abs(nu + 0.15) / 0.65, 1e-9))

    numbers = settled(claim(triangle), "differs", "no plateau", "(400 Pa, -0.15)")
    assert 0.2 * np.sqrt(24) < numbers["plateau"]["nu"] < 1.45  # kernels round off its tip

    def two_modes(e, nu):
        return np.logaddexp(-0.5 * ((e - 250.0) / 30.0) ** 2, -0.5 * ((e - 600.0) / 30.0) ** 2 - 0.5)

    numbers = settled(claim(two_modes), "refuted", "E has 2 modes.")
    assert numbers["modes_of_E"] == pytest.approx([250.0, 600.0], abs=12.0)  # the highest first


def hessian(angle_deg):
    """Return that of a normal density with that main axis in the unit square, stretched to the study's box."""
    a, width = np.radians(angle_deg), np.array([700.0, 1.3])
    axes = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return np.asarray(-np.linalg.inv(axes @ np.diag([0.1**2, 0.05**2]) @ axes.T * np.outer(width, width)))


def test_c6_an_axis_across_the_posterior_misleads_and_so_does_too_small_an_ellipse():
    """Of a normal posterior along the diagonal of the box."""
    middle, along = np.array([450.0, -0.15]), hessian(45.0)

    def log_density(e, nu):
        offset = np.stack([e, nu], axis=-1) - middle
        return 0.5 * np.einsum("...i,ij,...j", offset, along, offset)

    posterior = weighted(log_density)

    def claim(centre, refined=along):
        given = {"centre": centre, "refined": refined}.items()
        found = {k: SimpleNamespace(posterior=posterior, laplace=laplace(one, middle)) for k, one in given}
        return claims.laplace_misleads(found)

    edge = np.sqrt(stats.chi2.ppf(0.9, 2))  # the mass of z ~ N(0, diag(2², 0.5²)) in the ellipse of N(0, 1)
    z = np.linspace(-edge, edge, 20001)
    inner = 2 * stats.norm.cdf(np.sqrt(edge**2 - z**2) / 0.5) - 1
    held = np.sum(stats.norm.pdf(z, scale=2.0) * inner) * (z[1] - z[0])
    figures = "main axis is 90° off", "it is 0° off and the ellipse holds 90 %"
    numbers = settled(claim(hessian(-45.0)), "confirmed", *figures)
    assert numbers["centre"]["mass_in_its_90_%_ellipse"] == pytest.approx(held, abs=0.01)
    settled(claim(hessian(30.0)), "refuted", "15° off")
    settled(claim(100 * hessian(45.0)), "differs", "0° off", "holds 2 % of the posterior")  # 1 - 0.1^0.01
    indefinite = np.diag([-1e-3, 4.0])
    settled(claim(indefinite), "differs", "no approximation at all")
    settled(claim(hessian(-45.0), indefinite), "confirmed", "refined quadrature the Hessian is ind")


def test_c7_the_marginal_is_the_prior_and_the_map_lower_or_not():
    uniform = weighted(normal(400.0, 30.0, 0.3, 0.2))

    def claim(log_density):
        return claims.informed_prior(weighted(log_density, INFORMED), uniform)

    same = claim(lambda e, nu: -0.5 * ((e - 385.0) / 30.0) ** 2 + PRIOR_OF_NU.logpdf(np.maximum(nu, -0.799)))
    numbers = settled(same, "confirmed", "nearly the same", f"(385, {PRIOR_OF_NU.mean():.2f})")
    assert numbers["nu_distance_to_prior"] < 0.03
    assert numbers["map"] == {"E": pytest.approx(385.0, abs=6.0), "nu": pytest.approx(0.2, abs=0.03)}
    assert numbers["map_moved_by_sd"]["E"] == pytest.approx(-0.5, abs=0.3)
    edges = np.linspace(-0.8, 0.5, 31)
    distance = 0.5 * np.abs(np.diff(stats.norm.cdf(edges, 0.2, 0.08)) - np.diff(PRIOR_OF_NU.cdf(edges))).sum()
    numbers = settled(claim(normal(385.0, 30.0, 0.2, 0.08)), "differs", "the data inform ν as well")
    assert numbers["nu_distance_to_prior"] == pytest.approx(distance, abs=0.01)
    for e, nu in ((420.0, 0.2), (385.0, 0.4), (399.7, 0.299)):  # the last moves by less than the noise of draws
        settled(claim(normal(e, 30.0, nu, 0.08)), "refuted", "The MAP moves by")


def test_c8_wider_and_lower_or_not():
    grid = product_grid(SPACE, panels=(48, 16, 1), rate=100.0)

    def of(density):
        return posterior_on_grid(lambda x: density(x[:, 0], x[:, 1]), SPACE, grid)

    def claim(joint, found=372.0):
        nu = {"mean": -0.1, "sd": 0.1, "map": -0.1}
        readings = {
            "joint": {"inputs": {"E": {"mean": found, "sd": 45.0, "map": 360.0}, "nu": nu}},
            "cut": {"inputs": {"E": {"mean": 350.0, "sd": 70.0, "map": 340.0}, "nu": nu}},
        }
        truth = {"joint": of(joint), "cut": of(normal(360.0, 60.0, -0.1, 0.1))}
        certain, known = weighted(normal(400.0, 30.0, -0.1, 0.1)), of(normal(400.0, 20.0, -0.1, 0.1))
        return claims.uncertain_inflow(readings, certain, truth, known)

    lower = normal(370.0, 40.0, -0.1, 0.1)
    figures = "2.00 times", "from 400 to 370 Pa", "360 ± 60 Pa", "372 ± 45 Pa", "0.05 sd off."
    numbers = settled(claim(lower), "confirmed", *figures)
    assert numbers["surrogate_sd_ratio_E"] == pytest.approx(1.5, rel=0.02)
    settled(claim(lower, found=390.0), "confirmed", "0.50 sd off, as")
    settled(claim(normal(430.0, 40.0, -0.1, 0.1)), "differs", "2.00 times")
    peak, tail = normal(420.0, 20.0, -0.1, 0.1), normal(280.0, 60.0, -0.1, 0.1)
    lower_mean_not_mode = claim(lambda e, nu: np.logaddexp(peak(e, nu), tail(e, nu) - 0.7))
    settled(lower_mean_not_mode, "differs", "mean goes from 400 to 336 Pa")
    settled(claim(normal(370.0, 19.6, -0.1, 0.1)), "refuted", "0.98 times")


NAMES = ("E1", "E2", "E3", "nu1", "nu2", "nu3")
INTERVALS = {"E1": (100.0, 800.0), "E2": (100.0, 800.0), "E3": (100.0, 1200.0)} | dict.fromkeys(NAMES[3:], (-0.8, 0.5))
INFLOW = Parameter("V_in", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm^2/s", nuisance=True)
PARTS = ParameterSpace((*(Parameter(name, Uniform(*INTERVALS[name])) for name in NAMES), INFLOW))
TRUE_PARTS = {"E1": 500.0, "nu1": 0.2, "E2": 200.0, "nu2": 0.1, "E3": 1000.0, "nu3": 0.3, "V_in": 100.0}


def triangle(name, apex):
    """Return a density with that apex over the whole interval: 0.25 of total variation off uniform wherever it is."""
    low, high = INTERVALS[name]
    return lambda x: np.asarray(stats.triang.pdf(x, (apex - low) / (high - low), loc=low, scale=high - low))


def slope(name):
    """Return the density (0.5 + u) in the unit interval: 0.125 of total variation off uniform."""
    low, high = INTERVALS[name]
    return lambda x: (0.5 + (x - low) / (high - low)) / (high - low)


def narrow(mean, sd):
    return lambda x: np.asarray(stats.norm.pdf(x, mean, sd))


GATHERED = {"E2": narrow(200.0, 80.0), "nu2": triangle("nu2", 0.1), "nu1": slope("nu1")}


def heterogeneous(densities, *, verdict="good", k_hat=0.3, true=(-2.0, -4.0, -3.0)):
    """Judge weighted draws of the product of marginals; those that are not given are uniform."""
    draws = PARTS.to_physical(sobol(16384, PARTS.dim))
    product = np.prod([densities[name](draws[:, PARTS.names.index(name)]) for name in densities], axis=0)
    with np.errstate(divide="ignore"):
        posterior = weighted_draws(PARTS, draws, np.log(np.asarray(product) * np.ones(len(draws))))
    particles = {"true": list(true), "surrogate": [-1.0, -2.0, -1.5]}
    checks = {"biofilm-parts": {"verdict": verdict, "k_hat": k_hat, "particles": particles}}
    checks["biofilm-parts-refined"] = {"verdict": "good", "k_hat": 0.55, "particles": particles}
    return claims_parts.heterogeneous(posterior, checks, TRUE_PARTS)


def test_c9_two_inputs_gather_and_the_others_stay_broad():
    figures = "E2 and nu2 gather", "k̂ = 0.30", "Biofilm-parts-refined: k̂ = 0.55."
    numbers = settled(heterogeneous(GATHERED), "confirmed", *figures)
    edges = np.linspace(100.0, 800.0, 31)
    cut_off = stats.truncnorm((100 - 200) / 80, (800 - 200) / 80, 200, 80)
    expected = {"E2": 0.5 * np.abs(np.diff(cut_off.cdf(edges)) - 1 / 30).sum(), "nu2": 0.25, "nu1": 0.125}
    for name in NAMES:
        assert numbers["distance_to_prior"][name] == pytest.approx(expected.get(name, 0.0), abs=0.02)
    assert numbers["density_at_truth_over_prior"]["E2"] == pytest.approx(700 * cut_off.pdf(200.0), rel=0.1)
    assert numbers["median_log_likelihood"] == {"surrogate": -1.5, "true": -3.0}
    one_bin = {name: narrow(TRUE_PARTS[name] + 0.02, 0.03 * np.ptp(INTERVALS[name])) for name in ("E1", "E2", "nu2")}
    numbers = settled(heterogeneous(one_bin), "refuted")
    assert numbers["map"]["E2"] == pytest.approx(205.0), "the middle of the fullest bin, [170, 240]"


def test_c9_anything_else_refutes_and_a_bad_check_settles_nothing():
    for changes, figure in (
        ({"E1": triangle("E1", 500.0)}, "E2 and nu2 and E1 gather"),
        ({"E3": triangle("E3", 150.0)}, "E2 and nu2 gather"),  # away from its truth, but not broad
        ({"E2": narrow(600.0, 80.0)}, "nu2 gather"),  # E2 dominates, but away from its truth
        ({"nu2": slope("nu2")}, "E2 gather"),
        ({"nu2": narrow(0.1, 0.05)}, "nu2 and E2 gather"),  # both gather, and ν2 dominates
    ):
        settled(heterogeneous(GATHERED | changes), "refuted", f". {figure} around the truth")
    settled(heterogeneous({"E2": slope("E2")}), "refuted", "None gather", "the order is E2 0.1")
    for densities in (GATHERED, {}):  # k̂ is below 0.7, above the threshold of 200 draws
        claim = heterogeneous(densities, verdict="bad", k_hat=0.6)
        settled(claim, "differs", "k̂ = 0.60", "is not the true one")
        assert "can be used" not in claim.because
    settled(heterogeneous(GATHERED, k_hat=0.9), "confirmed", "k̂ = 0.90", "can be used")
    all_failed = heterogeneous(GATHERED, verdict="bad", k_hat=np.inf, true=(-np.inf, -np.inf, -3.0))
    numbers = settled(all_failed, "differs", "k̂ = inf")
    assert numbers["k_hat"] == {"biofilm-parts": None, "biofilm-parts-refined": 0.55}
    assert numbers["median_log_likelihood"]["true"] is None


def test_c10_an_error_that_stays_or_rises_confirms_and_one_that_falls_refutes():
    sizes = (100, 200, 500, 1000, 2000, 5000)
    errors = {"log L": [0.9, 0.8, 0.85, 0.50, 0.48, 0.46], "L": [9.0, 8.0, 7.0, 4.0, 3.0, 1.0]}
    figure = "0.500 at 1000 runs to 0.460 at 5000, by -8 %; L: -75 %."
    numbers = settled(claims_parts.more_runs(sizes, errors), "confirmed", figure)
    assert numbers["fall"] == pytest.approx({"log L": 0.08, "L": 0.75})
    for last, verdict, said in ((0.6, "confirmed", "by +20 %"), (0.3, "refuted", "by -40 %")):
        settled(claims_parts.more_runs(sizes, {"log L": [0.9, 0.8, 0.85, 0.5, 0.4, last]}), verdict, said)
    for few in ((1000,), (24, 48), (200, 900)):
        claim = claims_parts.more_runs(few, {"log L": [0.5] * len(few)})
        settled(claim, "differs", f"at {few[-1]}, by", "No training set is larger")
    nothing = claims_parts.more_runs((1000, 5000), {"log L": [0.0, 0.0], "L": [np.inf, np.inf]})
    assert settled(nothing, "confirmed")["fall"] == {"log L": 0.0, "L": None}


def test_a_number_that_json_does_not_know_becomes_null():
    claim = Claim("C0", "", (1,), "differs", ".", {"k": np.inf, "of": [1.0, {"x": -np.inf, "y": (np.nan, 2)}]})
    assert settled(claim, "differs") == {"k": None, "of": [1.0, {"x": None, "y": [None, 2]}]}
