"""The claims of the study about the heterogeneous specimen, C9 and C10 (Willmann et al. 2022, Figs. 11-15)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from verification.reproduction.judgement import Claim, Verdict, density_over_prior, distance_to_prior

from strandline.posterior import Posterior, histogram_mode

__all__ = ["heterogeneous", "more_runs"]

STUDY_MAP = {"E1": 345.0, "nu1": 0.43, "E2": 135.0, "nu2": 0.30, "E3": 1034.0, "nu3": -0.47}
STUDY_MEAN = {"E1": 443.0, "nu1": -0.15, "E2": 431.0, "nu2": -0.13, "E3": 637.0, "nu3": -0.14}
BINS = 10
GATHERED = ("E2", "nu2")
BROAD = ("E1", "E3", "nu3")
TOLD = 0.2
"""Total variation to the prior above which the data inform an input; a triangle on a uniform prior has 0.25."""
LITTLE = 0.1
"""Relative fall of the error that counts as no significant improvement."""


def heterogeneous(posterior: Posterior, checks: Mapping[str, Mapping[str, Any]], truth: Mapping[str, float]) -> Claim:
    """Judge C9 by the marginals and by the check of the posterior with the true model.

    A marginal gathers around the truth if it is not broad and is denser there than its prior. The claim holds if E2 and
    ν2 gather and no other input does; the study does not say whether ν1 stays broad. If the check finds the posterior
    unreliable, it does not show what the data say, and the claim is neither confirmed nor refuted.

    Args:
        posterior: Posterior of the study's method, centre rule; it holds the inputs of `STUDY_MAP`.
        checks: Content of check.json by study: first that of this posterior, then others to compare with.
        truth: The inputs of the observation.
    """
    names = list(STUDY_MAP)
    shift = {name: distance_to_prior(posterior, name) for name in names}
    told = sorted(names, key=lambda n: -shift[n])
    denser = {name: density_over_prior(posterior, name, truth[name]) for name in names}
    gathered = [name for name in told if shift[name] >= TOLD and denser[name] > 1]
    holds = told[0] == "E2" and set(gathered) == set(GATHERED) and all(shift[name] < TOLD for name in BROAD)
    bounds = [posterior.space[name].interval for name in names]
    mode = histogram_mode(posterior.columns(names), posterior.weights, bounds=bounds, bins=BINS)
    mean = posterior.weights @ posterior.columns(names)
    first, k_hat = next(iter(checks.values())), {name: c["k_hat"] for name, c in checks.items()}
    median = float(np.median(first["particles"]["true"]))
    expected = float(np.median(first["particles"]["surrogate"]))
    believed = first["verdict"] != "bad"
    verdict: Verdict = ("confirmed" if holds else "refuted") if believed else "differs"
    return Claim(
        "C9",
        "Of six material parameters E2, that of the largest part, dominates; only E2 and ν2 gather around the truth.",
        (13, 14, 15),
        verdict,
        "By total variation between marginal and prior the order is "
        + ", ".join(f"{name} {shift[name]:.2f}" for name in told)
        + f". {' and '.join(gathered) or 'None'} gather around the truth: at least {TOLD:g}, and denser there than the "
        f"prior (E2 {denser['E2']:.1f} times, nu2 {denser['nu2']:.1f} times). At draws of this posterior the surrogate "
        f"puts log L at {expected:.1f} in the median, the true model at {median:.1f}; k̂ = {first['k_hat']:.2f}"
        + (
            ", so that the surrogate's posterior can be used."
            if believed
            else ", so that the surrogate's posterior is not the true one."
        )
        + "".join(f" {name.capitalize()}: k̂ = {k:.2f}." for name, k in list(k_hat.items())[1:]),
        {
            "distance_to_prior": shift,
            "density_at_truth_over_prior": denser,
            "map": dict(zip(names, mode.tolist(), strict=True)),
            "mean": dict(zip(names, mean.tolist(), strict=True)),
            "truth": {name: truth[name] for name in names},
            "k_hat": k_hat,
            "median_log_likelihood": {"surrogate": expected, "true": median},
        },
        {"map": STUDY_MAP, "mean": STUDY_MEAN},
    )


def more_runs(numbers: Sequence[int], errors: Mapping[str, Sequence[float]]) -> Claim:
    """Judge C10 by the fall of the surrogate's error.

    Args:
        numbers: Training sizes, ascending; the largest is compared with the one nearest to 1000.
        errors: Relative L2 errors at later Sobol points, by case; the study's case comes first.
    """
    at = int(np.argmin([abs(n - 1000) for n in numbers]))
    gains = {name: _fall(values[at], values[-1]) for name, values in errors.items()}
    name, gain = next(iter(gains.items()))
    alone = at == len(numbers) - 1
    return Claim(
        "C10",
        "From 1000 to 5000 training runs in seven inputs the surrogate does not improve significantly.",
        (12,),
        "differs" if alone else "confirmed" if gain <= LITTLE else "refuted",
        f"The relative L2 error ({name}) goes from {errors[name][at]:.3f} at {numbers[at]} runs to "
        f"{errors[name][-1]:.3f} at {numbers[-1]}, by {_percent(-gain)}"
        + "".join(f"; {other}: {_percent(-g)}" for other, g in list(gains.items())[1:])
        + (". No training set is larger: what more runs bring is not known." if alone else ".")
        + " A plateau of this error does not mean that the surrogate is good enough: see the check of the posterior.",
        {"runs": list(numbers), "errors": {n: list(v) for n, v in errors.items()}, "fall": gains},
    )


def _percent(change: float) -> str:
    return f"{100 * change:+z.0f} %"


def _fall(before: float, after: float) -> float:
    """Return the relative fall of an error, negative for a rise; 0 for an error of 0, which cannot fall."""
    return 1.0 - after / before if before > 0 else 0.0
