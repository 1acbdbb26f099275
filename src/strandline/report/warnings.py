"""Warnings about a finished calibration."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from strandline.calibration import Calibration, steps_of, unlikely_errors
from strandline.design import FieldOutcome, SetAside, says_whether_runs_succeed
from strandline.discrepancy import NormalOffset
from strandline.foundations import inputs_text
from strandline.interface import Interface, UnknownErrors
from strandline.likelihood import noise_length, sd_of_distances
from strandline.parameters import Parameter
from strandline.posterior import MarginalPosterior, Posterior, QuadratureResult, mixture, prior_conflicts
from strandline.report.html import number, said
from strandline.runs import EXCLUDED, RunRecord
from strandline.surrogate import learn_feasibility, stopped_early

BOUND_SHARE = 0.02
"""A bound counts as touched if the outer 2 % of the box hold more than `BOUND_MASS` of the posterior."""
BOUND_MASS = 0.01
MANY_BOUNDS = 3
"""Number of ends of the box from which one sentence reports all of them."""
LOO_LIMIT = 0.5
"""Error of left-out runs near the mode, in units of log-likelihood, above which the posterior's shape is in doubt."""
ABOVE_ZERO = 1.0
"""A surrogate whose log-likelihood exceeds its bound 0 by more than this is wrong where it matters."""
ESS_SHARE = 0.1
QUADRATURE_MEAN, QUADRATURE_SD = 0.05, 0.05
FAILED_SHARE = 0.3
ERRS = 0.5
"""Probability of an error of the model from which it is worth a warning."""
STEPS = 0.5
"""Steps of the output, in the noise of a point, from which there is a warning. Measured with 41 and 401 points, three
seeds, four shapes: up to 0.5, means were off by at most 0.13 sd and widths by 6 %; at 0.6, 0.2 sd and 16 %; at 1, 0.4
sd and 35 %; at 2.5, 2.6 sd. Of two significant digits, twelve studies: up to 0.8, means were off by up to 0.1 sd; from
1.6 on, by 0.13 to 0.6 sd and widths by up to 20 %."""
PATIENCE = 4.0
"""Time limit, in those of the slowest good run, above which a shorter one is suggested, of half of that."""
AT_THE_END = 0.02
"""Relative distance of the median of inferred noise from the end of its range that is worth a warning."""
NEARLY_SURE = 0.995
"""Probability from which it is not given as a number."""
CUT_TAIL = 0.05
"""Share of the cut reading below the smallest log-likelihood that a warning reports."""
NOTHING = 0.05
"""Information, nats, below which the posterior is the prior: an input whose sd the data narrow by a twentieth."""
MASS_CUT_TOLD = 1e-3
"""Share of a prior outside the design box above which the report says so."""
UNSURE = 0.5
"""Error of the interface, in units of the shift that the noise hides, above which a warning counts a nuisance value."""
TENFOLD = np.log(10.0)
"""Logarithm of a ratio of standard deviations above which the number itself says nothing."""
EFFECT = 0.25
"""Largest shift of a mean by the surrogate's variance, in standard deviations, without a warning."""
TOUCHED, HALF = 0.05, 0.5
"""Posterior mass where runs are likely to fail, above which a warning reports it; from which more runs do not help."""
LEARNT_FROM = 600
"""Last runs that tell where runs fail: all 1000 of the study's S3 took 4 s, not 0.6, for a mass of 0.003, not 0.006."""


_said = partial(said, page="warnings.txt.j2")


def find_warnings(calibration: Calibration, *, turned: Sequence[str] = ()) -> Iterator[str]:
    """Yield each doubt in words; nothing if all is well. `turned`: conditions observed from the other end."""
    yield from (_said("turned", condition=condition) for condition in turned)
    if calibration.no_field is not None:
        yield _said("no_field", why=calibration.no_field)
    yield from _fit(calibration)
    if calibration.field is None:
        if (highest := float(calibration.posterior.log_likelihood.max())) > ABOVE_ZERO:
            yield _said("impossible", highest=highest)
        yield from _surrogate(calibration)
        yield from likely_to_fail(_failing(calibration))
    else:
        yield from field_warnings(calibration, calibration.field)
    yield from _runs(calibration)
    yield from list(_in_steps(calibration)) or _stopped_early(calibration)  # rounded ends repeat their last value
    yield from _set_aside(calibration)
    yield from _prior(calibration)
    yield from _sampler(calibration)
    yield from _cut(calibration)
    yield from _bounds_of(calibration.posterior, "posterior")
    if (found := calibration.under_uncertainty) is not None:
        yield from _bounds_of(found.cut.extended, "cut reading", found.cut.names)
    chains = calibration.field is not None and calibration.field.by_chains
    if not (chains or calibration.laplace.definite):
        yield _said("no_laplace")


def reason_to_doubt(
    calibration: Calibration, check: Mapping[str, Any] | None = None, *, far: bool = False
) -> str | None:
    """Return in a few words why figures of the posterior must be marked; None if the posterior can be used.

    `check` is the content of check.json if it belongs to this posterior; `far`: no run comes near the observation.
    """
    by_field = calibration.field is not None
    certificate = calibration.certificate
    if not by_field and float(calibration.posterior.log_likelihood.max()) > ABOVE_ZERO:
        return "the surrogate predicts log-likelihoods above 0"
    if calibration.misfit is not None and calibration.misfit.flagged:
        return "the model does not explain what was observed"
    if far:
        return "no run comes near what was observed"
    if certificate is not None and not certificate.converged:
        return "not converged, " + certificate.reasons[-1] if certificate.reasons else "not converged"
    if check is not None and check["verdict"] == "bad":
        return "the check with the true model failed"
    if not by_field and (error := calibration.surrogate.validation.loo_rms_near_mode) > LOO_LIMIT:
        how = calibration.surrogate.left_out
        return f"its shape is in doubt, {how} error near the mode {number(error, 2)} in log-likelihood"
    return None


def _fit(calibration: Calibration) -> Iterator[str]:
    """Yield doubts about the fit, and about the noise and an error of the model if these were inferred."""
    misfit = calibration.misfit
    inferred = None if calibration.field is None else calibration.field.knowledge.likelihood.inferred
    if misfit is not None and misfit.flagged:
        measures = calibration.problem.discrepancies.values()
        able = calibration.field is not None and all(isinstance(one, NormalOffset) for one in measures)
        remedy = ", or let the model err: `model_error: true` in `noise`" if able else ""
        yield f"{misfit.verdict}{f' Find out what is wrong{remedy}.' if inferred is None else ''}"
    elif misfit is not None and misfit.flagged is None:
        yield misfit.verdict
    elif misfit is not None:
        yield from unlikely_errors(misfit)
    if inferred is None:
        return
    chance = inferred.posterior.probability_of_model_error
    if chance > ERRS:
        yield _said("model_error", chance=chance, sure=chance >= NEARLY_SURE)
    stated = next((seen.noise for seen in calibration.problem.observations), None)
    if isinstance(stated, UnknownErrors):
        yield from noise_at_an_end({k: one[0] for k, one in inferred.posterior.quantiles([0.5]).items()}, stated)


def noise_at_an_end(medians: Mapping[str, float], stated: UnknownErrors) -> Iterator[str]:
    """Yield a sentence for each parameter of inferred noise, `sd` or `length`, that its stated range holds back."""
    for name, words in {"sd": "sd", "length": "correlation length"}.items():
        given = getattr(stated, name)
        for end, value in zip(("lower", "upper"), given if isinstance(given, tuple) else (), strict=False):
            if abs(medians[name] / value - 1) < AT_THE_END:
                yield _said("noise_at_an_end", words=words, end=end, mm=value)


def _runs(calibration: Calibration) -> Iterator[str]:
    judged = [record for record in calibration.records if says_whether_runs_succeed(record)]
    failed = sum(not record.ok for record in judged)
    if failed > FAILED_SHARE * len(judged):
        yield _said("runs_failed", failed=failed, judged=len(judged))
    good, hung = ([one.seconds for one in calibration.all_runs if one.state == state] for state in ("ok", "timeout"))
    longest = max(good, default=math.inf)
    if hung and min(hung) > PATIENCE * longest:
        yield _said("runs_hung", hung=hung, longest=longest, timeout=math.ceil(PATIENCE / 2 * longest))


def _failing(calibration: Calibration) -> float:
    """Return the share of the posterior that lies where runs fail, learnt from which runs did."""
    judged = [record for record in calibration.records if says_whether_runs_succeed(record)]
    space, posterior = calibration.problem.space, calibration.posterior
    tried = np.array([[record.inputs[name] for name in space.names] for record in judged])
    z, drawn = (math.sqrt(12.0) * space.to_unit(x) for x in (tried, posterior.draws))
    known = learn_feasibility(z, np.array([record.ok for record in judged]), largest=LEARNT_FROM)
    below = known.log_probability(drawn) - known.log_probability(z).max()
    return 1.0 - float(posterior.weights @ np.exp(np.minimum(below, 0.0)))


def _stopped_early(calibration: Calibration) -> Iterator[str]:
    good = [record for record in calibration.records if record.ok]
    found = stopped_early([_observed(calibration, record) for record in good])
    if found:
        first, why = next(iter(found.items()))
        yield _said("stopped_early", found=len(found), good=len(good), **_run(good[first]), why=why)


def _run(record: RunRecord | SetAside) -> dict[str, str]:
    where = inputs_text(record.inputs)
    return {"key": record.key[:12], "where": where}


def _observed(calibration: Calibration, record: RunRecord) -> dict[str, Interface]:
    """Return the interfaces of a run that were observed: the others do not enter the posterior."""
    return {seen.condition: record.interfaces[seen.condition] for seen in calibration.problem.observations}


def _in_steps(calibration: Calibration) -> Iterator[str]:
    good, problem = [record for record in calibration.records if record.ok], calibration.problem
    inputs = np.array([[record.inputs[name] for name in problem.space.names] for record in good])
    field, measure = calibration.field, problem.measure
    known = problem.observations if field is None else field.knowledge.likelihood.known_observations
    for found in steps_of([_observed(calibration, record) for record in good], inputs):
        seen = next(one for one in known if one.condition == found.condition)
        noise = sd_of_distances(seen, measure, good[0].interfaces[found.condition]) or noise_length(seen, measure)
        if found.step > STEPS * noise:
            yield _said("in_steps", axis=found.axis, step=found.step, digits=found.digits, noises=found.step / noise)


def _set_aside(calibration: Calibration) -> Iterator[str]:
    """Yield a sentence on the runs that ended ok and were not used, and one on those excluded by hand."""
    for measure in dict.fromkeys(one.measure for one in calibration.set_aside):
        some = [one for one in calibration.set_aside if one.measure == measure]
        only = None if measure in (None, next(iter(calibration.problem.discrepancies))) else measure
        why = some[0].why.rstrip(".")
        yield _said("set_aside", number=len(some), measure=only, **_run(some[0]), why=why)
    excluded = [record for record in calibration.records if record.state == EXCLUDED]
    if excluded:
        yield _said("excluded", number=len(excluded), key=excluded[0].key[:12], message=excluded[0].message)


def _prior(calibration: Calibration) -> Iterator[str]:
    if calibration.posterior.information < NOTHING:
        yield _said("nothing_learnt")
    yield from prior_conflicts(calibration.posterior)
    for parameter in calibration.problem.space:
        if parameter.mass_cut > MASS_CUT_TOLD:
            (low, high), unit = parameter.interval, _of(parameter)
            yield _said("prior_cut", name=parameter.name, low=low, high=high, unit=unit, share=parameter.mass_cut)


def _surrogate(calibration: Calibration) -> Iterator[str]:
    validation, how = calibration.surrogate.validation, calibration.surrogate.left_out
    if validation.loo_rms_near_mode > LOO_LIMIT:
        error, runs = validation.loo_rms_near_mode, validation.near_mode_count
        centre = getattr(calibration.problem.measure, "quadrature", None) == "centre"
        yield _said("left_out_error", how=how, error=error, runs=runs, limit=LOO_LIMIT, centre=centre)


def _sampler(calibration: Calibration) -> Iterator[str]:
    particles, effective = calibration.settings.particles, min(calibration.sampling.ess, calibration.posterior.ess)
    if effective < ESS_SHARE * particles:
        yield _said("few_samples", effective=effective, particles=particles)
    halves = calibration.sampler_check
    if halves is not None and not halves.agree:
        yield halves.verdict
    exact, posterior = calibration.quadrature, calibration.posterior
    if exact is None:
        return
    if not exact.converged:
        yield "The quadrature that checks the sampler has not converged."
    mean_error, sd_error = _apart(posterior, exact)
    if mean_error > QUADRATURE_MEAN or sd_error > QUADRATURE_SD:
        yield _said("quadrature_differs", mean=mean_error, sd=sd_error, cut=False, converged=True)


def _apart(found: Posterior | MarginalPosterior, exact: QuadratureResult) -> tuple[float, float]:
    """Return the largest error of a mean, in standard deviations, and the largest relative one of these."""
    mean_error = float(np.max(np.abs(found.mean - exact.mean) / exact.sd))
    return mean_error, float(np.max(np.abs(found.sd / exact.sd - 1.0)))


def _cut(calibration: Calibration) -> Iterator[str]:
    """Yield doubts about the cut reading: it needs the surrogate where the likelihood is small, too."""
    found = calibration.under_uncertainty
    if found is None or calibration.field is not None:
        return
    cut, validation = found.cut, calibration.surrogate.validation
    values = cut.extended.log_likelihood + cut.log_evidence[cut.value_index]
    lowest = float(np.quantile(values, CUT_TAIL, weights=cut.extended.weights, method="inverted_cdf"))
    above = validation.near_mode | (next(iter(calibration.log_likelihoods.values())) >= lowest)
    error = float(np.sqrt(np.mean(validation.residuals[above] ** 2)))
    if error > max(LOO_LIMIT, validation.loo_rms_near_mode):
        yield _said("cut_tail", lowest=lowest, runs=int(above.sum()), how=calibration.surrogate.left_out, error=error)
    if calibration.cut_quadrature is None:
        return
    exact = mixture(calibration.cut_quadrature)
    mean_error, sd_error = _apart(cut, exact)
    if not exact.converged or mean_error > QUADRATURE_MEAN or sd_error > QUADRATURE_SD:
        yield _said("quadrature_differs", mean=mean_error, sd=sd_error, cut=True, converged=exact.converged)


def _bounds_of(posterior: Posterior, called: str, names: Sequence[str] | None = None) -> Iterator[str]:
    touched = [end for end in _touched(posterior) if names is None or end["name"] in names]
    if len(touched) >= MANY_BOUNDS:
        yield _said("bounds", called=called, ends=touched)
    else:
        yield from (_said("bound", called=called, one=one) for one in touched)


def _touched(posterior: Posterior) -> Iterator[dict[str, Any]]:
    """Yield the ends of the box that the posterior reaches: input, lower or upper, bound, mass next to it."""
    unit = posterior.space.to_unit(posterior.draws)
    for i, parameter in enumerate(posterior.space):
        sides = {"lower": unit[:, i] < BOUND_SHARE, "upper": unit[:, i] > 1.0 - BOUND_SHARE}
        for (side, touching), bound in zip(sides.items(), parameter.interval, strict=True):
            mass = float(posterior.weights @ touching)
            if mass > BOUND_MASS:
                yield {"name": parameter.name, "side": side, "bound": bound, "unit": _of(parameter), "mass": mass}


def _of(parameter: Parameter) -> str:
    """Return a space and the unit, to follow a number; empty for a pure number."""
    return "" if parameter.unit in ("", "1") else f" {parameter.unit}"


def field_warnings(calibration: Calibration, found: FieldOutcome) -> Iterator[str]:
    """Yield one sentence per doubt."""
    certificate, surrogate = found.certificate, found.knowledge.surrogate
    if certificate is not None and not certificate.converged:
        scattered, failing = bool(certificate.scattered), 1.0 - found.feasible >= HALF
        misfit = calibration.misfit is not None and bool(calibration.misfit.flagged)
        yield _said("not_converged", reasons=certificate.reasons, scattered=scattered, misfit=misfit, failing=failing)
    if certificate is not None and certificate.overlooks:
        yield _said("overlooks", statement=certificate.statement)
    shift, ratio = float(np.abs(found.effect.shift).max()), float(np.abs(np.log(found.effect.sd_ratio)).max())
    if max(shift, ratio) > EFFECT:
        yield _said("uncertain_surrogate", shift=shift, sd=float(np.expm1(ratio)) if ratio < TENFOLD else None)
    yield from likely_to_fail(1.0 - found.feasible)
    late = sum(record.ok for record in calibration.records) - int(found.knowledge.ok.sum())
    if late and not (certificate is not None and certificate.drawn):  # its proposals are answered, not learnt from
        yield _said("late", number=late)
    checked = None if certificate is None or certificate.checked is None else certificate.checked.check
    if checked is not None and checked.failed:
        yield _said("failed_check", failed=checked.failed, draws=checked.draws)
    yield from _unsure_cut(calibration, found)
    if certificate is not None and certificate.fidelities is not None and certificate.fidelities.dropped is not None:
        yield _said("cheaper_dropped", why=certificate.fidelities.dropped)
    if surrogate.registration_error > surrogate.modes.remainder and surrogate.registration_error > 0:
        ways = [way for way in surrogate.ways if way != "nodes"]
        yield _said("registered", ways=ways, error=surrogate.registration_error)


def likely_to_fail(share: float) -> Iterator[str]:
    """Yield a sentence if a share worth mentioning of the posterior lies where runs are likely to fail."""
    if share > TOUCHED:
        yield _said("likely_to_fail", share=share)


def _unsure_cut(calibration: Calibration, found: FieldOutcome) -> Iterator[str]:
    """Yield a warning if the cut reading goes where there are few runs: they were chosen for the joint reading."""
    if calibration.under_uncertainty is None:
        return
    cut, measure = calibration.under_uncertainty.cut, calibration.problem.measure
    hidden = min(noise_length(seen, measure) for seen in found.knowledge.likelihood.known_observations)
    errors = found.knowledge.surrogate.predicted_error(cut.extended.draws)
    of_value = np.array([np.median(errors[cut.value_index == k]) for k in range(len(cut.values))])
    unsure = of_value > UNSURE * hidden
    if (number_of := int(unsure.sum())) > 0:
        yield _said("unsure_cut", unsure=number_of, values=len(cut.values), error=float(of_value.max()), hidden=hidden)
