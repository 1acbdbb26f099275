"""The figures of a calibration, each with a name and a caption, drawn one after the other."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.calibration import Calibration
from strandline.design.active import FieldOutcome
from strandline.errors import ForwardModelError
from strandline.interface import Interface
from strandline.likelihood import evaluated, predicted
from strandline.models.offers import DrawsFields, undeformed_interface
from strandline.parameters import Parameter
from strandline.posterior import Reading
from strandline.posterior.quadrature import QuadratureResult, mixture
from strandline.report import plots
from strandline.report.captioned import Captioned, whole
from strandline.report.field_figures import field_figures
from strandline.report.fit import fit_figures
from strandline.report.plots.surfaces import plot_surfaces
from strandline.report.run_figures import failed_runs, offsets_of_runs
from strandline.surrogate import LogLikelihoodSurrogate

__all__ = ["Captioned", "figure_groups"]

GRID = 121
BEST = "best run"
SPACE = 3
"""Coordinates of a point of a surface."""
NARROW_SHARE = 0.02
"""A likelihood above 5 % of its maximum on less than this share of the box is shown enlarged as well."""
EXAMPLES = (0.1, 0.8, 1.0)
"""Quantiles of the displacement at which runs are drawn as examples."""


def figure_groups(calibration: Calibration, truth: Mapping[str, float] | None) -> dict[str, Iterator[Captioned]]:
    """Return the figures of a calibration in groups; each is drawn on request.

    Figures of exactly two inputs are left out if there are fewer or more.
    """
    return {
        "fit": fit_figures(calibration),
        "data": chain(_data(calibration, truth), offsets_of_runs(calibration), failed_runs(calibration)),
        "likelihood": _fields(calibration, truth),
        "surrogate": _surrogate(calibration),
        "sampler": _sampler(calibration),
        "posterior": _posterior(calibration, truth),
        "under uncertainty": _under_uncertainty(calibration, truth),
        "field": field_figures(calibration, truth),
    }


def _data(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    problem, space = calibration.problem, calibration.problem.space
    at = truth if truth is not None else {**problem.fixed, **space.as_mapping(calibration.posterior.map_estimate)}
    where = "the inputs of the synthetic observation" if truth is not None else "the MAP estimate"
    if isinstance(problem.model, DrawsFields):
        try:
            figure = plots.plot_flow(problem.model.fields(at))
        except ForwardModelError:
            figure = None
        if figure is not None:
            where += " where the flow is strongest" if len(problem.observations) > 1 else ""
            caption = f"Fluid velocity, fluid pressure and displacement of the solid on the deformed mesh at {where}."
            yield Captioned("flow", "data", caption, whole(figure))
    undeformed = undeformed_interface(problem.model)
    observed = {o.condition: o.interface for o in problem.observations}
    examples = _examples(calibration, undeformed)
    among = "" if undeformed is None else ", the undeformed one,"
    caption = f"The observed interface{among} and the interfaces of a few runs of the design"
    surfaces = {condition: one for condition, one in observed.items() if one.dim == SPACE}
    for condition, interface in surfaces.items():
        figure = plot_surfaces(interface, examples[condition])
        of = f", {condition}" if condition else ""
        text = f"The observed surface and those of a few runs of the design, cut by three planes{of}."
        yield Captioned(f"surfaces-{condition}" if condition else "surfaces", "data", text, whole(figure))
    if surfaces:
        return
    if len(observed) == 1:
        ((condition, interface),) = observed.items()
        axes = plots.plot_interfaces(interface, reference=undeformed, simulated=examples[condition])
        yield Captioned("interfaces", "data", f"{caption}.", whole(axes.figure))
    else:
        figure = plots.plot_conditions(observed, reference=undeformed, simulated=examples)
        yield Captioned("interfaces", "data", f"{caption}, by condition.", whole(figure))


def _examples(calibration: Calibration, undeformed: Interface | None) -> dict[str, dict[str, Interface]]:
    """Return interfaces by observed condition and inputs: the best run, and runs with little to large displacement.

    Displacements are those of the first condition, from the undeformed interface if it is known, else from the best
    run; runs with a different number of nodes are left out.
    """
    problem = calibration.problem
    first = problem.observations[0]
    best = _best_run(calibration)
    every = {
        ", ".join(f"{_symbol(p)} = {record.inputs[p.name]:.3g}" for p in problem.space): record.interfaces
        for record in calibration.records
        if record.ok
    }
    reference = (undeformed or every[best][first.condition]).points
    runs = {label: i for label, i in every.items() if i[first.condition].points.shape == reference.shape}
    moved = {label: np.abs(i[first.condition].points - reference).max() for label, i in runs.items()}
    ranked = sorted(runs, key=lambda label: float(moved[label]))
    chosen = dict.fromkeys(ranked[round(q * (len(ranked) - 1))] for q in EXAMPLES) if ranked else {}
    if best in runs:
        chosen = {f"{BEST}: {best}": None} | {label: None for label in chosen if label != best}
        runs[f"{BEST}: {best}"] = runs[best]
    return {o.condition: {label: runs[label][o.condition] for label in chosen} for o in problem.observations}


def _best_run(calibration: Calibration) -> str:
    """Return the inputs of the run with the highest log-likelihood, as the legend shows them."""
    values = next(iter(calibration.log_likelihoods.values()))
    best = calibration.training[int(np.argmax(values))]
    return ", ".join(f"{_symbol(p)} = {x:.3g}" for p, x in zip(calibration.problem.space, best, strict=True))


def _symbol(parameter: Parameter) -> str:
    """Return the symbol of an input as a figure shows it."""
    return replace(parameter, unit="1").figure_label()


def _fields(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    space = calibration.problem.space
    if space.dim != 2:
        return
    if calibration.field is not None:
        yield from _field_likelihood(calibration, calibration.field, truth)
        return
    means = {_spoken(name): _mean_grid(calibration, s, truth) for name, s in calibration.surrogates.items()}
    deviations = {
        _spoken(name): _grid(calibration, s, lambda s, x: np.sqrt(s.process.variance(x)), truth)
        for name, s in calibration.surrogates.items()
    }
    several = "by discrepancy measure; " if len(means) > 1 else ""
    crosses = _crosses(calibration)
    yield Captioned(
        "likelihood",
        "surrogate",
        f"Likelihood over its maximum, {several}mean of the surrogate.{crosses}",
        whole(plots.three_measures(means, kind="likelihood")),
    )
    yield Captioned(
        "log_likelihood",
        "surrogate",
        f"Log-likelihood, {several}mean of the surrogate.{crosses}",
        whole(plots.three_measures(means, kind="log_likelihood")),
    )
    yield Captioned(
        "log_likelihood_sd",
        "surrogate",
        f"Standard deviation of the surrogate, {several}in units of log-likelihood.{crosses}",
        whole(plots.three_measures(deviations, kind="sd")),
    )


def _mean_grid(
    calibration: Calibration, surrogate: LogLikelihoodSurrogate, truth: Mapping[str, float] | None
) -> plots.FieldGrid:
    """Return the surrogate's mean over the box, with an enlarged detail if the likelihood is too narrow to see."""
    compiled = evaluated(predicted(surrogate.process))  # compiled: takes a quarter of the time of `process.mean`

    def mean(_: LogLikelihoodSurrogate, x: Any) -> Any:
        return np.asarray(compiled(x))

    return _with_detail(lambda part: _grid(calibration, surrogate, mean, truth, part=part))


def _with_detail(grid_on: Callable[[Sequence[tuple[float, float]] | None], plots.FieldGrid]) -> plots.FieldGrid:
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
    calibration: Calibration,
    surrogate: Any,
    function: Callable[[Any, Any], Any],
    truth: Mapping[str, float] | None,
    *,
    part: Sequence[tuple[float, float]] | None = None,
) -> plots.FieldGrid:
    """Return a scalar of the surrogate on a grid over the box, or a part of it."""
    space = calibration.problem.space
    intervals = [parameter.interval for parameter in space] if part is None else part
    x, y = (np.linspace(*interval, GRID) for interval in intervals)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return plots.FieldGrid(
        x=space.parameters[0],
        y=space.parameters[1],
        x_values=x,
        y_values=y,
        values=function(surrogate, points).reshape(GRID, GRID),
        failed=_failed(calibration),
        truth=None if truth is None else np.array([truth[name] for name in space.names]),
    )


def _crosses(calibration: Calibration) -> str:
    """Return what the crosses of a figure are, if there are any."""
    return " Grey crosses are failed forward runs." if len(_failed(calibration)) else ""


def _failed(calibration: Calibration) -> Float[np.ndarray, "run dim"]:
    names = calibration.problem.space.names
    rows = [[record.inputs[name] for name in names] for record in calibration.records if not record.ok]
    return np.array(rows, float).reshape(-1, len(names))


def _field_likelihood(
    calibration: Calibration, found: FieldOutcome, truth: Mapping[str, float] | None
) -> Iterator[Captioned]:
    """Yield the likelihood of the predicted interface over two inputs."""
    name = _spoken(next(iter(calibration.problem.discrepancies)))

    def grid_on(part: Sequence[tuple[float, float]] | None) -> plots.FieldGrid:
        return _grid(calibration, found.knowledge, lambda known, x: known.plug_in(x), truth, part=part)

    grids = {name: _with_detail(grid_on)}
    crosses = _crosses(calibration)
    rest = f"of the interface that the surrogate predicts.{crosses}"
    caption = f"Likelihood over its maximum, {rest}"
    yield Captioned("likelihood", "surrogate", caption, whole(plots.three_measures(grids, kind="likelihood")))
    caption = f"Log-likelihood, {rest}"
    yield Captioned("log_likelihood", "surrogate", caption, whole(plots.three_measures(grids, kind="log_likelihood")))


def _surrogate(calibration: Calibration) -> Iterator[Captioned]:
    if calibration.surrogates:
        values = next(iter(calibration.log_likelihoods.values()))
        validation, how = calibration.surrogate.validation, calibration.surrogate.left_out
        predicted = values - validation.residuals
        axes = plots.plot_leave_one_out(values, predicted, near_mode=validation.near_mode, left_out=how)
        called = "the surrogate" if calibration.field is None else "a surrogate of the log-likelihood"
        decide = "" if calibration.field is not None else " The runs near the mode decide the posterior:"
        others = "all other runs" if calibration.settings.fit is None else "nine tenths of the runs, without it"
        caption = (
            f"Each run's log-likelihood as {called} predicts it from {others}.{decide} "
            f"Root-mean-square error of the runs near the mode: {validation.loo_rms_near_mode:.3g}."
        )
        yield Captioned("leave_one_out", "surrogate", caption, whole(axes.figure))
    if calibration.sensitivity is not None:
        axes = plots.plot_sensitivity(calibration.sensitivity, [_symbol(p) for p in calibration.problem.space])
        caption = (
            "Sobol' indices: the share of the log-likelihood's variance under the prior that each input explains "
            "alone, and that it is part of, with bootstrap intervals of 95 %. A share lies between 0 and 1, but its "
            "estimate may not. The far tail has most of this variance; the marginal of an input shows how well it is "
            "known."
        )
        yield Captioned("sensitivity", "surrogate", caption, whole(axes.figure))


def _sampler(calibration: Calibration) -> Iterator[Captioned]:
    steps, halves = calibration.sampling.steps, calibration.sampling.halves
    figure = plots.plot_tempering(
        [s.temperature for s in steps],
        [s.ess for s in steps],
        [s.acceptance for s in steps],
        particles=calibration.settings.particles if halves is None else len(halves[0].positions),
    )
    whose = "The sampler's steps" if halves is None else "The steps of the first half of the particles"
    caption = f"{whose}: tempering exponent (of the likelihood), effective sample size, share of accepted moves."
    yield Captioned("tempering", "sampler", caption, whole(figure))


def _posterior(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    posterior, space = calibration.posterior, calibration.problem.space
    if space.dim == 2:
        names = (space.names[0], space.names[1])
        figure = plots.plot_joint(posterior, names, laplace=calibration.laplace, truth=truth)
        caption = (
            "Posterior: weighted hexagonal histogram of the particles with percentile lines of the kernel density "
            "(black), the Gaussian (orange) and the Laplace approximation (green); marginals with "
            "priors (orange dashes)."
        )
        yield Captioned("posterior", "posterior", caption, whole(figure))
        axes = plots.plot_particles(posterior, names)
        yield Captioned("particles", "posterior", "The particles; area and colour show the weight.", whole(axes.figure))
    elif space.dim > 2:
        figure = plots.plot_pairs(posterior, truth=truth)
        yield Captioned("posterior", "posterior", "Posterior of all pairs of inputs.", whole(figure))
    if space.dim > 3:
        axes = plots.plot_parallel(posterior, truth=truth)
        caption = (
            "Each line is a particle, coloured by its log posterior density; lines of high density are drawn on top. "
            "An input whose axis the red lines cross everywhere is not known from the data."
        )
        yield Captioned("parallel", "posterior", caption, whole(axes.figure))
    curves = _quadrature_curves(space.names, calibration.quadrature)
    figure = plots.plot_marginals(posterior, overlays=curves, truth=truth)
    caption = "Marginal posteriors with priors" + (
        " and the direct quadrature of the same surrogate." if calibration.quadrature else "."
    )
    yield Captioned("marginals", "posterior", caption, whole(figure))


def _under_uncertainty(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the calibrated inputs in both readings, and the nuisance inputs (the study's Figs. 9d and 10)."""
    found, space = calibration.under_uncertainty, calibration.problem.space
    if found is None:
        return
    for name, reading in {"joint": found.joint, "cut": found.cut}.items():
        yield from _reading(name, reading, truth)
    exact = None if calibration.cut_quadrature is None else mixture(calibration.cut_quadrature)
    curves = _quadrature_curves(found.cut.names, exact)
    figure = plots.plot_marginals(found.cut.extended, found.cut.names, overlays=curves, truth=truth)
    caption = "Marginals of the cut reading with priors" + (" and direct quadrature." if curves else ".")
    yield Captioned("cut_marginals", "uncertainty", caption, whole(figure))
    names = [space.names[i] for i in space.nuisance]
    figure = plots.plot_marginals(calibration.posterior, names, truth=truth, whole_box=True)
    caption = (
        f"Prior of {', '.join(names)} (orange dashes), kept by the cut reading, and the joint reading's "
        "posterior of it."
    )
    yield Captioned("nuisance", "uncertainty", caption, whole(figure))


def _reading(name: str, reading: Reading, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the calibrated inputs in one reading; one input alone is among the marginals."""
    names = reading.names
    if len(names) == 2:
        figure = plots.plot_joint(reading.extended, (names[0], names[1]), truth=truth)
        caption = (
            f"Posterior under uncertainty, {name} reading: weighted hexagonal histogram with percentile lines of the "
            "kernel density (black) and the Gaussian (orange), fullest bin (green), mean; marginals with priors."
        )
    elif len(names) > 2:
        figure = plots.plot_pairs(reading.extended, names, truth=truth)
        caption = f"Posterior under uncertainty, {name} reading: all pairs of calibrated inputs."
    else:
        return
    yield Captioned(f"posterior_{name}", "uncertainty", caption, whole(figure))


def _quadrature_curves(names: Sequence[str], exact: QuadratureResult | None) -> dict[str, plots.Curve]:
    if exact is None:
        return {}
    curves = {}
    for name, marginal in zip(names, exact.marginals, strict=True):
        middle = 0.5 * (marginal.edges[1:] + marginal.edges[:-1])
        curves[name] = plots.Curve(middle, marginal.density, "quadrature")
    return curves


def _spoken(name: str) -> str:
    return name.replace("_", " ")
