"""The claims on the specimen of three parts, C9 and C10, each on evidence whose verdict is known by construction."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tests.check.verification.reproduction.judged import settled, weighted_draws
from verification.reproduction import claims_parts
from verification.reproduction.judgement import Claim

from strandline.design import sobol
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior
from strandline.priors import ScaledBeta, Uniform

NAMES = ("E1", "E2", "E3", "nu1", "nu2", "nu3")
INTERVALS = {"E1": (100.0, 800.0), "E2": (100.0, 800.0), "E3": (100.0, 1200.0)} | dict.fromkeys(NAMES[3:], (-0.8, 0.5))
INFLOW = Parameter("V_in", ScaledBeta(2.6, 1.4, 0.0, 110.0), "mm^2/s", nuisance=True)
SPACE = ParameterSpace((*(Parameter(name, Uniform(*INTERVALS[name])) for name in NAMES), INFLOW))
TRUTH = {"E1": 500.0, "nu1": 0.2, "E2": 200.0, "nu2": 0.1, "E3": 1000.0, "nu3": 0.3, "V_in": 100.0}
Density = Callable[[np.ndarray], np.ndarray]


def triangle(name: str, apex: float) -> Density:
    """Return a density with that apex over the whole interval: 0.25 of total variation off uniform wherever it is."""
    low, high = INTERVALS[name]
    return lambda x: np.asarray(stats.triang.pdf(x, (apex - low) / (high - low), loc=low, scale=high - low))


def slope(name: str) -> Density:
    """Return the density (0.5 + u) in the unit interval: 0.125 of total variation off uniform."""
    low, high = INTERVALS[name]
    return lambda x: (0.5 + (x - low) / (high - low)) / (high - low)


def narrow(mean: float, sd: float) -> Density:
    return lambda x: np.asarray(stats.norm.pdf(x, mean, sd))


def posterior(**densities: Density) -> Posterior:
    """Return weighted draws of the product of marginals; those that are not given are uniform."""
    draws = SPACE.to_physical(sobol(16384, SPACE.dim))
    product = np.prod([densities[name](draws[:, SPACE.names.index(name)]) for name in densities], axis=0)
    with np.errstate(divide="ignore"):
        return weighted_draws(SPACE, draws, np.log(np.asarray(product) * np.ones(len(draws))))


def check(*, verdict: str = "good", k_hat: float = 0.3, true: tuple[float, ...] = (-2.0, -4.0, -3.0)) -> dict[str, Any]:
    return {"verdict": verdict, "k_hat": k_hat, "particles": {"true": list(true), "surrogate": [-1.0, -2.0, -1.5]}}


GATHERED = {"E2": narrow(200.0, 80.0), "nu2": triangle("nu2", 0.1), "nu1": slope("nu1")}


class TestHeterogeneous:
    def claim(self, densities: Mapping[str, Density], **content: Any) -> Claim:
        checks = {"biofilm-parts": check(**content), "biofilm-parts-refined": check(k_hat=0.55)}
        return claims_parts.heterogeneous(posterior(**densities), checks, TRUTH)

    def test_two_inputs_gather_and_the_others_stay_broad(self) -> None:
        claim = self.claim(GATHERED)
        numbers = settled(claim, "confirmed", "E2 and nu2 gather", "k̂ = 0.30", "Biofilm-parts-refined: k̂ = 0.55.")
        edges = np.linspace(100.0, 800.0, 31)
        normal = stats.truncnorm((100 - 200) / 80, (800 - 200) / 80, 200, 80)
        expected = {"E2": 0.5 * np.abs(np.diff(normal.cdf(edges)) - 1 / 30).sum(), "nu2": 0.25, "nu1": 0.125}
        for name in NAMES:
            assert numbers["distance_to_prior"][name] == pytest.approx(expected.get(name, 0.0), abs=0.02)
            assert f"{name} {numbers['distance_to_prior'][name]:.2f}" in claim.because
        assert f"the order is E2 {expected['E2']:.1f}" in claim.because
        denser = numbers["density_at_truth_over_prior"]
        assert denser["E2"] == pytest.approx(700 * normal.pdf(200.0), rel=0.1)
        assert denser["nu2"] == pytest.approx(2.0, rel=0.12)
        assert denser["E1"] == pytest.approx(1.0, abs=0.1)
        assert numbers["mean"]["E3"] == pytest.approx(650.0, abs=10.0)
        assert numbers["mean"]["nu2"] == pytest.approx((-0.8 + 0.5 + 0.1) / 3, abs=0.01)
        assert numbers["median_log_likelihood"] == {"surrogate": -1.5, "true": -3.0}
        assert numbers["k_hat"] == {"biofilm-parts": 0.3, "biofilm-parts-refined": 0.55}

    def test_the_map_is_the_middle_of_the_fullest_bin(self) -> None:
        one_bin = {name: narrow(TRUTH[name] + 0.02, 0.03 * np.ptp(INTERVALS[name])) for name in ("E1", "E2", "nu2")}
        numbers = settled(self.claim(one_bin), "refuted")
        assert numbers["map"]["E2"] == pytest.approx(205.0)  # of [170, 240]
        assert numbers["map"]["E1"] == pytest.approx(485.0)  # of [450, 520]

    def test_anything_else_refutes(self) -> None:
        for changes, figure in (
            ({"E1": triangle("E1", 500.0)}, "E2 and nu2 and E1 gather"),
            ({"E3": triangle("E3", 150.0)}, "E2 and nu2 gather"),  # away from its truth, but not broad
            ({"E2": narrow(600.0, 80.0)}, "nu2 gather"),  # E2 dominates, but away from its truth
            ({"nu2": slope("nu2")}, "E2 gather"),
            ({"nu2": narrow(0.1, 0.05)}, "nu2 and E2 gather"),  # both gather, and ν2 dominates
        ):
            settled(self.claim(GATHERED | changes), "refuted", f". {figure} around the truth")
        broad = self.claim({"E2": slope("E2"), "nu2": lambda x: 1 + 0.3 * x})
        settled(broad, "refuted", "None gather", "the order is E2 0.1")

    def test_the_verdict_of_the_check_counts_not_its_k_hat(self) -> None:
        for densities in (GATHERED, {}):  # below 0.7, above the threshold of 200 draws
            claim = self.claim(densities, verdict="bad", k_hat=0.6)
            settled(claim, "differs", "k̂ = 0.60", "is not the true one")
            assert "can be used" not in claim.because
        settled(self.claim(GATHERED, verdict="good", k_hat=0.9), "confirmed", "k̂ = 0.90", "can be used")
        all_failed = self.claim(GATHERED, verdict="bad", k_hat=np.inf, true=(-np.inf, -np.inf, -3.0))
        numbers = settled(all_failed, "differs", "k̂ = inf")
        assert numbers["k_hat"]["biofilm-parts"] is None
        assert numbers["median_log_likelihood"]["true"] is None


class TestMoreRuns:
    SIZES = (100, 200, 500, 1000, 2000, 5000)

    def test_an_error_that_stays_or_rises_confirms_and_one_that_falls_refutes(self) -> None:
        errors = {"log L": [0.9, 0.8, 0.85, 0.50, 0.48, 0.46], "L": [9.0, 8.0, 7.0, 4.0, 3.0, 1.0]}
        claim = claims_parts.more_runs(self.SIZES, errors)
        numbers = settled(claim, "confirmed", "0.500 at 1000 runs to 0.460 at 5000, by -8 %; L: -75 %.")
        assert numbers["fall"] == pytest.approx({"log L": 0.08, "L": 0.75})
        assert numbers["runs"] == list(self.SIZES)
        assert numbers["errors"] == errors
        rising = claims_parts.more_runs(self.SIZES, {"log L": [0.9, 0.8, 0.85, 0.5, 0.48, 0.6]})
        assert settled(rising, "confirmed", "by +20 %")["fall"]["log L"] == pytest.approx(-0.2)
        falling = claims_parts.more_runs(self.SIZES, {"log L": [0.9, 0.8, 0.7, 0.50, 0.4, 0.3], "L": [1.0] * 6})
        assert settled(falling, "refuted", "by -40 %; L: +0 %")["fall"]["log L"] == pytest.approx(0.4)

    def test_without_a_larger_set_nothing_is_known(self) -> None:
        for sizes in ((1000,), (24, 48), (200, 900)):
            claim = claims_parts.more_runs(sizes, {"log L": [0.5] * len(sizes)})
            settled(claim, "differs", f"at {sizes[-1]}, by", "No training set is larger")
        nothing = claims_parts.more_runs((1000, 5000), {"log L": [0.0, 0.0], "L": [np.inf, np.inf]})
        assert settled(nothing, "confirmed")["fall"] == {"log L": 0.0, "L": None}
