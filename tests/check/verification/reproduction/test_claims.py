"""The claims on two inputs, C1 to C8, each on evidence whose verdict is known by construction."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.check.verification.reproduction.judged import settled, weighted_draws
from verification.reproduction import claims
from verification.reproduction.grid_posterior import GridPosterior, posterior_on_grid, product_grid
from verification.reproduction.judge import GRID, likelihood_fields
from verification.reproduction.judgement import Claim, LikelihoodField, density_over_prior

from strandline.calibration import Calibration, Problem
from strandline.design import sobol
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior, laplace
from strandline.priors import LogNormal, ScaledBeta, Uniform
from strandline.runs import RunRecord
from strandline.surrogate import fit_log_likelihood
from strandline.testing.folding import Folding

SPACE = ParameterSpace((Parameter("E", Uniform(100.0, 800.0), "Pa"), Parameter("nu", Uniform(-0.8, 0.5))))
INFORMED = ParameterSpace(
    (
        Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
        Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5)),
    )
)
PRIOR_OF_NU = stats.beta(43 / 13, 22 / 13, loc=-0.8, scale=1.3)
TRUTH = (400.0, 0.3)
E, NU = np.linspace(100.0, 800.0, 141), np.linspace(-0.8, 0.5, 131)
"""They contain the truth."""
Function = Callable[[Any, Any], Any]


def weighted(log_density: Function, space: ParameterSpace = SPACE, number: int = 8192) -> Posterior:
    """Return evenly spread draws with the weights of a density."""
    draws = space.to_physical(sobol(number, space.dim))
    return weighted_draws(space, draws, np.asarray(log_density(draws[:, 0], draws[:, 1])))


def by_measure(**functions: Function) -> dict[str, LikelihoodField]:
    grid = E[:, None], NU
    return {name: LikelihoodField(E, NU, np.asarray(function(*grid))) for name, function in functions.items()}


def ridge(*, slope: float = 100.0, bend: float = -100.0, at: tuple[float, float] = TRUTH, sd: float = 30.0) -> Function:
    """log L of E normal about a parabola in ν, and of ν normal with sd 0.4; its peak is `at`."""

    def log_likelihood(e: Any, nu: Any) -> Any:
        t = nu - at[1]
        return -0.5 * ((e - at[0] - slope * t - bend * t**2) / sd) ** 2 - 0.5 * (t / 0.4) ** 2

    return log_likelihood


def normal(e: float, e_sd: float, nu: float, nu_sd: float) -> Function:
    return lambda x, y: -0.5 * ((x - e) / e_sd) ** 2 - 0.5 * ((y - nu) / nu_sd) ** 2


class TestRidgeAndPeak:
    def claim(self, function: Function, truth: tuple[float, float] = TRUTH, lines: Function | None = None) -> Claim:
        fields = by_measure(currents=function, closest_point=function, measurement_lines=lines or function)
        return claims.ridge_and_peak(fields, truth, weighted(function), (22.0, 0.041))

    def test_a_bent_ridge_with_its_peak_at_the_truth(self) -> None:
        numbers = settled(self.claim(ridge()), "confirmed", "runs over 245 Pa", "at most 0 Pa and 0.000 from the truth")
        assert numbers["peak"] == {n: pytest.approx(TRUTH) for n in ("currents", "closest_point", "measurement_lines")}
        step = E[1] - E[0]
        assert numbers["ridge_extent_Pa"] == pytest.approx(416.0 - 169.0, abs=step)
        assert numbers["ridge_bend_Pa"] == pytest.approx(100 * (1.3 / 2) ** 2, abs=step)  # of a parabola off its chord
        nu = np.linspace(-0.8, 0.5, 2001)
        weight = np.exp(-0.5 * ((nu - 0.3) / 0.4) ** 2)
        along = np.cov(np.stack([100 * (nu - 0.3) - 100 * (nu - 0.3) ** 2, nu]), aweights=weight, ddof=0)
        explained = along[0, 0] / (along[0, 0] + 30.0**2)
        assert numbers["correlation_ratio"] ** 2 == pytest.approx(explained, abs=0.02)
        correlation = along[0, 1] / np.sqrt((along[0, 0] + 30.0**2) * along[1, 1])
        assert numbers["correlation"] == pytest.approx(correlation, abs=0.02)

    def test_a_ridge_that_turns_back_couples_though_nothing_correlates(self) -> None:
        middle = (250.0, -0.15)
        numbers = settled(self.claim(ridge(slope=0.0, bend=600.0, at=middle), middle), "confirmed")
        assert abs(numbers["correlation"]) < 0.1
        assert numbers["correlation_ratio"] > 0.8

    def test_what_lacks_one_of_the_three_is_no_such_ridge(self) -> None:
        for function, figure in (
            (ridge(bend=0.0), "130 Pa"),  # straight
            (ridge(slope=10.0, bend=0.0, sd=3.0), "up to 3 Pa"),  # straight; on the grid a stair
            (ridge(slope=0.0, bend=0.0), "runs over 0 Pa"),  # no ridge
            (ridge(sd=150.0), "explains"),  # so wide that E does not depend on ν
            (ridge(at=(425.0, 0.3)), "at most 25 Pa"),
            (ridge(at=(375.0, 0.3)), "at most 25 Pa"),
            (ridge(at=(400.0, 0.35)), "0.050 from the truth"),
        ):
            settled(self.claim(function), "refuted", figure)
        one_off = self.claim(ridge(), lines=ridge(at=(430.0, 0.3)))
        assert settled(one_off, "refuted", "at most 30 Pa")["peak"]["measurement_lines"] == [430.0, pytest.approx(0.3)]


def test_measures_that_are_narrower_are_more_peaked() -> None:
    def fields(**scale: float) -> dict[str, LikelihoodField]:
        return by_measure(**{n: normal(400.0, 80.0 * s, -0.1, 0.15 * s) for n, s in scale.items()})

    scales = {"currents": 0.5, "measurement_lines": 1.0, "closest_point": 0.7}
    claim = claims.measures_compared(fields(**scales))
    shares = settled(claim, "confirmed")["share_of_box_above_half"]
    area = 2 * np.log(2) * np.pi * 80.0 * 0.15  # of the ellipse where a normal density is above half
    for name, scale in scales.items():
        assert shares[name] == pytest.approx(scale**2 * area / (700.0 * 1.3), rel=0.06)
        assert f"{100 * shares[name]:.2g} % of the box ({name.replace('_', ' ')})" in claim.because
    for wide in ("currents", "closest_point"):
        settled(claims.measures_compared(fields(**scales | {wide: 1.1})), "refuted")


class TestFailedWhereUnlikely:
    def claim(self, *failed: tuple[float, str], peak: float = 600.0) -> Claim:
        ends = [*failed, (400.0, None), (700.0, None)]
        records = [
            RunRecord("key", {"E": e, "nu": -0.2, "V_in": 100.0}, "failed" if kind else "ok", failure_kind=kind)
            for e, kind in ends
        ]
        fields = by_measure(currents=normal(peak, 50.0, -0.2, 0.2), measurement_lines=normal(peak, 100.0, -0.2, 0.2))
        return claims.failed_where_unlikely(records, fields, ("E", "nu"))

    def test_failures_of_soft_samples(self) -> None:
        claim = self.claim((150.0, "limit_point"), (120.0, "limit_point"), (110.0, "continuation_stalled"))
        numbers = settled(claim, "confirmed", "3 of 5 runs", "limit_point: 2", "up to 150 Pa, 7 %", "fold", "4e-05")
        assert numbers["highest_E_of_a_failed_run"] == 150.0
        assert numbers["by_kind"] == {"limit_point": 2, "continuation_stalled": 1}
        assert numbers["likelihood_there"]["currents"] == pytest.approx(np.exp(-0.5 * 9.0**2))
        assert numbers["likelihood_there"]["measurement_lines"] == pytest.approx(np.exp(-0.5 * 4.5**2))
        other = self.claim((150.0, "limit_point"), (120.0, "newton_stalled"))
        settled(other, "confirmed", "newton_stalled: 1")
        assert "fold" not in other.because

    def test_failures_of_stiff_or_of_likely_samples_refute(self) -> None:
        settled(self.claim((750.0, "mesh"), peak=300.0), "refuted", "up to 750 Pa, 93 %")
        likely = settled(self.claim((200.0, "mesh"), peak=300.0), "refuted", "0.6 of")
        assert likely["likelihood_there"]["measurement_lines"] == pytest.approx(np.exp(-0.5))
        assert settled(self.claim(), "differs", "None of 2 runs failed") == {"failed": 0, "runs": 2}


class TestTrainingSize:
    SIZES = (50, 100, 200, 500, 1000)
    GOOD = (0.6, 0.18, 0.08, 0.05, 0.02)

    def claim(self, centre: tuple[float, ...], best: tuple[float, float] = (390.0, 0.25)) -> Claim:
        off = dict(zip(self.SIZES, centre, strict=False))
        variations = {"centre": off, "refined": {n: 0.5 * d for n, d in off.items()}}
        return claims.training_size(variations, {rule: dict.fromkeys(off, best) for rule in variations}, TRUTH)

    def test_good_from_200_runs_on(self) -> None:
        numbers = settled(
            self.claim(self.GOOD), "confirmed", "from 200 runs is 0.08", "0.1 from 200 runs on", "(390 Pa, 0.25)"
        )
        assert numbers["runs_to_total_variation_0.1"] == {"centre": 200, "refined": 100}
        assert numbers["total_variation"]["centre"]["500"] == 0.05
        assert numbers["maximum_likelihood"]["refined"]["50"] == [390.0, 0.25]

    def test_a_posterior_that_is_not_found_for_good_and_a_bad_estimate_refute(self) -> None:
        for centre, good_from in (
            ((0.6, 0.4, 0.3, 0.05, 0.02), 500),
            ((0.6, 0.4, 0.3, 0.3, 0.3), None),  # little gain, but no shape
            ((0.6, 0.4, 0.08, 0.2, 0.05), 1000),  # 200 were luck
        ):
            numbers = settled(self.claim(centre), "refuted", f"0.1 from {good_from or 'more than 1000'} runs on")
            assert numbers["runs_to_total_variation_0.1"]["centre"] == good_from
        for best in ((460.0, 0.3), (400.0, 0.15)):
            figures = f"({best[0]:.0f} Pa, {best[1]:.2f})", "the truth is (400 Pa, 0.30)"
            settled(self.claim(self.GOOD, best), "refuted", *figures)

    def test_nothing_is_said_of_more_where_no_design_is_larger(self) -> None:
        for centre in ((0.01,), (0.6, 0.02), (0.6, 0.18, 0.3)):
            settled(self.claim(centre), "differs", "No design is larger")


class TestUniformPrior:
    REFINED = weighted(normal(400.0, 60.0, -0.1, 0.1))

    def claim(self, log_density: Function) -> Claim:
        return claims.uniform_prior(weighted(log_density), self.REFINED)

    def test_one_mode_and_a_plateau(self) -> None:
        claim = self.claim(lambda e, nu: -0.5 * ((e - 400.0) / 60.0) ** 2 + 0.0 * nu)
        numbers = settled(claim, "confirmed", "E has 1 mode.", "plateau here too", "sd is 0.375")
        assert numbers["modes_of_E"] == pytest.approx([400.0], abs=10.0)
        assert 2.9 < numbers["plateau"]["nu"] < np.sqrt(12) + 0.02
        assert numbers["plateau"]["E"] == pytest.approx(2 * np.sqrt(2 * np.log(1.25)), abs=0.15)
        assert numbers["plateau_refined"]["nu"] == pytest.approx(2 * np.sqrt(2 * np.log(1.25)), abs=0.15)
        assert numbers["mean"] == {"E": pytest.approx(400.0, abs=2.0), "nu": pytest.approx(-0.15, abs=0.01)}
        assert numbers["sd"] == {"E": pytest.approx(60.0, rel=0.03), "nu": pytest.approx(1.3 / np.sqrt(12), rel=0.02)}

    def test_without_a_plateau_the_outlines_differ(self) -> None:
        """A triangle."""
        claim = self.claim(
            lambda e, nu: -0.5 * ((e - 400.0) / 60.0) ** 2 + np.log(np.maximum(1 - np.abs(nu + 0.15) / 0.65, 1e-9))
        )
        numbers = settled(claim, "differs", "no plateau", "(400 Pa, -0.15)")
        assert 0.2 * np.sqrt(24) < numbers["plateau"]["nu"] < 1.45  # kernels round off its tip
        assert f"{numbers['plateau']['nu']:.2f} standard deviations" in claim.because

    def test_two_modes_of_stiffness_refute(self) -> None:
        claim = self.claim(
            lambda e, nu: np.logaddexp(-0.5 * ((e - 250.0) / 30.0) ** 2, -0.5 * ((e - 600.0) / 30.0) ** 2 - 0.5)
        )
        numbers = settled(claim, "refuted", "E has 2 modes.")
        assert numbers["modes_of_E"] == pytest.approx([250.0, 600.0], abs=12.0)  # the highest first
        assert numbers["map"]["E"] == pytest.approx(250.0, abs=5.0)


def calibration(**known: Any) -> Calibration:
    """Return one of which nothing else is known."""
    made = Calibration.__new__(Calibration)
    for name, value in known.items():
        object.__setattr__(made, name, value)
    return made


def test_fields_are_those_of_each_surrogate_with_the_first_input_first() -> None:
    x = SPACE.to_physical(sobol(128, 2))
    peaks = {"currents": (400.0, 150.0, 0.1, 0.4), "closest_point": (500.0, 200.0, -0.2, 0.5)}
    surrogates = {name: fit_log_likelihood(x, normal(*peak)(x[:, 0], x[:, 1])) for name, peak in peaks.items()}
    problem = Problem(Folding(), SPACE, {"V_in": 100.0}, (), {})
    fields = likelihood_fields(calibration(problem=problem, surrogates=surrogates))
    assert list(fields) == list(peaks)
    for name, found in fields.items():
        assert found.values.shape == (GRID, GRID)
        assert (found.x[0], found.x[-1], found.y[0], found.y[-1]) == (100.0, 800.0, -0.8, 0.5)
        off = np.abs(found.values - normal(*peaks[name])(found.x[:, None], found.y)) / np.ptp(found.values)
        assert off.max() < 0.05
        assert off.mean() < 0.005


class TestLaplaceMisleads:
    MIDDLE = np.array([450.0, -0.15])

    def hessian(self, angle_deg: float) -> np.ndarray:
        """Return that of a normal density with that main axis in the unit square, stretched to the study's box."""
        a, width = np.radians(angle_deg), np.array([700.0, 1.3])
        axes = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        return np.asarray(-np.linalg.inv(axes @ np.diag([0.1**2, 0.05**2]) @ axes.T * np.outer(width, width)))

    def claim(self, centre: np.ndarray, refined: np.ndarray | None = None) -> Claim:
        """Judge a normal posterior along the diagonal of the box, and what Laplace makes of Hessians there."""
        along = self.hessian(45.0)

        def log_density(e: Any, nu: Any) -> Any:
            offset = np.stack([e, nu], axis=-1) - self.MIDDLE
            return 0.5 * np.einsum("...i,ij,...j", offset, along, offset)

        posterior = weighted(log_density)
        hessians = {"centre": centre, "refined": along if refined is None else refined}
        return claims.laplace_misleads(
            {k: calibration(posterior=posterior, laplace=laplace(h, self.MIDDLE)) for k, h in hessians.items()}
        )

    def test_an_axis_across_the_posterior(self) -> None:
        claim = self.claim(self.hessian(-45.0))
        numbers = settled(claim, "confirmed", "main axis is 90° off", "it is 0° off and the ellipse holds 90 %")
        assert numbers["centre"]["angle_deg"] == pytest.approx(90.0, abs=0.5)
        edge = np.sqrt(stats.chi2.ppf(0.9, 2))  # the mass of z ~ N(0, diag(2², 0.5²)) in the ellipse of N(0, 1)
        z = np.linspace(-edge, edge, 20001)
        inner = 2 * stats.norm.cdf(np.sqrt(edge**2 - z**2) / 0.5) - 1
        held = np.sum(stats.norm.pdf(z, scale=2.0) * inner) * (z[1] - z[0])
        assert numbers["centre"]["mass_in_its_90_%_ellipse"] == pytest.approx(held, abs=0.01)
        assert f"holds {100 * held:.0f} % of the posterior" in claim.because
        assert numbers["centre"]["sd_ratio"] == pytest.approx([1.0, 1.0], rel=0.01)
        assert numbers["refined"]["angle_deg"] == pytest.approx(0.0, abs=0.5)

    def test_its_own_axis_refutes_and_too_small_an_ellipse_misleads_in_another_way(self) -> None:
        numbers = settled(self.claim(self.hessian(30.0)), "refuted", "15° off")
        assert numbers["centre"]["angle_deg"] == pytest.approx(15.0, abs=0.5)
        small = self.claim(100 * self.hessian(45.0))
        numbers = settled(small, "differs", "0° off", "holds 2 % of the posterior")
        assert numbers["centre"]["mass_in_its_90_%_ellipse"] == pytest.approx(1 - 0.1**0.01, abs=0.005)
        assert numbers["centre"]["sd_ratio"] == pytest.approx([0.1, 0.1], rel=0.01)

    def test_without_an_approximation_there_is_no_axis(self) -> None:
        indefinite = np.diag([-1e-3, 4.0])
        numbers = settled(self.claim(indefinite), "differs", "no approximation at all")
        assert numbers["centre"] == {"eigenvalues": [-1e-3, 4.0], "angle_deg": None}
        across = self.claim(self.hessian(-45.0), indefinite)
        settled(across, "confirmed", "refined quadrature the Hessian is ind")


class TestInformedPrior:
    UNIFORM = weighted(normal(400.0, 30.0, 0.3, 0.2))

    def claim(self, log_density: Function) -> Claim:
        return claims.informed_prior(weighted(log_density, INFORMED), self.UNIFORM)

    def test_the_marginal_is_the_prior_and_the_map_lower(self) -> None:
        claim = self.claim(lambda e, nu: -0.5 * ((e - 385.0) / 30.0) ** 2 + PRIOR_OF_NU.logpdf(np.maximum(nu, -0.799)))
        numbers = settled(claim, "confirmed", "nearly the same", f"({385:.0f}, {PRIOR_OF_NU.mean():.2f})")
        assert numbers["nu_distance_to_prior"] < 0.03
        assert numbers["map"] == {"E": pytest.approx(385.0, abs=6.0), "nu": pytest.approx(0.2, abs=0.03)}
        assert numbers["mean"]["nu"] == pytest.approx(PRIOR_OF_NU.mean(), abs=0.01)
        assert numbers["sd"]["nu"] == pytest.approx(PRIOR_OF_NU.std(), rel=0.03)
        assert numbers["map_moved_by_sd"]["E"] == pytest.approx(-0.5, abs=0.3)

    def test_a_map_that_moves_with_a_marginal_that_is_not_the_prior(self) -> None:
        edges = np.linspace(-0.8, 0.5, 31)
        distance = 0.5 * np.abs(np.diff(stats.norm.cdf(edges, 0.2, 0.08)) - np.diff(PRIOR_OF_NU.cdf(edges))).sum()
        figures = f"{distance:.2f} in total variation", "the data inform ν as well"
        numbers = settled(self.claim(normal(385.0, 30.0, 0.2, 0.08)), "differs", *figures)
        assert numbers["nu_distance_to_prior"] == pytest.approx(distance, abs=0.01)

    def test_a_map_that_does_not_move_to_lower_values_refutes(self) -> None:
        for e, nu in ((420.0, 0.2), (385.0, 0.4), (399.7, 0.299)):
            settled(self.claim(normal(e, 30.0, nu, 0.08)), "refuted", "The MAP moves by")
        less_than_noise = replace(self.UNIFORM, draws=np.maximum(self.UNIFORM.draws - [0.3, 0.002], SPACE.low))
        claim = claims.informed_prior(less_than_noise, self.UNIFORM)
        settled(claim, "refuted", "-0.3 Pa and -0.002, -0.01 and -0.01 standard deviations")


class TestUncertainInflow:
    GRID = product_grid(SPACE, panels=(48, 16, 1), rate=100.0)

    def of(self, density: Function) -> GridPosterior:
        return posterior_on_grid(lambda x: density(x[:, 0], x[:, 1]), SPACE, self.GRID)

    def claim(self, joint: Function, found: float = 372.0) -> Claim:
        nu = {"mean": -0.1, "sd": 0.1, "map": -0.1}
        readings = {
            "joint": {"inputs": {"E": {"mean": found, "sd": 45.0, "map": 360.0}, "nu": nu}},
            "cut": {"inputs": {"E": {"mean": 350.0, "sd": 70.0, "map": 340.0}, "nu": nu}},
        }
        truth = {"joint": self.of(joint), "cut": self.of(normal(360.0, 60.0, -0.1, 0.1))}
        known = self.of(normal(400.0, 20.0, -0.1, 0.1))
        return claims.uncertain_inflow(readings, weighted(normal(400.0, 30.0, -0.1, 0.1)), truth, known)

    def test_wider_and_lower(self) -> None:
        claim, figures = self.claim(normal(370.0, 40.0, -0.1, 0.1)), ("2.00 times", "from 400 to 370 Pa")
        numbers = settled(claim, "confirmed", *figures, "360 ± 60 Pa", "372 ± 45 Pa", "0.05 sd off.")
        assert numbers["sd_ratio_E"] == pytest.approx(2.0, rel=1e-3)
        assert numbers["surrogate_sd_ratio_E"] == pytest.approx(1.5, rel=0.02)
        truth = numbers["true_model"]
        assert truth["joint"]["mean"] == {"E": pytest.approx(370.0, abs=0.01), "nu": pytest.approx(-0.1, abs=1e-4)}
        assert truth["joint"]["sd"] == {"E": pytest.approx(40.0, rel=1e-3), "nu": pytest.approx(0.1, rel=1e-3)}
        assert truth["joint"]["mode"] == {"E": pytest.approx(370.0, abs=6.0), "nu": pytest.approx(-0.1, abs=0.02)}
        assert truth["cut"]["sd"]["E"] == pytest.approx(60.0, rel=1e-3)
        assert numbers["true_model_inflow_known"]["sd"]["E"] == pytest.approx(20.0, rel=1e-3)
        assert numbers["map"] == {"E": 360.0, "nu": -0.1}
        settled(self.claim(normal(370.0, 40.0, -0.1, 0.1), found=390.0), "confirmed", "0.50 sd off, as")

    def test_wider_but_not_lower_and_narrower(self) -> None:
        settled(self.claim(normal(430.0, 40.0, -0.1, 0.1)), "differs", "2.00 times")
        peak, tail = normal(420.0, 20.0, -0.1, 0.1), normal(280.0, 60.0, -0.1, 0.1)
        lower_mean_not_mode = self.claim(lambda e, nu: np.logaddexp(peak(e, nu), tail(e, nu) - 0.7))
        settled(lower_mean_not_mode, "differs", "mean goes from 400 to 336 Pa")
        for sd, figure in ((10.0, "0.50 times"), (19.6, "0.98 times")):
            settled(self.claim(normal(370.0, sd, -0.1, 0.1)), "refuted", figure)


def test_density_over_prior_is_the_mass_of_a_bin_over_that_of_the_prior() -> None:
    posterior = weighted(normal(500.0, 60.0, -0.2, 0.1), INFORMED)
    bins = np.linspace(100.0, 800.0, 31)[14:16], np.linspace(-0.8, 0.5, 31)[16:18]
    lognormal = stats.lognorm(0.4, scale=np.exp(5.86))
    cut = lognormal.cdf(800.0) - lognormal.cdf(100.0)
    of_e = np.diff(stats.norm.cdf(bins[0], 500.0, 60.0)) / np.diff(lognormal.cdf(bins[0])) * cut
    of_nu = np.diff(stats.norm.cdf(bins[1], -0.2, 0.1)) / np.diff(PRIOR_OF_NU.cdf(bins[1]))
    assert density_over_prior(posterior, "E", 445.0) == pytest.approx(of_e[0], rel=0.03)
    assert density_over_prior(posterior, "nu", -0.08) == pytest.approx(of_nu[0], rel=0.03)
    assert density_over_prior(posterior, "E", 800.0) < 1e-3  # the upper end is in the last bin


def test_a_number_that_json_does_not_know_becomes_null() -> None:
    claim = Claim("C0", "", (1,), "differs", ".", {"k": np.inf, "of": [1.0, {"x": -np.inf, "y": (np.nan, 2)}]})
    assert settled(claim, "differs") == {"k": None, "of": [1.0, {"x": None, "y": [None, 2]}]}
