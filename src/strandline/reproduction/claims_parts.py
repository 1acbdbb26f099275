"""The claims of the study on the heterogeneous specimen, C9 and C10 (Willmann et al. 2022, Figs. 11-15)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from strandline.posterior import Posterior, histogram_mode
from strandline.reproduction.judgement import Claim, distance_to_prior

__all__ = ["heterogeneous", "more_runs"]

STUDY_MAP = {"E1": 345.0, "nu1": 0.43, "E2": 135.0, "nu2": 0.30, "E3": 1034.0, "nu3": -0.47}
STUDY_MEAN = {"E1": 443.0, "nu1": -0.15, "E2": 431.0, "nu2": -0.13, "E3": 637.0, "nu3": -0.14}
BINS = 10
BELIEVED = 0.7
"""Pareto k̂ up to which a check of the posterior is quoted as support."""
LITTLE = 0.1
"""Relative fall of the error that counts as no significant improvement."""


def heterogeneous(posterior: Posterior, checks: Mapping[str, Mapping[str, Any]], truth: Mapping[str, float]) -> Claim:
    """Judge C9.

    Args:
        posterior: of the study's method, centre rule; it holds the inputs of `STUDY_MAP`.
        checks: content of check.json by study: of that posterior, and others to compare with.
        truth: the inputs of the observation.
    """
    names = list(STUDY_MAP)
    shift = {name: distance_to_prior(posterior, name) for name in names}
    told = sorted(names, key=lambda n: -shift[n])
    dominated = told[0] == "E2" and set(told[:2]) == {"E2", "nu2"}
    bounds = [posterior.space[name].interval for name in names]
    mode = histogram_mode(posterior.columns(names), posterior.weights, bounds=bounds, bins=BINS)
    mean = posterior.weights @ posterior.columns(names)
    first, k_hat = next(iter(checks.values())), {name: c["k_hat"] for name, c in checks.items()}
    median = float(np.median(first["particles"]["true"]))
    expected = float(np.median(first["particles"]["surrogate"]))
    believed = first["k_hat"] < BELIEVED
    return Claim(
        "C9",
        "Of six material parameters E2, that of the largest part, dominates; only E2 and ν2 gather around the truth.",
        (13, 14, 15),
        ("confirmed" if believed else "differs") if dominated else "refuted",
        "By total variation between marginal and prior the order is "
        + ", ".join(f"{name} {shift[name]:.2f}" for name in told)
        + f". At draws of this posterior the surrogate puts log L at {expected:.1f} in the median, the true model at "
        f"{median:.1f}; k̂ = {first['k_hat']:.2f}"
        + (
            ": the surrogate can be believed."
            if believed
            else ", so that the surrogate's posterior is not the true one."
        )
        + "".join(f" {name.capitalize()}: k̂ = {k:.2f}." for name, k in list(k_hat.items())[1:]),
        {
            "distance_to_prior": shift,
            "map": dict(zip(names, mode.tolist(), strict=True)),
            "mean": dict(zip(names, mean.tolist(), strict=True)),
            "truth": {name: truth[name] for name in names},
            "k_hat": k_hat,
            "median_log_likelihood": {"surrogate": expected, "true": median},
        },
        {"map": STUDY_MAP, "mean": STUDY_MEAN},
    )


def more_runs(numbers: Sequence[int], errors: Mapping[str, Sequence[float]]) -> Claim:
    """Judge C10.

    Args:
        numbers: training sizes, ascending; the largest is compared with that nearest to 1000.
        errors: relative L2 errors at later Sobol points, by case; the study's first.
    """
    at = int(np.argmin([abs(n - 1000) for n in numbers]))
    gains = {name: 1.0 - values[-1] / values[at] for name, values in errors.items()}
    name, gain = next(iter(gains.items()))
    return Claim(
        "C10",
        "From 1000 to 5000 training runs in seven inputs the surrogate does not improve significantly.",
        (12,),
        "confirmed" if gain <= LITTLE else "refuted",
        f"The relative L2 error ({name}) goes from {errors[name][at]:.3f} at {numbers[at]} runs to "
        f"{errors[name][-1]:.3f} at {numbers[-1]}, a fall of {100 * gain:.0f} %"
        + "".join(f"; {other}: {100 * g:.0f} %" for other, g in list(gains.items())[1:])
        + ". A plateau of this error does not mean that the surrogate is good enough: see the check of the posterior.",
        {"runs": list(numbers), "errors": {n: list(v) for n, v in errors.items()}, "fall": gains},
    )
