"""The widths that the posterior will have, from the slopes of the interface at one point."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import discrepancy
from strandline.calibration import footprint
from strandline.foundations import InvalidInput, NumericsError
from strandline.interface import Interface, Observation, UnknownErrors
from strandline.likelihood import compared, differences, noise_length, second_differences
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.runs import RunRecord
from strandline.studies.load.study import Study
from strandline.surrogate import FieldTraining, fit_field

HARDLY = 0.8  # share of the prior's sd above which the data barely constrain an input
STEP = 0.05  # step of the further runs, in widths of the box
_OfInputs = Float[np.ndarray, " dim"]
Interfaces = Mapping[str, Interface]
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


def expected_sd(study: Study, interfaces: Interfaces, slopes: Slopes, observed: Interfaces) -> _OfInputs:
    """Return the posterior's standard deviation of each input if the interface is linear in them.

    The observation is taken to be the part of the simulated interface that was observed. Of the observed interfaces, if
    they are known, only the places of their points along the interface count. `slopes` hold at `interfaces`.

    Raises InvalidInput if the measure refuses the interfaces, or no noise variance of it fits the errors of the points;
    NumericsError if the slopes give no finite widths.
    """
    root = _prior_sd(study.space)[:, None] * study.space.root
    prior = np.linalg.inv(root @ root.T)
    if not all(np.isfinite(one).all() for one in slopes.values()):
        raise NumericsError("the slopes of the interface give no finite widths")
    try:
        information = prior + _information(study, interfaces, slopes, observed)
        found = np.sqrt(np.diag(np.linalg.inv(information)))
    except np.linalg.LinAlgError as error:
        raise NumericsError(f"the slopes of the interface give no finite widths: {error}") from error
    if not np.isfinite(found).all():
        raise NumericsError("the slopes of the interface give no finite widths")
    return np.asarray(found)


def _information(
    study: Study, interfaces: Interfaces, slopes: Slopes, observed: Interfaces
) -> Float[np.ndarray, "dim dim"]:
    """Return what the observations add to the prior's precision; errors that they share count once."""
    measure, dim = study.measure, study.space.dim
    seen = [_seen(study, name, interfaces[name], observed.get(name)) for name in observed or interfaces]
    steps = {one.condition: _steps(one, measure, slopes[one.condition]) for one in seen}
    errors = [found for one in seen if (found := one.errors) is not None]
    if isinstance(measure, discrepancy.NormalOffset) and len(errors) == len(seen):
        model = (discrepancy.shared_errors(seen, measure) or discrepancy.JointErrors(tuple(seen), tuple(errors))).model
        of_distances = [
            _slopes_of_distances(one.interface, interfaces[one.condition], slopes[one.condition], steps[one.condition])
            for one in seen
        ]
        return model.information(np.concatenate(of_distances))
    information = np.zeros((dim, dim))
    for one in seen:
        template, step = interfaces[one.condition], steps[one.condition]
        with_noise = compared(one, measure, len(template.points))
        moved = _moved(template, slopes[one.condition], step * differences(dim))
        squares = discrepancy.squared_discrepancies(with_noise.measure, moved, template, one.interface)
        information += _curvature(-2 * with_noise.noise.log_density(squares), step)
    return information


def _slopes_of_distances(
    seen: Interface, template: Interface, slope: Float[np.ndarray, "point xyz dim"], steps: _OfInputs
) -> Float[np.ndarray, "seen dim"]:
    """Return d(signed distance of an observed point)/d(input), mm per unit of the input, by central differences."""

    def distances(moves: Float[np.ndarray, "move dim"]) -> Float[np.ndarray, "move seen"]:
        moved = (Interface(points, template.cells) for points in _moved(template, slope, moves))
        return np.array([discrepancy.signed_distances(seen.points, one) for one in moved])

    return np.asarray((distances(np.diag(steps)) - distances(np.diag(-steps))).T / (2 * steps))


def _seen(study: Study, condition: str, simulated: Interface, observed: Interface | None) -> Observation:
    """Return the part of the simulated interface that was observed, with the same points, as an observation."""
    seen = simulated
    if observed is not None and observed.dim == simulated.dim:
        seen = Interface(footprint(observed, simulated).on(simulated.points), observed.cells)
    return study.observation(seen, condition)


def _steps(seen: Observation, measure: discrepancy.Discrepancy, slope: Float[np.ndarray, "point xyz dim"]) -> _OfInputs:
    """Return the change of each input that moves the interface by as much as the noise hides."""
    return np.asarray(noise_length(seen, measure) / np.maximum(np.linalg.norm(slope, axis=1).max(axis=0), 1e-100))


def _moved(
    template: Interface, slope: Float[np.ndarray, "point xyz dim"], moves: Float[np.ndarray, "move dim"]
) -> Float[np.ndarray, "move point xyz"]:
    return np.asarray(template.points + np.einsum("nad,kd->kna", slope, moves))


def _curvature(squares: Float[np.ndarray, " move"], steps: _OfInputs) -> Float[np.ndarray, "dim dim"]:
    """Return half the Hessian of d²/σ_N², without directions in which it is negative."""
    values, vectors = np.linalg.eigh(second_differences(squares, len(steps)) / np.outer(steps, steps))
    return np.asarray(0.5 * (vectors * np.maximum(values, 0.0)) @ vectors.T)


def width_lines(study: Study, sd: Float[np.ndarray, " dim"], source: str) -> Iterator[str]:
    """Yield the expected standard deviation of each input, and a warning for inputs that the data barely constrain."""
    left = dict(zip(study.space.names, sd / _prior_sd(study.space), strict=True))
    scalars = [(p, s) for p, s in zip(study.space, sd, strict=True) if p.name in study.space.scalars]
    shown = [f"{p.name} ± {s:.3g} ({left[p.name]:.2g} of its prior)" for p, s in scalars]
    for one in study.space.fields:
        known = sum(left[name] <= HARDLY for name in one.coefficients)
        shown.append(f"{one.name}: {known} of {one.count} coefficients below {HARDLY:g} of their prior")
    yield f"expected posterior (linearised, from {source}): {', '.join(shown)}"
    blind = [p.name for p, _ in scalars if left[p.name] > HARDLY and not p.nuisance]
    if blind:
        yield f"warning: with this noise the data barely constrain {', '.join(blind)}"


def _prior_sd(space: ParameterSpace) -> Float[np.ndarray, " dim"]:
    """Return half the width of the central 68.3 % of each prior."""
    low, high = space.marginal_quantiles(np.array([0.1587, 0.8413]))
    return np.asarray(0.5 * (high - low))


SURROGATE_STEP = 1e-3  # step of the differences, in widths of the box


def predicted_at(
    records: Sequence[RunRecord], space: ParameterSpace, at: Float[np.ndarray, " dim"]
) -> tuple[dict[str, Interface], Slopes] | None:
    """Return the interfaces at some inputs, and d(points)/d(input) there, mm per unit of the input, by condition.

    They come from a surrogate of the field, learnt from successful runs. Slopes in the mean over a wide box would hide
    that two inputs have nearly the same effect. Returns None for runs that define no field.
    """
    x = np.array([[record.inputs[name] for name in space.names] for record in records], float)
    interfaces = [record.interfaces for record in records]
    try:
        field = fit_field(FieldTraining(x, interfaces, None, space.low, space.high))
    except (InvalidInput, NumericsError):
        return None
    steps = SURROGATE_STEP * (space.high - space.low)
    ahead, back = (field.points(field.mean(at + np.diag(one))) for one in (steps, -steps))
    slopes = {name: np.moveaxis(ahead[name] - back[name], 0, -1) / (2 * steps) for name in ahead}
    return field.interfaces(at), slopes


NEAREST = 8  # runs near the posterior that give the slopes, for each input and for the mean


def outline_effect(study: Study, records: Sequence[RunRecord], posterior: Posterior) -> dict[str, Any] | None:
    """Return the outline's errors, µm, and the expected sd of each input with and without them.

    Both widths are those of a model that is linear around the posterior's mean, with slopes from the runs near it.

    Returns:
        The entry of summary.json; None if the outline comes from no picture. The widths are missing if the noise is
        inferred, or if too few runs succeeded.
    """
    found = study.undeformed
    if found is None:
        return None
    names, noises, errors = study.space.names, [*study.noises.values()], found.errors
    of: dict[str, Any] = {f"{name}_um": 1e3 * getattr(errors, name) for name in ("sd", "length", "offset")}
    ok = [record for record in records if record.ok]
    if not ok or any(isinstance(one, UnknownErrors) for one in noises):
        return of
    x = np.array([[record.inputs[name] for name in names] for record in ok], float)
    away = (((x - posterior.mean) / posterior.sd) ** 2).sum(axis=1)
    near = [ok[i] for i in np.argsort(away)[: NEAREST * (len(names) + 1)]]
    predicted = predicted_at(near, study.space, posterior.mean)
    if predicted is None:
        return of
    alone = replace(study, noises=found.noises)
    try:
        sds = [expected_sd(one, *predicted, study.observed) for one in (study, alone)]
    except (InvalidInput, NumericsError):
        return of
    return of | {
        name: dict(zip(names, (float(value) for value in one), strict=True))
        for name, one in zip(("expected_sd", "expected_sd_without"), sds, strict=True)
    }
