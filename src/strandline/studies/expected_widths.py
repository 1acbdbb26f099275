"""The widths that the posterior will have, from the slopes of the interface at one point, before any campaign."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import squared_discrepancies
from strandline.interface import Interface, Observation
from strandline.likelihood import compared, noise_length
from strandline.likelihood.noise_rule import differences, second_differences
from strandline.parameters import ParameterSpace
from strandline.runs import RunRecord
from strandline.studies.study import Study

__all__ = ["expected_sd", "neighbours", "slopes_by_differences", "slopes_by_sensitivities", "width_lines"]

HARDLY = 0.8
"""Share of the prior's sd above which the data hardly tell an input."""
STEP = 0.05
"""Step of the further runs, in widths of the box."""
Slopes = Mapping[str, Float[np.ndarray, "point xyz dim"]]


def slopes_by_sensitivities(record: RunRecord, names: Sequence[str]) -> Slopes | None:
    """Return d(points)/d(input) of a run by condition, mm per unit of the input; None if it lacks one."""
    found = record.sensitivities
    if not found or any(name not in one for one in found.values() for name in names):
        return None
    return {condition: np.stack([one[name] for name in names], axis=-1) for condition, one in found.items()}


def neighbours(space: ParameterSpace, at: Float[np.ndarray, " dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return inputs that differ from `at` in one input each, inside the box."""
    step = STEP * (space.high - space.low)
    return np.asarray(at + np.diag(np.where(at + step > space.high, -step, step)))


def slopes_by_differences(
    record: RunRecord, others: Sequence[RunRecord], at: Float[np.ndarray, " dim"], x: Float[np.ndarray, "dim dim"]
) -> Slopes | None:
    """Return the same from runs at `neighbours`; None if one failed or has other nodes."""
    out = {}
    for condition, interface in record.interfaces.items():
        moved = [one.interfaces[condition].points for one in others if one.ok]
        if len(moved) < len(x) or any(points.shape != interface.points.shape for points in moved):
            return None
        steps = np.diag(x - at)
        out[condition] = np.stack([(m - interface.points) / h for m, h in zip(moved, steps, strict=True)], axis=-1)
    return out


def expected_sd(
    study: Study, interfaces: Mapping[str, Interface], slopes: Slopes, observed: Mapping[str, Interface]
) -> Float[np.ndarray, " dim"]:
    """Return the posterior's standard deviation of each input if the interface is linear in them.

    The observation is taken to be the simulated interface itself, with as many points as the observed one.

    Args:
        study: The study.
        interfaces: Interfaces of the run at which the slopes hold, by condition.
        slopes: Derivatives of its points.
        observed: Observed interfaces, if known; only their numbers of points count.
    """
    dim = study.space.dim
    information = np.diag(1 / _prior_sd(study.space) ** 2)
    for condition in observed or interfaces:
        template, slope = interfaces[condition], slopes[condition]
        points = len(observed[condition].points) if condition in observed else len(template.points)
        seen = Observation(template.resampled(points) if template.dim == 2 else template, study.noise_of(condition))
        measure = next(iter(study.discrepancies.values()))
        one = compared(seen, measure, len(template.points))
        far = np.linalg.norm(slope, axis=1).max(axis=0)
        steps = noise_length(seen, measure) / np.maximum(far, 1e-300)
        moved = template.points + np.einsum("nad,kd->kna", slope, steps * differences(dim))
        squares = squared_discrepancies(one.measure, moved, template, seen.interface)
        H = second_differences(-2 * one.noise.log_density(squares), dim) / np.outer(steps, steps)
        values, vectors = np.linalg.eigh(H)
        information += 0.5 * (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def width_lines(study: Study, sd: Float[np.ndarray, " dim"], source: str) -> Iterator[str]:
    """Yield the expected standard deviation of each input, and a warning for inputs that the data hardly tell."""
    prior = _prior_sd(study.space)
    shown = [f"{p.name} ± {s:.3g} ({s / w:.2g} of its prior)" for p, s, w in zip(study.space, sd, prior, strict=True)]
    yield f"expected posterior (linearised, from {source}): {', '.join(shown)}"
    blind = [p.name for p, s, w in zip(study.space, sd, prior, strict=True) if s > HARDLY * w and not p.nuisance]
    if blind:
        yield f"warning: with this noise the data hardly tell {', '.join(blind)}"


def _prior_sd(space: ParameterSpace) -> Float[np.ndarray, " dim"]:
    """Return half the width of the central 68.3 % of each prior."""
    low, high = (space.prior_quantiles(np.full((1, space.dim), p))[0] for p in (0.1587, 0.8413))
    return np.asarray(0.5 * (high - low))
