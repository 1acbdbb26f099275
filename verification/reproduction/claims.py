"""The ten claims of the study, each judged by numbers (Willmann et al. 2022): C1 to C8 two inputs, C9 and C10 parts."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction import judgement
from verification.reproduction.grid_posterior import GridPosterior, Reading
from verification.reproduction.judgement import Claim, LikelihoodField, Verdict, distance_to_prior

from strandline.calibration import Calibration
from strandline.posterior import Posterior, histogram_mode
from strandline.runs import RunRecord

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
STUDY_MAP = {"E1": 345.0, "nu1": 0.43, "E2": 135.0, "nu2": 0.30, "E3": 1034.0, "nu3": -0.47}
STUDY_MEAN = {"E1": 443.0, "nu1": -0.15, "E2": 431.0, "nu2": -0.13, "E3": 637.0, "nu3": -0.14}
INFORMED = 0.2
"""Total variation to the prior above which the data inform an input; a triangle on a uniform prior has 0.25."""
LITTLE = 0.1
"""Relative fall of the error that counts as no significant improvement."""


def ridge_and_peak(
    fields: Mapping[str, LikelihoodField], truth: Sequence[float], posterior: Posterior, spacing: Sequence[float]
) -> Claim:
    """Judge C1 by the shape of the likelihood under each measure; `spacing` is the mean distance of design points."""
    field = fields[CURRENTS]
    off = {name: [abs(p - t) for p, t in zip(f.peak, truth, strict=True)] for name, f in fields.items()}
    ridge = field.ridge
    extent = float(np.ptp(ridge))
    bend = float(np.abs(ridge - np.linspace(ridge[0], ridge[-1], len(ridge))).max())
    correlation = float(posterior.covariance[0, 1] / np.sqrt(np.diag(posterior.covariance)).prod())
    ratio = judgement.correlation_ratio(posterior, "E", given="nu")
    at_truth = all(d <= s for distances in off.values() for d, s in zip(distances, spacing, strict=True))
    curved = bend > max(BENT * extent, 2 * float(np.diff(field.x).max()))  # more than what the grid rounds
    return Claim(
        "C1",
        "The likelihood is a curved ridge that couples E and ν, and its peak is at the ground truth.",
        (5, 6),
        "confirmed" if at_truth and curved and ratio >= COUPLED else "refuted",
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
    statement = "Forward runs fail at low E only, where the likelihood is nearly zero."
    failed = np.array([[record.inputs[name] for name in names] for record in records if not record.ok])
    if not len(failed):
        words = f"None of {len(records)} runs failed."
        return Claim("C3", statement, (5, 6, 7), "differs", words, {"failed": 0, "runs": len(records)})
    kinds = Counter(record.failure_kind or record.state for record in records if not record.ok)
    share = {name: float(np.exp(f.at(failed).max() - f.values.max())) for name, f in fields.items()}
    low, high = float(fields[CURRENTS].x[0]), float(failed[:, 0].max())
    softest = (high - low) / float(np.ptp(fields[CURRENTS].x))
    fold = " The reason is not the mesh: beyond a fold of the Saint-Venant–Kirchhoff law no steady state exists."
    return Claim(
        "C3",
        statement,
        (5, 6, 7),
        "confirmed" if max(share.values()) < NEGLIGIBLE and softest < 1 / 3 else "refuted",
        f"{len(failed)} of {len(records)} runs failed ({', '.join(f'{kind}: {n}' for kind, n in kinds.most_common())})"
        f", at E up to {high:.0f} Pa, {100 * softest:.0f} % of the way through its interval. The highest likelihood "
        f"that a surrogate puts at one of them is {max(share.values()):.1g} of its maximum."
        + (fold if set(kinds) <= FOLDS else ""),
        {"failed": len(failed), "runs": len(records), "by_kind": dict(kinds)}
        | {"highest_E_of_a_failed_run": high, "likelihood_there": share},
    )


def training_size(
    distance: Mapping[str, Mapping[int, float]],
    best: Mapping[str, Mapping[int, Sequence[float]]],
    truth: Sequence[float],
) -> Claim:
    """Judge C4: from 200 runs on, the posterior stays near the truth, and the estimate at 200 runs is good.

    `distance` is the total variation to the posterior of the true model, `best` the inputs of maximum likelihood, both
    by quadrature rule and number of runs. Without a design larger than about 200 runs, what more bring is not known.
    """
    centre, refined = distance["centre"], distance["refined"]
    numbers = sorted(centre)
    at = min(numbers, key=lambda n: abs(n - 200))
    last = numbers[-1]
    good_from = {rule: _good_from(d) for rule, d in distance.items()}
    since = {rule: runs or f"more than {last}" for rule, runs in good_from.items()}
    (e, nu), (finer_e, finer_nu) = best["centre"][at], best["refined"][at]
    shape = good_from["centre"] is not None and good_from["centre"] <= at
    estimate = all(abs(b - t) <= near for b, t, near in zip(best["centre"][at], truth, AGREES, strict=True))
    return Claim(
        "C4",
        "200 training points give the shape and a good maximum-likelihood estimate; more bring little.",
        (8,),
        "differs" if at == last else "confirmed" if shape and estimate else "refuted",
        f"With the centre rule the posterior from {at} runs is {centre[at]:.2f} in total variation from that of the "
        f"true model, from {last} runs {centre[last]:.2f}; it stays within {GOOD:g} from {since['centre']} runs on. "
        f"With the refined quadrature it is {refined[at]:.2f} at {at} runs, and within {GOOD:g} from "
        f"{since['refined']} runs on. The maximum-likelihood estimate at {at} runs is ({e:.0f} Pa, {nu:.2f}), refined "
        f"({finer_e:.0f} Pa, {finer_nu:.2f}); the truth is ({truth[0]:.0f} Pa, {truth[1]:.2f})."
        + (" No design is larger: what more runs bring is not known." if at == last else ""),
        {
            "total_variation": {rule: {str(n): d[n] for n in numbers} for rule, d in distance.items()},
            "maximum_likelihood": {rule: {str(n): list(b[n]) for n in numbers} for rule, b in best.items()},
            "runs_to_total_variation_0.1": good_from,
        },
        {"runs": 200, "ground_truth": list(truth)},
    )


def uniform_prior(posterior: Posterior, refined: Posterior) -> Claim:
    """Judge C5 by posteriors under the uniform prior with the centre rule and the refined quadrature."""
    peaks, flat = judgement.modes(posterior, "E"), {n: judgement.plateau(posterior, n) for n in ("E", "nu")}
    wide = {n: judgement.plateau(refined, n) for n in ("E", "nu")}
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
    (angle, inside), (finer, finer_inside) = (
        (found[rule]["angle_deg"], 100 * found[rule].get("mass_in_its_90_%_ellipse", 0.0))
        for rule in ("centre", "refined")
    )
    verdict: Verdict = "differs"
    if angle is None:
        words = "With the centre rule the Hessian is indefinite: there is no approximation at all."
    else:
        verdict = "confirmed" if angle >= FAR else "differs" if inside < 50 else "refuted"
        words = (
            f"With the centre rule its main axis is {angle:.0f}° off the posterior's (in standardised inputs), and its "
            f"90 % ellipse holds {inside:.0f} % of the posterior."
        )
    words += (
        " With the refined quadrature the Hessian is indefinite."
        if finer is None
        else f" With the refined quadrature it is {finer:.0f}° off and the ellipse holds {finer_inside:.0f} %."
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
    uncertain: Mapping[str, Any], truth: Mapping[Reading, GridPosterior], known: GridPosterior
) -> Claim:
    """Judge C8 by the true model with the inflow uncertain, in both readings, and known; the surrogate's figures too.

    `uncertain` is the entry `under_uncertainty` of the study's summary.
    """
    exact = truth["joint"]
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
        },
        {"map": {"E": 322.0, "nu": 0.09}, "mean": {"E": 416.0, "nu": -0.09}},
    )


def heterogeneous(posterior: Posterior, checks: Mapping[str, Mapping[str, Any]], truth: Mapping[str, float]) -> Claim:
    """Judge C9 by the marginals and by the check of the posterior with the true model.

    A marginal gathers around the truth if it is not broad and is denser there than its prior. The claim holds if E2 and
    ν2 gather and no other input does; the study does not say whether ν1 stays broad. If the check finds the posterior
    unreliable, it does not show what the data say, and the claim is neither confirmed nor refuted.

    `checks` has the content of check.json by study: first that of this posterior, then others to compare with.
    """
    names = list(STUDY_MAP)
    shift = {name: distance_to_prior(posterior, name) for name in names}
    ranked = sorted(names, key=lambda n: -shift[n])
    denser = {name: judgement.density_over_prior(posterior, name, truth[name]) for name in names}
    gathered = [name for name in ranked if shift[name] >= INFORMED and denser[name] > 1]
    broad = all(shift[name] < INFORMED for name in ("E1", "E3", "nu3"))
    holds = ranked[0] == "E2" and set(gathered) == {"E2", "nu2"} and broad
    bounds = [posterior.space[name].interval for name in names]
    mode = histogram_mode(posterior.columns(names), posterior.weights, bounds=bounds, bins=10)
    mean = posterior.weights @ posterior.columns(names)
    first, k_hat = next(iter(checks.values())), {name: c["k_hat"] for name, c in checks.items()}
    median, expected = (float(np.median(first["particles"][which])) for which in ("true", "surrogate"))
    believed = first["verdict"] != "bad"
    can = "can be used." if believed else "is not the true one."
    verdict: Verdict = ("confirmed" if holds else "refuted") if believed else "differs"
    return Claim(
        "C9",
        "Of six material parameters E2, that of the largest part, dominates; only E2 and ν2 gather around the truth.",
        (13, 14, 15),
        verdict,
        "By total variation between marginal and prior the order is "
        + ", ".join(f"{name} {shift[name]:.2f}" for name in ranked)
        + f". {' and '.join(gathered) or 'None'} gather around the truth: at least {INFORMED:g}, and denser there than "
        f"the prior (E2 {denser['E2']:.1f} times, nu2 {denser['nu2']:.1f} times). At draws of this posterior the "
        f"surrogate puts log L at {expected:.1f} in the median, the true model at {median:.1f}; "
        f"k̂ = {first['k_hat']:.2f}, so that the surrogate's posterior {can}"
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
    """Judge C10 by the fall of the surrogate's errors, the study's case first, from about 1000 runs to the most."""
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
        f"{errors[name][-1]:.3f} at {numbers[-1]}, by {-100 * gain:+z.0f} %"
        + "".join(f"; {other}: {-100 * g:+z.0f} %" for other, g in list(gains.items())[1:])
        + (". No training set is larger: what more runs bring is not known." if alone else ".")
        + " A plateau of this error does not mean that the surrogate is good enough: see the check of the posterior.",
        {"runs": list(numbers), "errors": {n: list(v) for n, v in errors.items()}, "fall": gains},
    )


def _fall(before: float, after: float) -> float:
    """Return the relative fall of an error, negative for a rise; 0 for an error of 0, which cannot fall."""
    return 1.0 - after / before if before > 0 else 0.0


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
        "angle_deg": judgement.angle_between_axes(laplace.covariance, posterior.covariance, width),
        "mass_in_its_90_%_ellipse": judgement.mass_within(posterior, laplace.gaussian, 0.9),
        "sd_ratio": (np.sqrt(np.diag(laplace.covariance)) / posterior.sd).tolist(),
    }


def _point(values: Float[np.ndarray, "2"]) -> dict[str, float]:
    return {"E": float(values[0]), "nu": float(values[1])}
