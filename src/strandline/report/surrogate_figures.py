"""The figures of surrogates: likelihoods over two inputs, errors, and what a surrogate of the interface predicts."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.calibration import Calibration
from strandline.design import FieldOutcome
from strandline.interface import GLOBAL, Interface, Observation
from strandline.likelihood import evaluated, predicted
from strandline.posterior import interface_band, normal_offsets, observed_offsets, subset
from strandline.report import plots
from strandline.report.figure_files import Captioned

DRAWS = 400
GRID = 121
NARROW_SHARE = 0.02
"""A likelihood above 5 % of its maximum on less than this share of the box is shown enlarged as well."""

Part = Sequence[tuple[float, float]] | None
"""A part of the box, or all of it."""


def likelihood_figures(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield likelihood, log-likelihood and the surrogate's standard deviation over two inputs."""
    if calibration.problem.space.dim != 2:
        return
    if calibration.field is not None:
        functions: dict[str, Callable[[Any], Any]] = {
            next(iter(calibration.problem.discrepancies)): calibration.field.knowledge.plug_in
        }
    else:  # compiled: takes a quarter of the time of `process.mean`
        functions = {name: evaluated(predicted(one.process)) for name, one in calibration.surrogates.items()}
    means = {
        name.replace("_", " "): _with_detail(partial(_grid, calibration, function, truth))
        for name, function in functions.items()
    }
    by_field = calibration.field is not None
    facts: dict[str, Any] = {"several": len(functions) > 1, "failed": len(_failed(calibration)) > 0}
    figure = plots.three_measures(means, kind="likelihood")
    yield Captioned.of("likelihood", "surrogate", figure, by_field=by_field, **facts)
    figure = plots.three_measures(means, kind="log_likelihood")
    yield Captioned.of("log_likelihood", "surrogate", figure, by_field=by_field, **facts)
    if calibration.field is not None:
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
    return plots.FieldGrid(
        x=space.parameters[0],
        y=space.parameters[1],
        x_values=x,
        y_values=y,
        values=np.asarray(function(points)).reshape(GRID, GRID),
        failed=_failed(calibration),
        truth=None if truth is None else np.array([truth[name] for name in space.names]),
    )


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
        facts: dict[str, Any] = {
            "by_field": calibration.field is not None,
            "tenth": calibration.settings.fit is not None,
        }
        yield Captioned.of("leave_one_out", "surrogate", axes, error=validation.loo_rms_near_mode, **facts)
    if calibration.sensitivity is not None:
        symbols = [replace(parameter, unit="1").figure_label() for parameter in calibration.problem.space]
        axes = plots.plot_sensitivity(calibration.sensitivity, symbols)
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
    certificate, space = found.certificate, calibration.problem.space
    if certificate is None or len(certificate.steps) < 2:
        return
    steps = certificate.steps
    figure = plots.plot_run_history(
        np.array([step.runs for step in steps], float),
        np.array([step.mean for step in steps]),
        np.array([step.sd for step in steps]),
        [parameter.figure_label() for parameter in space],
        checked=np.array([step.kind == "check" for step in steps]),
        truth=None if truth is None else [truth[name] for name in space.names],
    )
    yield Captioned.of("run_history", "certificate", figure)


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
    return [name for name in GLOBAL if getattr(seen.noise, name, 0.0) > 0]


def _arc_length(interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length at each point of a polyline, or the number of each point of a surface."""
    if interface.dim != 2:
        return np.arange(len(interface.points), dtype=float)
    return normal_offsets(interface.points[None], interface).arc_length
