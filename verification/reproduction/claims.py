"""The claims of the study about two inputs, C1 to C8, each judged by numbers (Willmann et al. 2022, Figs. 3-10)."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.grid_posterior import GridPosterior
from verification.reproduction.judgement import (
    Claim,
    LikelihoodField,
    Verdict,
    angle_between_axes,
    correlation_ratio,
    distance_to_prior,
    mass_within,
    modes,
    plateau,
)

from strandline.calibration import Calibration
from strandline.posterior import Posterior
from strandline.runs import RunRecord

__all__ = [
    "failed_where_unlikely",
    "informed_prior",
    "laplace_misleads",
    "measures_compared",
    "ridge_and_peak",
    "training_size",
    "uncertain_inflow",
    "uniform_prior",
]

CURRENTS, CLOSEST, LINES = "currents", "closest_point", "measurement_lines"
BENT = 0.05
"""A ridge is called curved if it departs from its chord by this share of its extent."""
COUPLED = 0.5
"""Two inputs are called coupled if their correlation ratio, |ρ| for a normal distribution, is at least this."""
NEGLIGIBLE = 1e-3
GOOD = 0.1
"""Total variation to the truth below which a posterior's shape counts as found."""
AGREES = (50.0, 0.1)
"""An estimate of E, Pa, and ν this near the truth counts as good: about the spacing of 200 runs over the box."""
FAR = 45.0
"""Degrees between two axes above which they are nearer to orthogonal than to parallel."""
MOVED = 0.05
"""A MAP moved by less than this many standard deviations has not moved: the best of 5000 draws is 0.02 off the mode."""
FOLDS = {"limit_point", "continuation_stalled"}
"""How runs end at the fold; the second kind if the solver gives up before it has passed the fold."""
FOUND = 0.15
"""A mean within this many standard deviations of the true model's counts as found."""


def ridge_and_peak(
    fields: Mapping[str, LikelihoodField], truth: Sequence[float], posterior: Posterior, spacing: Sequence[float]
) -> Claim:
    """Judge C1 by the shape of the likelihood.

    Args:
        fields: Log-likelihood by measure.
        truth: Inputs of the observation.
        posterior: Posterior under the uniform prior.
        spacing: Mean distance of design points along each input.
    """
    field = fields[CURRENTS]
    off = {name: [abs(p - t) for p, t in zip(f.peak, truth, strict=True)] for name, f in fields.items()}
    ridge = field.ridge
    chord = np.linspace(ridge[0], ridge[-1], len(ridge))
    extent = float(np.ptp(ridge))
    bend = float(np.abs(ridge - chord).max())
    correlation = float(_correlation(posterior.covariance)[0, 1])
    ratio = correlation_ratio(posterior, "E", given="nu")
    at_truth = all(d <= s for distances in off.values() for d, s in zip(distances, spacing, strict=True))
    rounding = 2 * float(np.diff(field.x).max())
    curved = bend > max(BENT * extent, rounding)
    coupled = ratio >= COUPLED
    return Claim(
        "C1",
        "The likelihood is a curved ridge that couples E and ν, and its peak is at the ground truth.",
        (5, 6),
        "confirmed" if at_truth and curved and coupled else "refuted",
        f"Along the ridge E runs over {extent:.0f} Pa while ν crosses its box, up to {bend:.0f} Pa off a straight "
        f"line; in the posterior E and ν correlate by {correlation:.2f}, and the mean of E given ν explains "
        f"{100 * ratio**2:.0f} % of the variance of E. The peaks of the three measures lie at most "
        f"{max(d[0] for d in off.values()):.0f} Pa and {max(d[1] for d in off.values()):.3f} from the truth, where "
        f"design points are {spacing[0]:.0f} Pa and {spacing[1]:.3f} apart.",
        {
            "peak": {name: list(f.peak) for name, f in fields.items()},
            "ridge_extent_Pa": extent,
            "ridge_bend_Pa": bend,
            "correlation": correlation,
            "correlation_ratio": ratio,
            "design_spacing": list(spacing),
        },
        {"ground_truth": list(truth)},
    )


def measures_compared(fields: Mapping[str, LikelihoodField]) -> Claim:
    """Judge C2 by the share of the box where the likelihood under each measure is above half of its maximum."""
    shares = {name: f.share_above(0.5) for name, f in fields.items()}
    more_peaked = [name for name in (CLOSEST, CURRENTS) if shares[name] < shares[LINES]]
    return Claim(
        "C2",
        "Closest point projection and the RKHS norm give a more peaked likelihood than the Euclidean distance.",
        (5,),
        "confirmed" if len(more_peaked) == 2 else "refuted",
        "The likelihood is above half of its maximum on "
        + ", ".join(f"{100 * share:.2g} % of the box ({name.replace('_', ' ')})" for name, share in shares.items())
        + ". At one σ_N the likelihood is the narrower the more terms are added: 10 measurement lines, 66 nodes. The "
        "currents' is no such sum; its width depends on σ_W too.",
        {"share_of_box_above_half": shares},
    )


def failed_where_unlikely(
    records: Sequence[RunRecord], fields: Mapping[str, LikelihoodField], names: Sequence[str]
) -> Claim:
    """Judge C3 by the highest likelihood of each measure's surrogate at a failed run."""
    failed = np.array([[record.inputs[name] for name in names] for record in records if not record.ok])
    if not len(failed):
        words = f"None of {len(records)} runs failed."
        return Claim("C3", _C3, (5, 6, 7), "differs", words, {"failed": 0, "runs": len(records)})
    kinds = Counter(record.failure_kind or record.state for record in records if not record.ok)
    share = {name: float(np.exp(_nearest(f, failed).max() - f.values.max())) for name, f in fields.items()}
    low, high = float(fields[CURRENTS].x[0]), float(failed[:, 0].max())
    softest = (high - low) / float(np.ptp(fields[CURRENTS].x))
    return Claim(
        "C3",
        _C3,
        (5, 6, 7),
        "confirmed" if max(share.values()) < NEGLIGIBLE and softest < 1 / 3 else "refuted",
        f"{len(failed)} of {len(records)} runs failed ({', '.join(f'{kind}: {n}' for kind, n in kinds.most_common())})"
        f", at E up to {high:.0f} Pa, {100 * softest:.0f} % of the way through its interval. The highest likelihood "
        f"that a surrogate puts at one of them is {max(share.values()):.1g} of its maximum."
        + (
            " The reason is not the mesh: beyond a fold of the Saint-Venant–Kirchhoff law no steady state exists."
            if set(kinds) <= FOLDS
            else ""
        ),
        {
            "failed": len(failed),
            "runs": len(records),
            "by_kind": dict(kinds),
            "highest_E_of_a_failed_run": high,
            "likelihood_there": share,
        },
    )


_C3 = "Forward runs fail at low E only, where the likelihood is nearly zero."


def training_size(
    distance: Mapping[str, Mapping[int, float]],
    best: Mapping[str, Mapping[int, Sequence[float]]],
    truth: Sequence[float],
) -> Claim:
    """Judge C4: from 200 runs on, the posterior stays near the truth, and the estimate at 200 runs is good.

    If no design is larger than the one nearest to 200 runs, the effect of more runs is not known.

    Args:
        distance: Total variation to the posterior of the true model, by quadrature rule and number of runs.
        best: Inputs of maximum likelihood, by quadrature rule and number of runs.
        truth: Inputs of the observation.
    """
    centre, refined = distance["centre"], distance["refined"]
    numbers = sorted(centre)
    at = min(numbers, key=lambda n: abs(n - 200))
    last = numbers[-1]
    good_from = {rule: _good_from(d) for rule, d in distance.items()}
    shape = good_from["centre"] is not None and good_from["centre"] <= at
    estimate = all(abs(b - t) <= near for b, t, near in zip(best["centre"][at], truth, AGREES, strict=True))
    return Claim(
        "C4",
        "200 training points give the shape and a good maximum-likelihood estimate; more bring little.",
        (8,),
        "differs" if at == last else "confirmed" if shape and estimate else "refuted",
        f"With the centre rule the posterior from {at} runs is {centre[at]:.2f} in total variation from that of the "
        f"true model, from {last} runs {centre[last]:.2f}; it stays within {GOOD:g} from "
        f"{good_from['centre'] or f'more than {last}'} runs on. With the refined quadrature it is {refined[at]:.2f} at "
        f"{at} runs, and within {GOOD:g} from {good_from['refined'] or f'more than {last}'} runs on. The "
        f"maximum-likelihood estimate at {at} runs is ({best['centre'][at][0]:.0f} Pa, {best['centre'][at][1]:.2f}), "
        f"refined ({best['refined'][at][0]:.0f} Pa, {best['refined'][at][1]:.2f}); the truth is ({truth[0]:.0f} Pa, "
        f"{truth[1]:.2f})." + (" No design is larger: what more runs bring is not known." if at == last else ""),
        {
            "total_variation": {rule: {str(n): d[n] for n in numbers} for rule, d in distance.items()},
            "maximum_likelihood": {rule: {str(n): list(b[n]) for n in numbers} for rule, b in best.items()},
            "runs_to_total_variation_0.1": good_from,
        },
        {"runs": 200, "ground_truth": list(truth)},
    )


def uniform_prior(posterior: Posterior, refined: Posterior) -> Claim:
    """Judge C5 by posteriors under the uniform prior with the centre rule and the refined quadrature."""
    peaks, flat = modes(posterior, "E"), {n: plateau(posterior, n) for n in ("E", "nu")}
    wide = {n: plateau(refined, n) for n in ("E", "nu")}
    one_mode = len(peaks) == 1
    is_plateau = flat["nu"] >= 2.0
    sd = posterior.sd
    return Claim(
        "C5",
        "With a uniform prior E has one stable mode and the marginal of ν is a plateau.",
        (9,),
        "confirmed" if one_mode and is_plateau else "differs" if one_mode else "refuted",
        f"E has {len(peaks)} mode{'s' if len(peaks) > 1 else ''}. The marginal of ν is above 0.8 of its maximum over "
        f"{flat['nu']:.2f} standard deviations ({wide['nu']:.2f} with the refined quadrature; 1.34 for a Gaussian, "
        f"3.46 for a uniform density), its sd is {sd[1]:.3f}. "
        + (
            "So ν has a plateau here too."
            if is_plateau
            else "So the marginal of ν has no plateau on our outline, with this noise; the mean is "
            f"({posterior.mean[0]:.0f} Pa, {posterior.mean[1]:.2f})."
        ),
        {"map": _point(posterior.map_estimate), "mean": _point(posterior.mean), "sd": _point(sd)}
        | {"modes_of_E": peaks, "plateau": flat, "plateau_refined": wide},
        {"map": {"E": 388.0, "nu": 0.266}, "mean": {"E": 431.0, "nu": -0.0071}},
    )


def laplace_misleads(calibrations: Mapping[str, Calibration]) -> Claim:
    """Judge C6 by the calibrations with the centre rule and the refined quadrature (``centre``, ``refined``).

    It differs if there is no axis to compare, or if the axis is right but the ellipse, which should hold 90 % of the
    posterior, holds less than half.
    """
    found = {rule: _laplace_figures(c) for rule, c in calibrations.items()}
    centre, refined = found["centre"], found["refined"]
    verdict: Verdict = "differs"
    if centre["angle_deg"] is None:
        words = "With the centre rule the Hessian is indefinite: there is no approximation at all."
    else:
        misled = centre["angle_deg"] >= FAR
        verdict = "confirmed" if misled else "differs" if centre["mass_in_its_90_%_ellipse"] < 0.5 else "refuted"
        words = (
            f"With the centre rule its main axis is {centre['angle_deg']:.0f}° off the posterior's (in standardised "
            f"inputs), and its 90 % ellipse holds {100 * centre['mass_in_its_90_%_ellipse']:.0f} % of the posterior."
        )
    if refined["angle_deg"] is None:
        words += " With the refined quadrature the Hessian is indefinite."
    else:
        words += (
            f" With the refined quadrature it is {refined['angle_deg']:.0f}° off and the ellipse holds "
            f"{100 * refined['mass_in_its_90_%_ellipse']:.0f} %."
        )
    return Claim(
        "C6",
        "The Laplace approximation at the MAP misleads: its main axis is far from the posterior's.",
        (9,),
        verdict,
        words
        + " The approximation sees the curvature of the surrogate at one point, wiggles of the centre rule included.",
        found,
        {"angle_deg": "almost orthogonal"},
    )


def informed_prior(informed: Posterior, uniform: Posterior) -> Claim:
    """Judge C7 by posteriors under the informed and the uniform prior."""
    off, moved = distance_to_prior(informed, "nu"), informed.map_estimate - uniform.map_estimate
    by = moved / informed.sd
    lower = bool((by <= -MOVED).all())
    return Claim(
        "C7",
        "With the informed prior the MAP moves to lower values and the marginal of ν nearly equals its prior.",
        (9,),
        "confirmed" if off < GOOD and lower else "differs" if lower else "refuted",
        f"The MAP moves by {moved[0]:+.1f} Pa and {moved[1]:+.3f}, {by[0]:+.2f} and {by[1]:+.2f} standard deviations, "
        f"the mean from ({uniform.mean[0]:.0f}, {uniform.mean[1]:.2f}) to "
        f"({informed.mean[0]:.0f}, {informed.mean[1]:.2f}). The marginal of ν is {off:.2f} "
        "in total variation from its prior"
        + (", nearly the same." if off < GOOD else ": here the data inform ν as well."),
        {
            "map": _point(informed.map_estimate),
            "map_moved_by_sd": _point(by),
            "mean": _point(informed.mean),
            "sd": _point(informed.sd),
            "nu_distance_to_prior": off,
            "E_distance_to_prior": distance_to_prior(informed, "E"),
        },
        {"map": {"E": 361.0, "nu": 0.195}, "mean": {"E": 377.0, "nu": 0.08}},
    )


def uncertain_inflow(
    uncertain: Mapping[str, Any], certain: Posterior, truth: Mapping[str, GridPosterior], certain_truth: GridPosterior
) -> Claim:
    """Judge C8 by the true model; the surrogate's figures are given as well.

    Args:
        uncertain: Entry `under_uncertainty` of the summary of the study with uncertain inflow.
        certain: Posterior of the same study with the inflow known.
        truth: Posterior of the true model with uncertain inflow, ``joint`` and ``cut``.
        certain_truth: Posterior of the true model with the inflow known.
    """
    exact, known = truth["joint"], certain_truth
    figures = {
        reading: {n: {key: uncertain[reading]["inputs"][key][n] for key in ("E", "nu")} for n in ("map", "mean", "sd")}
        for reading in ("joint", "cut")
    }
    ratio = float(exact.sd[0] / known.sd[0])
    modes_of = {"uncertain": _mode(exact), "known": _mode(known)}
    lower = modes_of["uncertain"][0] < modes_of["known"][0]
    joint, cut = (uncertain[reading]["inputs"]["E"] for reading in ("joint", "cut"))
    off = abs(joint["mean"] - exact.mean[0]) / exact.sd[0]
    return Claim(
        "C8",
        "An uncertain inflow widens the posterior of E and moves the MAP to lower E.",
        (9, 10),
        "confirmed" if ratio > 1 and lower else "differs" if ratio > 1 else "refuted",
        f"In the true model the sd of E is {ratio:.2f} times that with the inflow known (joint), its mean goes from "
        f"{known.mean[0]:.0f} to {exact.mean[0]:.0f} Pa and the mode of (E, ν) from {modes_of['known'][0]:.0f} to "
        f"{modes_of['uncertain'][0]:.0f} Pa. If the data do not update the inflow (cut), E is "
        f"{truth['cut'].mean[0]:.0f} ± {truth['cut'].sd[0]:.0f} Pa. The surrogate says "
        f"{joint['mean']:.0f} ± {joint['sd']:.0f} Pa jointly, MAP {joint['map']:.0f}, and {cut['mean']:.0f} ± "
        f"{cut['sd']:.0f} Pa cut: its joint mean is {off:.2f} sd off"
        + ("." if off < FOUND else f", as the surrogate of {CURRENTS} is too rough in three inputs."),
        figures["joint"]
        | {
            "cut": figures["cut"],
            "true_model": {
                reading: {"mean": _point(found.mean), "sd": _point(found.sd), "mode": _point(_mode(found))}
                for reading, found in truth.items()
            },
            "true_model_inflow_known": {"mean": _point(known.mean), "sd": _point(known.sd)},
            "sd_ratio_E": ratio,
            "surrogate_sd_ratio_E": float(joint["sd"] / certain.sd[0]),
        },
        {"map": {"E": 322.0, "nu": 0.09}, "mean": {"E": 416.0, "nu": -0.09}},
    )


def _good_from(distance: Mapping[int, float]) -> int | None:
    """Return the number of runs from which on all distances are good; None if the last one is not."""
    last_bad = max((n for n, d in distance.items() if d > GOOD), default=0)
    return min((n for n in distance if n > last_bad), default=None)


def _mode(posterior: GridPosterior) -> Float[np.ndarray, "2"]:
    """Return the grid point of highest density."""
    i, j = np.unravel_index(int(np.argmax(posterior.density)), posterior.density.shape)
    return np.array([posterior.grid.young[i], posterior.grid.nu[j]])


def _laplace_figures(calibration: Calibration) -> dict[str, Any]:
    posterior, laplace = calibration.posterior, calibration.laplace
    figures: dict[str, Any] = {"eigenvalues": laplace.eigenvalues.tolist(), "angle_deg": None}
    if laplace.covariance is None:
        return figures
    width = np.array([np.ptp(parameter.interval) for parameter in posterior.space])
    return figures | {
        "angle_deg": angle_between_axes(laplace.covariance, posterior.covariance, width),
        "mass_in_its_90_%_ellipse": mass_within(posterior, laplace.gaussian, 0.9),
        "sd_ratio": (np.sqrt(np.diag(laplace.covariance)) / posterior.sd).tolist(),
    }


def _nearest(field: LikelihoodField, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
    """Return the field at the grid points next to `points`."""
    i = np.abs(field.x[:, None] - points[:, 0]).argmin(axis=0)
    j = np.abs(field.y[:, None] - points[:, 1]).argmin(axis=0)
    return np.asarray(field.values[i, j])


def _correlation(covariance: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def _point(values: Float[np.ndarray, "2"]) -> dict[str, float]:
    return {"E": float(values[0]), "nu": float(values[1])}
