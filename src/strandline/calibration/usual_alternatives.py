"""The alternatives that a reader would ask about first: other priors, other noise, other measures, fewer data."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

from strandline import parameters
from strandline.calibration.what_if import Alternative, Baseline, Kind
from strandline.discrepancy import Discrepancy, NormalOffset
from strandline.interface import GLOBAL, GaussianNoise, Noise, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood, InferredNoise

LEAST_SHAPE_SUM = 1.0  # a + b of a beta distribution below which it piles up at both ends
LEVELS = (0.1587, 0.5, 0.8413)  # probabilities at a normal distribution's mean and one sd on either side
LENGTHS = ("point_sd", "least_point_sd", "largest_point_sd", "correlation_length", "shift_sd", "offset_sd")
"""Parameters of the noise that are lengths, mm."""
Errors = Noise | PointErrors | UnknownErrors


def usual_alternatives(now: Baseline, measures: Mapping[str, Discrepancy]) -> Iterator[Alternative]:
    """Yield the usual alternatives to a study; the first of its measures makes the present posterior.

    The priors of a field's coefficients stay: they mean little each.
    """
    yield from _priors(now.space)
    yield from _fixed(now.space)
    if now.knowledge is not None:
        likelihood = now.knowledge.likelihood
        for name, kind, about, other in (*_other_noise(likelihood), *_other_data(likelihood, measures)):
            detail = facts_of(other) if kind == "noise" else ""
            yield Alternative(name, kind, about, now.space, other, detail=detail, by_prior_alone=False)


def other_priors(parameter: parameters.Parameter) -> Iterator[tuple[str, parameters.Prior]]:
    """Yield other priors of an input, with what they are in words: narrower, wider, flat, flat in the logarithm."""
    low, high = parameter.interval
    prior = parameter.prior
    for words, factor in (("half as wide", 0.5), ("twice as wide", 2.0)):
        if (other := _scaled(prior, factor)) is not None:
            yield words, other
    if prior != parameters.Uniform(low, high):
        yield "flat in its box", parameters.Uniform(low, high)
    if low > 0 and prior != parameters.LogUniform(low, high):
        yield "flat in its logarithm", parameters.LogUniform(low, high)


def with_prior(space: parameters.ParameterSpace, priors: Mapping[str, parameters.Prior]) -> parameters.ParameterSpace:
    """Return the inputs with other priors, by name, truncated to the same box."""
    changed = {name: replace(space[name], prior=prior, box=space[name].interval) for name, prior in priors.items()}
    return replace(space, parameters=tuple(changed.get(one.name, one) for one in space))


def scaled_noise(noise: Errors, factor: float) -> Errors | None:
    """Return noise whose standard deviation is `factor` times as large; errors that all points share stay the same.

    Of noise that is inferred, the standard deviation must be known; None if there is no such noise.
    """
    if isinstance(noise, GaussianNoise):
        return GaussianNoise(factor**2 * noise.variance)
    if isinstance(noise, PointErrors):
        return replace(noise, sd=factor * noise.sd)
    if isinstance(noise, UnknownErrors) and isinstance(noise.sd, float):
        return replace(noise, sd=factor * noise.sd)
    return None


def prior_in_words(prior: parameters.Prior) -> str:
    """Return a prior as study.yaml has it: ``normal [350, 50]``; the representation of one that is not built in."""
    name = next((name for name, kind in parameters.PRIORS.items() if type(prior) is kind), None)
    if name is None:
        return repr(prior)
    return f"{name} [{', '.join(f'{value:.4g}' for value in vars(prior).values())}]"


def facts_of(likelihood: FieldLikelihood) -> str:
    """Return the parameters of the noise, by condition if they differ."""
    each = {
        seen.condition: ", ".join(_fact(name, value) for name, value in seen.noise.facts.items())
        for seen in likelihood.observations
    }
    if len(set(each.values())) == 1:
        return next(iter(each.values()))
    return "; ".join(f"{name}: {facts}" for name, facts in each.items())


def _fact(name: str, value: float) -> str:
    """Return a parameter of the noise with its unit: lengths, which errors of points have, in µm."""
    spoken = name.replace("_", " ")
    if name in LENGTHS:
        return f"{spoken} {1e3 * value:.4g} µm"
    if name in ("rotation_sd", "scale_sd"):
        return f"{spoken} {value:.4g}°" if name == "rotation_sd" else f"{spoken} {100 * value:.4g} %"
    return f"{spoken} {value:.4g}"


def _scaled(prior: parameters.Prior, factor: float) -> parameters.Prior | None:
    """Return a prior with the same centre and `factor` times the width; None if its bounds do not allow that.

    A uniform prior is a beta distribution with both shapes 1: half as wide, it is a bell between the same bounds.
    """
    if isinstance(prior, parameters.Normal):
        return parameters.Normal(prior.mean, factor * prior.sd)
    if isinstance(prior, parameters.LogNormal):
        return parameters.LogNormal(prior.mu, factor * prior.sigma)
    if isinstance(prior, parameters.Uniform):
        prior = parameters.ScaledBeta(1.0, 1.0, prior.low, prior.high)
    if isinstance(prior, parameters.ScaledBeta):
        whole = prior.a + prior.b
        other = (whole + 1) / factor**2 - 1
        share = other / whole
        possible = other > LEAST_SHAPE_SUM and min(prior.a * share, prior.b * share) >= min(1.0, prior.a, prior.b)
        return parameters.ScaledBeta(prior.a * share, prior.b * share, prior.low, prior.high) if possible else None
    below, middle, above = (float(prior.quantile(level)) for level in LEVELS)
    if isinstance(prior, parameters.LogUniform):
        return parameters.LogNormal(math.log(middle), factor * 0.5 * math.log(above / below)) if factor < 1 else None
    return parameters.Normal(middle, factor * 0.5 * (above - below))


def _priors(space: parameters.ParameterSpace) -> Iterator[Alternative]:
    for parameter in (one for one in space if one.of_field is None):
        for words, prior in other_priors(parameter):
            changed = with_prior(space, {parameter.name: prior})
            name, about = f"prior of {parameter.name} {words}", f"the prior of {parameter.name}"
            yield Alternative(name, "prior", about, changed, detail=prior_in_words(prior))


def _fixed(space: parameters.ParameterSpace) -> Iterator[Alternative]:
    """Yield each nuisance input as known: the median of its prior."""
    for i in space.nuisance:
        one = space.parameters[i]
        if any(one.name in pair for pair in space.correlation):  # the prior of the other one would change too
            continue
        median = float(f"{float(one.truncated_prior.quantile(0.5)):.4g}")
        name, about = f"{one.name} known to be {median:g}", f"what is known of {one.name}"
        yield Alternative(name, "fix", about, space, fixed={one.name: median})


def _other_noise(likelihood: FieldLikelihood) -> Iterator[tuple[str, Kind, str, FieldLikelihood]]:
    """Yield the noise, and each error that all points share, half and twice as large, with words; no model error."""
    common = [name for name in GLOBAL if any(getattr(o.noise, name, 0.0) > 0 for o in likelihood.observations)]
    changes: list[tuple[str, Callable[..., Errors | None]]] = [("noise", scaled_noise)]
    changes += [(f"unknown {name}", partial(_scaled_common, name)) for name in common]
    for named, change in changes:
        for factor, words in ((0.5, "half as large"), (2.0, "twice as large")):
            other = _with_noise(likelihood, partial(change, factor=factor))
            if other is not None:
                yield f"{named} {words}", "noise", f"the {named}", other
    without = _with_noise(likelihood, _without_model_error)
    if without is not None:
        yield "no model error", "model_error", "the model error", without


def _other_data(
    likelihood: FieldLikelihood, measures: Mapping[str, Discrepancy]
) -> Iterator[tuple[str, Kind, str, FieldLikelihood]]:
    seen = likelihood.observations
    inferred = any(one.unknown for one in seen)
    for name, measure in list(measures.items())[1:]:
        if isinstance(measure, NormalOffset) or not inferred:
            yield f"measure {name}", "measure", "the measure", replace(likelihood, discrepancy=measure)
    for left in seen if len(seen) > 1 else ():
        rest, condition = tuple(one for one in seen if one is not left), f"condition {left.condition}"
        yield f"without {condition}", "without", condition, replace(likelihood, observations=rest)


def _with_noise(likelihood: FieldLikelihood, other: Callable[[Errors], Errors | None]) -> FieldLikelihood | None:
    """Return the likelihood with other noise; None unless there is one for each observation."""
    pairs = [(one, other(_known(one.noise, likelihood.inferred))) for one in likelihood.observations]
    seen = tuple(Observation(one.interface, noise, one.condition) for one, noise in pairs if noise is not None)
    return replace(likelihood, observations=seen) if len(seen) == len(pairs) else None


def _scaled_common(name: str, noise: Errors, factor: float) -> Errors | None:
    """Return errors of points of which one that all share is `factor` times as large; None if it is other noise."""
    if isinstance(noise, PointErrors | UnknownErrors):
        return replace(noise, **{name: factor * getattr(noise, name)})
    return None


def _known(noise: Errors, inferred: InferredNoise | None) -> Errors:
    """Return noise that is inferred with its posterior median as a known one, except for the error of the model."""
    if inferred is None or not isinstance(noise, UnknownErrors):
        return noise
    median = inferred.median(noise)
    return replace(noise, sd=median.sd, length=median.length) if noise.model_error or noise.spread else median


def _without_model_error(noise: Errors) -> Errors | None:
    if not (isinstance(noise, UnknownErrors) and noise.model_error):
        return None
    if noise.spread or not (isinstance(noise.sd, float) and isinstance(noise.length, float)):
        return replace(noise, model_error=False)
    return noise.known(noise.sd, noise.length)
