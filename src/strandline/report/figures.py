"""The figures of a calibration, each with a name and a caption, drawn one after the other."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.calibration import Calibration
from strandline.design import FieldOutcome
from strandline.foundations import ForwardModelError
from strandline.interface import GLOBAL, Interface, Observation
from strandline.likelihood import evaluated, predicted
from strandline.models import draws_fields, undeformed_interface
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    Histogram,
    MarginalPosterior,
    QuadratureResult,
    interface_band,
    mixture,
    normal_offsets,
    observed_offsets,
    subset,
)
from strandline.report import plots
from strandline.report.fields import random_field_figures
from strandline.report.html import number
from strandline.report.plots.picture import plot_surfaces
from strandline.report.plots.style import Captioned

BEST = "best run"
EXAMPLES = (0.1, 0.8, 1.0)
"""Quantiles of the displacement at which runs are drawn as examples."""
BEST_RUNS = ("best", "second", "third", "fourth", "fifth")
"""The runs whose offsets are drawn; the best one is at zero."""
CONSPICUOUS = 0.05
"""Parts of an arc with a smaller p-value are marked in the figure."""
SHARES = ("first", "first_low", "first_high", "total", "total_low", "total_high")
"""What sensitivity indices have for each input."""
DRAWS = 400
GRID = 121
NARROW_SHARE = 0.02
"""A likelihood above 5 % of its maximum on less than this share of the box is shown enlarged as well."""

Part = Sequence[tuple[float, float]] | None
"""A part of the box, or all of it."""


def figure_groups(calibration: Calibration, truth: Mapping[str, float] | None) -> dict[str, Iterator[Captioned]]:
    """Return the figures of a calibration in groups; each is drawn on request, those of two inputs if there are two."""
    return {
        "fit": fit_figures(calibration),
        "data": chain(_data(calibration, truth), _offsets(calibration), failed_runs(calibration)),
        "likelihood": likelihood_figures(calibration, truth),
        "surrogate": surrogate_figures(calibration),
        "sampler": _sampler(calibration),
        "posterior": _posterior(calibration, truth),
        "random fields": random_field_figures(calibration, truth),
        "under uncertainty": _under_uncertainty(calibration, truth),
        "field": field_figures(calibration, truth),
    }


def fit_figures(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the residuals along the observed polylines; nothing for surfaces."""
    found = calibration.misfit
    drawn = {}
    for one in found.conditions if found else ():
        if not one.surface:
            parts = tuple((part.begin, part.end) for part in one.regions if part.p_value < CONSPICUOUS)
            drawn[one.condition] = plots.ResidualsAlong(one.arc_length, one.residual, one.expected.sd, parts)
    if drawn:
        yield Captioned.of("residuals", "fit", plots.plot_residuals(drawn))


def _data(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    problem, space = calibration.problem, calibration.problem.space
    at = truth if truth is not None else {**problem.fixed, **space.as_mapping(calibration.posterior.map_estimate)}
    if draws_fields(problem.model):
        with suppress(ForwardModelError):
            figure = plots.plot_flow(problem.model.fields(at))
            several = len(problem.observations) > 1
            yield Captioned.of("flow", "data", figure, truth=truth is not None, several=several)
    undeformed = undeformed_interface(problem.model)
    observed = {o.condition: o.interface for o in problem.observations}
    examples = _examples(calibration, undeformed)
    surfaces = {condition: one for condition, one in observed.items() if one.dim == 3}
    for condition, interface in surfaces.items():
        yield Captioned.of("surfaces", "data", plot_surfaces(interface, examples[condition]), of=condition)
    if surfaces:
        return
    drawing: Any
    if len(observed) == 1:
        ((condition, interface),) = observed.items()
        drawing = plots.plot_interfaces(interface, reference=undeformed, simulated=examples[condition])
    else:
        drawing = plots.plot_conditions(observed, reference=undeformed, simulated=examples)
    facts: dict[str, Any] = {"undeformed": undeformed is not None, "several": len(observed) > 1}
    yield Captioned.of("interfaces", "data", drawing, **facts)


def _examples(calibration: Calibration, undeformed: Interface | None) -> dict[str, dict[str, Interface]]:
    """Return interfaces by observed condition and inputs: the best run, and runs with little to large displacement.

    Displacements are those of the first condition, from the undeformed interface if it is known, else from the best
    run; runs with a different number of nodes are left out.
    """
    problem = calibration.problem
    first = problem.observations[0]
    values = next(iter(calibration.log_likelihoods.values()))
    best = _in_legend(problem.space, calibration.training[int(np.argmax(values))])
    good, names = [record for record in calibration.records if record.ok], problem.space.names
    every = {_in_legend(problem.space, [one.inputs[name] for name in names]): one.interfaces for one in good}
    reference = (undeformed or every[best][first.condition]).points
    runs = {label: i for label, i in every.items() if i[first.condition].points.shape == reference.shape}
    moved = {label: np.abs(i[first.condition].points - reference).max() for label, i in runs.items()}
    ranked = sorted(runs, key=lambda label: float(moved[label]))
    chosen = dict.fromkeys(ranked[round(q * (len(ranked) - 1))] for q in EXAMPLES) if ranked else {}
    if best in runs:
        chosen = {f"{BEST}: {best}": None} | {label: None for label in chosen if label != best}
        runs[f"{BEST}: {best}"] = runs[best]
    return {o.condition: {label: runs[label][o.condition] for label in chosen} for o in problem.observations}


def _in_legend(space: ParameterSpace, values: Sequence[float] | Float[np.ndarray, " dim"]) -> str:
    """Return inputs with their symbols, and the mean of each field, as a legend shows them."""
    by_name = dict(zip(space.names, map(float, values), strict=True))
    shown = {replace(space[name], unit="1").figure_label(): by_name[name] for name in space.scalars}
    for one in space.fields:
        weights = one.support.weights / one.support.weights.sum()
        (values,) = one.values_of_many(np.array([[by_name[name] for name in one.names]]))
        shown[f"mean {one.name}"] = values @ weights
    return ", ".join(f"{symbol} = {number(value, 3)}" for symbol, value in shown.items())


def _offsets(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the normal offsets of the observation and of the best runs from the best one, by condition.

    Nothing is drawn for a surrogate of the field: it predicts interfaces, and its own figure shows the posterior's.
    """
    if calibration.field is not None:
        return
    good = [record for record in calibration.records if record.ok]
    values = next(iter(calibration.log_likelihoods.values()))
    ranked = np.argsort(-values, kind="stable")[: len(BEST_RUNS)]
    for seen in calibration.problem.observations:
        best, *others = (good[i].interfaces[seen.condition] for i in ranked)
        if any(interface.dim != 2 for interface in (seen.interface, best, *others)):
            continue
        labels = [f"{BEST_RUNS[k]} best run, log-likelihood {number(values[i])}" for k, i in enumerate(ranked)][1:]
        runs = {label: observed_offsets(interface, best) for label, interface in zip(labels, others, strict=True)}
        axes = plots.plot_run_offsets(observed_offsets(seen.interface, best), runs)
        yield Captioned.of("offsets", "data", axes, of=seen.condition, best=float(values[ranked[0]]))


def failed_runs(calibration: Calibration) -> Iterator[Captioned]:
    """Yield a picture of the failed runs if there are any and more than two inputs; for two, the maps show them."""
    space = calibration.problem.space
    kinds = ["" if record.ok else record.failure_kind or record.state for record in calibration.records]
    failed = Counter(filter(None, kinds))
    if space.dim <= 2 or not failed or not space.scalars:
        return
    inputs = np.array([[record.inputs[name] for name in space.scalars] for record in calibration.records], float)
    by_kind = {kind: inputs[[its == kind for its in kinds]] for kind, _ in failed.most_common()}
    axes = plots.plot_failed_runs([space[name] for name in space.scalars], inputs[[not its for its in kinds]], by_kind)
    yield Captioned.of("failed_runs", "runs", axes)


def _sampler(calibration: Calibration) -> Iterator[Captioned]:
    if calibration.field is not None and calibration.field.by_chains:
        return  # no tempering
    steps, halves = calibration.sampling.steps, calibration.sampling.halves
    course = ([getattr(step, name) for step in steps] for name in ("temperature", "ess", "acceptance"))
    particles = calibration.settings.particles if halves is None else len(halves[0].positions)
    figure = plots.plot_tempering(*course, particles=particles)
    yield Captioned.of("tempering", "sampler", figure, halves=halves is not None)


def _posterior(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    posterior, names = calibration.posterior, calibration.problem.space.scalars
    if len(names) == 2:
        figure = plots.plot_joint(posterior, names, laplace=calibration.laplace, truth=truth)
        yield Captioned.of("posterior", "posterior", figure, two=True)
        yield Captioned.of("particles", "posterior", plots.plot_particles(posterior, names))
    elif len(names) > 2:
        yield Captioned.of("posterior", "posterior", plots.plot_corner(posterior, truth=truth), two=False)
    if len(names) > 3:
        yield Captioned.of("parallel", "posterior", plots.plot_parallel(posterior, truth=truth))
    if not names:
        return
    exact = _by_quadrature(posterior.space.names, calibration.quadrature)
    figure = plots.plot_marginals(posterior, exact=exact, truth=truth)
    yield Captioned.of("marginals", "posterior", figure, exact=bool(exact))


def _under_uncertainty(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the calibrated inputs in both readings, and the nuisance inputs (the study's Figs. 9d and 10)."""
    found, space, cut = calibration.under_uncertainty, calibration.problem.space, calibration.cut_quadrature
    if found is None:
        return
    if len(found.joint.names) == 2:  # the figure of all inputs shows any other joint reading
        yield from _reading("joint", found.joint, truth)
    yield from _reading("cut", found.cut, truth)
    curves = _by_quadrature(found.cut.names, None if cut is None else mixture(cut))
    figure = plots.plot_marginals(found.cut.extended, found.cut.names, exact=curves, truth=truth)
    yield Captioned.of("cut_marginals", "uncertainty", figure, exact=bool(curves))
    names = [space.names[i] for i in space.nuisance]
    figure = plots.plot_marginals(calibration.posterior, names, truth=truth, whole_box=True)
    yield Captioned.of("nuisance", "uncertainty", figure, names=names)


def _reading(name: str, reading: MarginalPosterior, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the calibrated inputs in one reading; one input alone is among the marginals."""
    names = reading.names
    if len(names) == 2:
        figure = plots.plot_joint(reading.extended, (names[0], names[1]), truth=truth)
    elif len(names) > 2:
        figure = plots.plot_corner(reading.extended, names, truth=truth)
    else:
        return
    yield Captioned.of("posterior", "uncertainty", figure, of=name, two=len(names) == 2)


def _by_quadrature(names: Sequence[str], exact: QuadratureResult | None) -> dict[str, Histogram]:
    return {} if exact is None else dict(zip(names, exact.marginals, strict=True))


def likelihood_figures(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield likelihood, log-likelihood and the surrogate's standard deviation over two inputs."""
    if calibration.problem.space.dim != 2 or calibration.problem.space.fields:
        return
    if calibration.field is not None:
        first = next(iter(calibration.problem.discrepancies))
        functions: dict[str, Callable[[Any], Any]] = {first: calibration.field.knowledge.plug_in}
    else:  # compiled: takes a quarter of the time of `process.mean`
        functions = {name: evaluated(predicted(one.process)) for name, one in calibration.surrogates.items()}
    grids = {name: partial(_grid, calibration, function, truth) for name, function in functions.items()}
    means = {name.replace("_", " "): _with_detail(grid) for name, grid in grids.items()}
    by_field = calibration.field is not None
    facts: dict[str, Any] = {"several": len(functions) > 1, "failed": len(_failed(calibration)) > 0}
    kinds: tuple[plots.Kind, ...] = ("likelihood", "log_likelihood")
    for kind in kinds:
        yield Captioned.of(kind, "surrogate", plots.three_measures(means, kind=kind), by_field=by_field, **facts)
    if by_field:
        return
    variances = {name: _grid(calibration, one.process.variance, truth) for name, one in calibration.surrogates.items()}
    deviations = {name.replace("_", " "): replace(one, values=np.sqrt(one.values)) for name, one in variances.items()}
    yield Captioned.of("log_likelihood_sd", "surrogate", plots.three_measures(deviations, kind="sd"), **facts)


def _with_detail(grid_on: Callable[[Part], plots.FieldGrid]) -> plots.FieldGrid:
    """Return a log-likelihood over the box, with an enlarged detail if the likelihood is too narrow to see."""
    grid = grid_on(None)
    high = grid.values > grid.values.max() + np.log(0.05)
    if high.mean() > NARROW_SHARE:
        return grid
    rows, columns = np.flatnonzero(high.any(axis=1)), np.flatnonzero(high.any(axis=0))
    part = [_around(grid.x_values, rows), _around(grid.y_values, columns)]
    return replace(grid, detail=grid_on(part))


def _around(values: Float[np.ndarray, " x"], chosen: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the interval of the chosen grid points plus a quarter of it, at least four cells, on each side."""
    reach = max(4, round(0.25 * (chosen[-1] - chosen[0] + 1)))
    return float(values[max(chosen[0] - reach, 0)]), float(values[min(chosen[-1] + reach, len(values) - 1)])


def _grid(
    calibration: Calibration, function: Callable[[Any], Any], truth: Mapping[str, float] | None, part: Part = None
) -> plots.FieldGrid:
    """Return a function of the inputs on a grid over the box, or a part of it."""
    space = calibration.problem.space
    x, y = (np.linspace(*interval, GRID) for interval in part or [parameter.interval for parameter in space])
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    values = np.asarray(function(points)).reshape(GRID, GRID)
    at = None if truth is None else np.array([truth[name] for name in space.names])
    across, up = space
    return plots.FieldGrid(across, up, x, y, values, failed=_failed(calibration), truth=at)


def _failed(calibration: Calibration) -> Float[np.ndarray, "run dim"]:
    names = calibration.problem.space.names
    rows = [[record.inputs[name] for name in names] for record in calibration.records if not record.ok]
    return np.array(rows, float).reshape(-1, len(names))


def surrogate_figures(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the predictions of runs left out, and the sensitivity indices."""
    if calibration.surrogates:
        values = next(iter(calibration.log_likelihoods.values()))
        validation, how = calibration.surrogate.validation, calibration.surrogate.left_out
        known = values - validation.residuals
        axes = plots.plot_leave_one_out(values, known, near_mode=validation.near_mode, left_out=how)
        by_field, tenth = calibration.field is not None, calibration.settings.fit is not None
        facts: dict[str, Any] = {"by_field": by_field, "tenth": tenth, "error": validation.loo_rms_near_mode}
        yield Captioned.of("leave_one_out", "surrogate", axes, **facts)
    space = calibration.problem.space
    if calibration.sensitivity is not None and space.scalars:
        symbols = [replace(space[name], unit="1").figure_label() for name in space.scalars]
        rows = {name: one[_scalar(space)] for name, one in vars(calibration.sensitivity).items() if name in SHARES}
        axes = plots.plot_sensitivity(replace(calibration.sensitivity, **rows), symbols)
        yield Captioned.of("sensitivity", "surrogate", axes)


def field_figures(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield history, errors and predicted interfaces; nothing if the surrogate is one of the log-likelihood."""
    found = calibration.field
    if found is None:
        return
    yield from _history(calibration, found, truth)
    chosen = subset(calibration.posterior.weights, min(DRAWS, calibration.posterior.number), 0)
    x = calibration.posterior.draws[chosen]
    yield Captioned.of("field_error", "surrogate", plots.plot_field_error(_errors(found, x)))
    yield from _predictive(calibration, found, x)


def _history(calibration: Calibration, found: FieldOutcome, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    steps, space = () if found.certificate is None else found.certificate.steps, calibration.problem.space
    if len(steps) < 2 or not space.scalars:
        return
    runs, mean, sd = (np.array([getattr(step, name) for step in steps], float) for name in ("runs", "mean", "sd"))
    mean, sd = mean[:, _scalar(space)], sd[:, _scalar(space)]
    labels = [space[name].figure_label() for name in space.scalars]
    checked = np.array([step.kind == "check" for step in steps])
    at = None if truth is None else [truth[name] for name in space.scalars]
    figure = plots.plot_run_history(runs, mean, sd, labels, checked=checked, truth=at)
    yield Captioned.of("run_history", "certificate", figure)


def _scalar(space: ParameterSpace) -> list[int]:
    """Return the columns of the inputs that are no coefficients of a field."""
    return [space.names.index(name) for name in space.scalars]


def _errors(found: FieldOutcome, x: Float[np.ndarray, "draw dim"]) -> dict[str, plots.ErrorsAlong]:
    surrogate = found.knowledge.surrogate
    basis, roots = surrogate.modes.basis, surrogate.modes.roots
    cut_off = np.sum(surrogate.modes.tail**2, axis=0)
    left_out = surrogate.left_out_fields() ** 2 + cut_off / roots**2
    own = (surrogate.predict(x).variance @ basis**2 + cut_off) / roots**2
    out, begin = {}, 0
    for name, layout in surrogate.layouts.items():
        template = layout.template
        values = slice(begin, begin + template.points.size)
        begin += template.points.size
        squares = (a[:, values].reshape(-1, *template.points.shape).sum(axis=2) for a in (left_out, own))
        middle = (np.sqrt(np.median(a, axis=0)) for a in squares)
        out[name] = plots.ErrorsAlong(_arc_length(template), *middle)
    return out


def _predictive(calibration: Calibration, found: FieldOutcome, x: Float[np.ndarray, "draw dim"]) -> Iterator[Captioned]:
    surrogate = found.knowledge.surrogate
    points = surrogate.points(surrogate.mean(x))
    for name, layout in surrogate.layouts.items():
        if layout.template.dim != 2:
            continue
        seen = next(one for one in calibration.problem.observations if one.condition == name)
        centre = layout.with_points(interface_band(points[name]).median)
        drawn, observed = normal_offsets(points[name], centre), observed_offsets(seen.interface, centre)
        low, median, high = np.quantile(drawn.offset, (0.05, 0.5, 0.95), axis=0)
        band = plots.OffsetBand(drawn.arc_length, low, median, high, observed.arc_length, observed.offset)
        unknown = unknown_errors(seen)
        yield Captioned.of("predictive", "certificate", plots.plot_offsets(band), of=name, unknown=unknown)


def unknown_errors(seen: Observation) -> list[str]:
    """Return the errors of the whole observed interface that the figure does not take out of it."""
    return [name for name in GLOBAL if f"{name}_sd" in seen.noise.facts]


def _arc_length(interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length at each point of a polyline, or the number of each point of a surface."""
    if interface.dim != 2:
        return np.arange(len(interface.points), dtype=float)
    return normal_offsets(interface.points[None], interface).arc_length
