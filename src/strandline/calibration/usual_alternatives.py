"""The alternatives that a reader would ask about first: other priors, other noise, other measures, fewer data."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from strandline.calibration.alternative import Alternative, Present
from strandline.discrepancy import Discrepancy, NormalOffset
from strandline.interface import GLOBAL, GaussianNoise, Noise, Observation, PointErrors, UnknownErrors
from strandline.likelihood import FieldLikelihood
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import PRIORS, LogNormal, LogUniform, Normal, Prior, ScaledBeta, Uniform

__all__ = ["facts_of", "other_priors", "prior_in_words", "scaled_noise", "usual_alternatives", "with_prior"]

LEAST_SHAPE_SUM = 1.0
"""a + b of a beta distribution below which it piles up at both ends."""
LEVELS = (0.1587, 0.5, 0.8413)
"""Probabilities at which a normal distribution has its mean and one standard deviation on either side."""

LENGTHS = ("point_sd", "least_point_sd", "largest_point_sd", "correlation_length", "shift_sd", "offset_sd")
"""Parameters of the noise that are lengths, mm."""

Errors = Noise | PointErrors | UnknownErrors


def usual_alternatives(now: Present, measures: Mapping[str, Discrepancy]) -> Iterator[Alternative]:
    """Yield the usual alternatives to a study.

    Args:
        now: The present posterior.
        measures: Measures of the study by name; the first one makes the present posterior.
    """
    yield from _priors(now.space)
    yield from _fixed(now.space)
    if now.knowledge is None:
        return
    likelihood, space = now.knowledge.likelihood, now.space
    for factor, words in ((0.5, "half as large"), (2.0, "twice as large")):
        other = _with_noise(likelihood, lambda seen, factor=factor: scaled_noise(seen.noise, factor))  # type: ignore[misc]
        if other is not None:
            yield Alternative(
                f"noise {words}", "noise", "the noise", space, other, detail=facts_of(other), by_prior_alone=False
            )
    yield from _common_errors(likelihood, space)
    without_error = _with_noise(likelihood, _without_model_error)
    if without_error is not None:
        yield Alternative(
            "no model error", "model_error", "the model error", space, without_error, by_prior_alone=False
        )
    inferred = any(isinstance(seen.noise, UnknownErrors) for seen in likelihood.observations)
    for name, measure in list(measures.items())[1:]:
        if isinstance(measure, NormalOffset) or not inferred:
            other = replace(likelihood, discrepancy=measure)
            yield Alternative(f"measure {name}", "measure", "the measure", space, other, by_prior_alone=False)
    yield from _without(likelihood, space)


def other_priors(parameter: Parameter) -> Iterator[tuple[str, Prior]]:
    """Yield other priors of an input, with what they are in words: narrower, wider, flat, flat in the logarithm."""
    low, high = parameter.interval
    prior = parameter.prior
    narrower, wider = _scaled(prior, 0.5), _scaled(prior, 2.0)
    if narrower is not None:
        yield "half as wide", narrower
    if wider is not None:
        yield "twice as wide", wider
    if prior != Uniform(low, high):
        yield "flat in its box", Uniform(low, high)
    if low > 0 and prior != LogUniform(low, high):
        yield "flat in its logarithm", LogUniform(low, high)


def with_prior(space: ParameterSpace, priors: Mapping[str, Prior]) -> ParameterSpace:
    """Return the inputs with other priors, truncated to the same box.

    Args:
        space: The inputs.
        priors: The other priors by name of the input.
    """
    changed = {name: replace(space[name], prior=prior, box=space[name].interval) for name, prior in priors.items()}
    return ParameterSpace(tuple(changed.get(one.name, one) for one in space))


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


def prior_in_words(prior: Prior) -> str:
    """Return a prior as study.yaml has it: ``normal [350, 50]``; the representation of one that is not built in."""
    name = next((name for name, kind in PRIORS.items() if type(prior) is kind), None)
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


def _scaled(prior: Prior, factor: float) -> Prior | None:
    """Return a prior with the same centre and `factor` times the width; None if its bounds do not allow that.

    A uniform prior is a beta distribution with both shapes 1: half as wide, it is a bell between the same bounds.
    """
    if isinstance(prior, Normal):
        return Normal(prior.mean, factor * prior.sd)
    if isinstance(prior, LogNormal):
        return LogNormal(prior.mu, factor * prior.sigma)
    if isinstance(prior, Uniform):
        prior = ScaledBeta(1.0, 1.0, prior.low, prior.high)
    if isinstance(prior, ScaledBeta):
        whole = prior.a + prior.b
        other = (whole + 1) / factor**2 - 1
        share = other / whole
        possible = other > LEAST_SHAPE_SUM and min(prior.a * share, prior.b * share) >= min(1.0, prior.a, prior.b)
        return ScaledBeta(prior.a * share, prior.b * share, prior.low, prior.high) if possible else None
    below, middle, above = (float(prior.quantile(level)) for level in LEVELS)
    if isinstance(prior, LogUniform):
        return LogNormal(math.log(middle), factor * 0.5 * math.log(above / below)) if factor < 1 else None
    return Normal(middle, factor * 0.5 * (above - below))


def _priors(space: ParameterSpace) -> Iterator[Alternative]:
    for parameter in space:
        for words, prior in other_priors(parameter):
            changed = with_prior(space, {parameter.name: prior})
            name, about = f"prior of {parameter.name} {words}", f"the prior of {parameter.name}"
            yield Alternative(name, "prior", about, changed, detail=prior_in_words(prior))


def _fixed(space: ParameterSpace) -> Iterator[Alternative]:
    """Yield each nuisance input as known: the median of its prior."""
    for i in space.nuisance:
        one = space.parameters[i]
        median = float(f"{float(one.truncated_prior.quantile(0.5)):.4g}")
        name, about = f"{one.name} known to be {median:g}", f"what is known of {one.name}"
        yield Alternative(name, "fix", about, space, fixed={one.name: median})


def _with_noise(likelihood: FieldLikelihood, other: Callable[[Observation], Errors | None]) -> FieldLikelihood | None:
    """Return the likelihood with other noise; None unless there is one for each observation."""
    noises = [other(seen) for seen in _stated(likelihood)]
    if any(noise is None for noise in noises):
        return None
    pairs = zip(likelihood.observations, noises, strict=True)
    seen = tuple(Observation(one.interface, noise, one.condition) for one, noise in pairs if noise is not None)
    return replace(likelihood, observations=seen)


def _common_errors(likelihood: FieldLikelihood, space: ParameterSpace) -> Iterator[Alternative]:
    """Yield each error that all points of an observation share, such as a shift, half and twice as large."""
    for name in GLOBAL:
        if not any(getattr(seen.noise, name, 0.0) > 0 for seen in likelihood.observations):
            continue
        for factor, words in ((0.5, "half as large"), (2.0, "twice as large")):
            other = _with_noise(likelihood, lambda seen, of=name, by=factor: _scaled_common(seen.noise, of, by))  # type: ignore[misc]
            if other is not None:
                named, about = f"unknown {name} {words}", f"the unknown {name}"
                yield Alternative(named, "noise", about, space, other, detail=facts_of(other), by_prior_alone=False)


def _scaled_common(noise: Errors, name: str, factor: float) -> Errors | None:
    """Return errors of points of which one that all share is `factor` times as large; None if it is other noise."""
    if isinstance(noise, PointErrors | UnknownErrors):
        return replace(noise, **{name: factor * getattr(noise, name)})
    return None


def _stated(likelihood: FieldLikelihood) -> tuple[Observation, ...]:
    """Return the observations; where the sd of the points is inferred, with its posterior median as a known one."""
    if likelihood.inferred is None:
        return likelihood.observations
    medians = [seen.noise for seen in likelihood.inferred.at_median(likelihood.observations)]
    return tuple(
        Observation(seen.interface, _at_median(seen.noise, median), seen.condition)
        for seen, median in zip(likelihood.observations, medians, strict=True)
    )


def _at_median(noise: Errors, median: Errors) -> Errors:
    """Return noise that was inferred as a known one, except for the error of the model."""
    if not (isinstance(noise, UnknownErrors) and isinstance(median, PointErrors)):
        return noise
    if not (noise.model_error or noise.spread):
        return median
    return replace(noise, sd=median.sd, length=median.length)


def _without_model_error(seen: Observation) -> Errors | None:
    noise = seen.noise
    if not (isinstance(noise, UnknownErrors) and noise.model_error):
        return None
    if noise.spread or not (isinstance(noise.sd, float) and isinstance(noise.length, float)):
        return replace(noise, model_error=False)
    return noise.known(noise.sd, noise.length)


def _without(likelihood: FieldLikelihood, space: ParameterSpace) -> Iterator[Alternative]:
    """Yield each condition left out, if there are several."""
    seen = likelihood.observations
    if len(seen) < 2:
        return
    for left in seen:
        rest = tuple(one for one in seen if one is not left)
        words = f"without condition {left.condition}"
        other = replace(likelihood, observations=rest)
        yield Alternative(words, "without", f"condition {left.condition}", space, other, by_prior_alone=False)
