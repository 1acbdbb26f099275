"""Whether the model explains the observations: residuals of the best fit among those that the noise causes.

The best fit minimises rᵀ C⁻¹ r over the inputs, with signed distances r of the observed points from the predicted
interface and the covariance C of their errors. The same minimum for drawn observations gives a p-value that is
uniform if the model is right, whatever the inputs. Parts of the arc show where a wrong model fails; their p-values
are corrected for their number. Slow waves along the arc are what a wrong model leaves most often. d² of the measure
behind the posterior is compared with posterior-predictive draws.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from strandline import discrepancy
from strandline.calibration import best_fit as fits
from strandline.calibration.best_fit import ArcParts, BestFit, Prediction, Residuals, Statistics
from strandline.calibration.misfit import ConditionMisfit, Effort, Misfit, Region, verdict_on, with_fitted_noise
from strandline.foundations import StrandlineError, listed
from strandline.interface import GLOBAL, GaussianNoise, Interface, Observation, arc_lengths, steady_normals
from strandline.likelihood import Compared, Registered, StatedErrors, compared, noise_of_residuals, noise_on_surface
from strandline.posterior import Posterior

FEW_DRAWS = 32  # most draws of the posterior for surfaces, which are compared one by one; too few to flag a model
SYMMETRIC = (discrepancy.Currents, discrepancy.TrackedPoints)
"""Measures in which both interfaces can change places: many drawn observations are compared at once."""
FULL = Effort()
FAILURES = StrandlineError, ArithmeticError, ValueError
STREAM = 5  # keeps these random numbers apart from all others of the same seed
NOTICED = 0.1  # model error, in standard deviations of the noise, below which the verdict does not mention it
Drawn = Float[np.ndarray, "draw point"]
_ONE_SIDE = 0.5  # least length of the mean unit normal of a part of an arc that lies on one side of the prediction


def predictive_shares(
    residuals: Residuals,
    fit: BestFit,
    prediction: Prediction,
    posterior: Posterior,
    random: np.random.Generator,
    most: int,
) -> tuple[float, tuple[float, ...]]:
    """Return the posterior-predictive p-values of d², of all observations and of each, from at most `most` draws.

    At each draw θ of the posterior, d² of the observation is compared with d² of one drawn at θ (Gelman, Meng and Stern
    1996). Its errors do not depend on the inputs, so all are drawn on the interface that the best fit predicts. The
    posterior has seen the observation: these p-values are conservative, near ½ more often than not.
    """
    observations, measure, templates = residuals.observations, residuals.measure, prediction.templates
    slow = any(seen.interface.dim == 3 for seen in observations) and not isinstance(measure, discrepancy.NormalOffset)
    draws = min(FEW_DRAWS, most) if slow else most
    points, at_fit = prediction.points(posterior.equally_weighted(random, draws)), prediction.points(fit.at[None])
    noise = residuals.drawn(draws, random)
    fields = random.standard_normal((draws, fit.by_modes.shape[1])) @ fit.by_modes.T
    observed, drawn = [], []
    for seen, stated, part in zip(observations, residuals.stated, residuals.parts, strict=True):
        template = templates[seen.condition]
        how = compared(seen, measure, len(template.points))
        if isinstance(one := how.measure, Registered):  # drawn observations contain global errors too
            how = Compared(seen, one.measure, GaussianNoise(one.variance))
        predicted = Interface(at_fit[seen.condition][0], template.cells)
        true = discrepancy.squared_discrepancies(how.measure, points[seen.condition], template, seen.interface)
        others = _drawn(how, stated, predicted, noise[:, part], fields[:, part], random)
        observed.append(-2 * how.noise.log_density(true))
        drawn.append(-2 * how.noise.log_density(others))
    both = np.sum(observed, axis=0), np.sum(drawn, axis=0)
    shared = discrepancy.shared_errors(observations, measure)
    if shared is not None:
        both = shared.many(points, templates), shared.model.square(noise + fields)
    each = (float(fits.tail(others, true)) for true, others in zip(observed, drawn, strict=True))
    return float(fits.tail(both[1], both[0])), tuple(each)


def _drawn(
    how: Compared, stated: StatedErrors, predicted: Interface, noise: Drawn, fields: Drawn, random: np.random.Generator
) -> Float[np.ndarray, " draw"]:
    """Return d² of drawn observations, from their residuals alone if the measure depends on nothing else.

    `noise` and `fields` are drawn errors of the points and of the surrogate along the normals, mm.
    """
    measure, seen = how.measure, how.observation.interface
    if isinstance(measure, discrepancy.WhitenedOffset):
        return measure.model(seen).square(noise + fields)
    if isinstance(measure, discrepancy.NormalOffset):
        return np.asarray(((noise + fields) ** 2).sum(axis=1))
    tracked = isinstance(measure, discrepancy.TrackedPoints)
    without = predicted if tracked else discrepancy.closest_points(seen.points, predicted)
    points = without.points + _displacements(seen, stated, len(noise), random)
    if fields.any():
        points += fields[..., None] * steady_normals(seen)
    if isinstance(measure, SYMMETRIC):
        return discrepancy.squared_discrepancies(measure, points, seen, predicted)
    return np.array([measure(predicted, Interface(row, seen.cells)) for row in points], float)


def _displacements(
    seen: Interface, stated: StatedErrors, number: int, random: np.random.Generator
) -> Float[np.ndarray, "draw point xyz"]:
    """Return errors of the observed points, mm: independent ones of all coordinates if only σ_N² is stated."""
    if stated.assumed:
        return stated.errors.sd * random.standard_normal((number, *seen.points.shape))
    return np.asarray([stated.errors.draw(seen, random).points for _ in range(number)] - seen.points)


def misfit_of(
    prediction: Prediction,
    observations: Sequence[Observation],
    measure: discrepancy.Discrepancy,
    posterior: Posterior,
    *,
    fixed: Sequence[str] = (),
    explained: Float[np.ndarray, "seen cause"] | None = None,
    fitted: bool = False,
    effort: Effort = FULL,
    seed: int,
) -> Misfit:
    """Return whether the model explains the observations; if that cannot be computed, the verdict says why.

    `measure` is the d² behind the posterior, `fixed` are names of the known inputs. `explained` is what errors of the
    model that were allowed for do to the residuals, mm; None if there are none. `fitted` tells whether sd and length of
    the observations' errors were inferred from these residuals.
    """
    space = posterior.space
    unseen = invisible(observations, space.shown, fixed)
    random = np.random.default_rng([seed, STREAM])
    try:
        residuals = Residuals.of(observations, measure, prediction.templates, explained)
        fit, parts = fits.best_fit(residuals, prediction, posterior), fits.parts_of(observations)
        parts = replace(parts, waves=fits.beyond(parts.waves, fit.by_inputs, fit.with_modes(residuals.model)))
        seen = fits.observed_statistics(residuals, fit, parts)
        drawn = fits.drawn_statistics(residuals, fit, parts, random, effort)
        predictive, of_each, failed = 1.0, (1.0,) * len(observations), list[str]()
        try:
            predictive, of_each = predictive_shares(residuals, fit, prediction, posterior, random, effort.predictive)
        except FAILURES as error:
            failed = [f"d² of drawn observations could not be computed: {' '.join(str(error).split())}"]
        conditions = _conditions(residuals, fit, parts, seen, drawn, None if failed else of_each)
        p_value, smooth_p = float(fits.tail(drawn.whole, seen.whole)), fits.waves_p(drawn.waves, seen.waves)
        shares = p_value, predictive, 1.0 if smooth_p is None else smooth_p
        verdict = verdict_on(*shares, conditions, run_alone=prediction.run_alone)
        if fitted:
            verdict = with_fitted_noise(verdict, observations)
        notes, text = (*_notes(residuals, prediction, conditions), *failed, unseen), verdict.text
        if _model_errs(residuals, explained):
            text = f"With an error of the model allowed for, {text[0].lower()}{text[1:]}"
        return Misfit(text, verdict.flagged, p_value, None if failed else predictive, smooth_p, conditions, notes)
    except FAILURES as error:
        why = " ".join(str(error).split())
        return Misfit(f"Whether the model explains the observation was not computed: {why}", None, notes=(unseen,))


def _conditions(
    residuals: Residuals,
    fit: BestFit,
    parts: ArcParts,
    seen: Statistics,
    drawn: Statistics,
    predictive: Sequence[float] | None,
) -> tuple[ConditionMisfit, ...]:
    """Return the residuals of each observation, global errors and errors of the surrogate removed: D (C + FFᵀ)⁻¹ r."""
    weighted = fit.with_modes(residuals.model).solved(fit.residuals)
    local, shares = residuals.model.local * weighted, fits.tail(drawn.conditions, seen.conditions)
    regions = _regions(residuals, local, parts, seen, drawn)
    removed = residuals.joint.sizes(residuals.model.shared.T @ weighted)
    found = []
    for k, (one, stated) in enumerate(zip(residuals.observations, residuals.stated, strict=True)):
        interface, mine = one.interface, local[residuals.parts[k]]
        line = interface.dim == 2
        found.append(
            ConditionMisfit(
                condition=one.condition,
                arc_length=arc_lengths(interface) if line else np.arange(len(mine), dtype=float),
                residual=mine,
                stated=stated,
                expected=stated.noise_along(interface),
                found=noise_of_residuals(mine, interface) if line else noise_on_surface(mine, interface),
                p_value=float(shares[k]),
                predictive_p=None if predictive is None else predictive[k],
                regions=tuple(r for r, span in zip(regions, parts.spans, strict=True) if span.observation == k),
                removed=removed[k],
                surface=not line,
            )
        )
    return tuple(found)


def _regions(
    residuals: Residuals, local: Float[np.ndarray, " seen"], parts: ArcParts, seen: Statistics, drawn: Statistics
) -> list[Region]:
    """Return the parts of the arcs and the patches, with corrected p-values of their mean and their sum of squares."""
    by_squares, by_mean = (fits.tail(drawn.squares, seen.squares), fits.tail(np.abs(drawn.means), np.abs(seen.means)))
    p_values = fits.corrected(np.concatenate([by_squares, by_mean])).reshape(2, -1).min(axis=0)
    chosen = sorted({span.observation for span in parts.spans if span.centre is None})
    normals = {k: steady_normals(residuals.observations[k].interface) for k in chosen}
    found = []
    for j, span in enumerate(parts.spans):
        mine = parts.members[:, j] > 0
        mean, rms = float(seen.means[0, j]), float(np.sqrt(np.mean(local[mine] ** 2)))
        excess = abs(mean) / float(drawn.means[:, j].std())
        if abs(mean) < 0.5 * rms:
            excess = float(np.sqrt(seen.squares[0, j] / drawn.squares[:, j].mean()))
        if span.centre is None:
            normal = normals[span.observation][mine[residuals.parts[span.observation]]].mean(axis=0)
            side = _side(np.sign(mean) * normal)
        else:
            side = "outside" if mean > 0 else "inside"
        found.append(Region(span.begin, span.end, mean, rms, side, excess, float(p_values[j]), span.centre))
    return found


def _side(towards: Float[np.ndarray, "2"]) -> str:
    """Return where a mean normal points, in words; nothing if the normals point everywhere."""
    if np.linalg.norm(towards) < _ONE_SIDE:
        return ""
    x, y = towards.tolist()
    if abs(y) >= abs(x):
        return "above" if y > 0 else "below"
    return "to the right of" if x > 0 else "to the left of"


def _notes(residuals: Residuals, prediction: Prediction, conditions: Sequence[ConditionMisfit]) -> list[str]:
    found = [f"The interface was predicted by {prediction.source}."]
    if prediction.run_alone:
        found.append("Its inputs are not those of the best fit, so the p-values are lower bounds.")
    assumed = sorted({f"{1e3 * one.errors.sd:.3g} µm" for one in residuals.stated if one.assumed})
    if assumed:
        found.append(
            "Only σ_N² of the measure is stated: independent errors of the points that have the same σ_N², with a "
            f"standard deviation of {' or '.join(assumed)}, stand for the noise."
        )
    found += [_removed(one) for one in conditions if one.removed]
    if residuals.model.shared[:, residuals.joint.model.shared.shape[1] :].any():
        found.append("The most probable model error was removed from the residuals.")
    return found


def _removed(one: ConditionMisfit) -> str:
    shift, offset = (", ".join(f"{1e3 * v:.3g}" for v in one.removed.get(name, ())) for name in ("shift", "offset"))
    said = {
        "shift": f"shift ({shift}) µm",
        "rotation": "rotation " + ", ".join(f"{v:.2g}°" for v in one.removed.get("rotation", ())),
        "scale": "scale " + "".join(f"{100 * v:+.2g} %" for v in one.removed.get("scale", ())),
        "offset": f"offset {offset} µm",
    }
    names = [said[name] for name in GLOBAL if name in one.removed]
    of = f" of condition {one.condition}" if one.condition else ""
    were = "was" if len(names) == 1 else "were"
    return f"The most probable {listed(names, 'and')}{of} {were} removed from the residuals."


def _model_errs(residuals: Residuals, explained: Float[np.ndarray, "seen cause"] | None) -> bool:
    """Return whether an error of the model was allowed for that is not negligible."""
    size = 0.0 if explained is None else float(np.sqrt(np.mean((explained**2).sum(axis=1))))
    noise = float(np.sqrt(np.mean([one.errors.sd**2 for one in residuals.stated])))
    return size > NOTICED * noise


def invisible(observations: Sequence[Observation], names: Sequence[str], fixed: Sequence[str]) -> str:
    """Return which errors no residual can show, in two sentences."""
    scaled = all(seen.known and seen.known.scale > 0 for seen in observations)
    known = ", ".join([*(fixed or ("a load", "an inflow")), "a density or any other factor"])
    scale = "" if scaled else ", or most of a wrong picture scale"
    return (
        f"Residuals cannot reveal an error that {listed(names, 'or')} can compensate for: a wrong value of "
        f"{known}{scale}. Such an error shifts the posterior without worsening the fit."
    )
