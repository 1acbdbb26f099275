"""The figures of a calibration, each with a name and a caption, drawn one after the other."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration import Calibration, ConditionMisfit
from strandline.foundations import ForwardModelError
from strandline.interface import Interface
from strandline.models import DrawsFields, undeformed_interface
from strandline.parameters import ParameterSpace
from strandline.posterior import Histogram, QuadratureResult, Reading, mixture, observed_offsets
from strandline.report import plots
from strandline.report.figure_files import Captioned
from strandline.report.html import number
from strandline.report.plots.picture import plot_surfaces
from strandline.report.surrogate_figures import field_figures, likelihood_figures, surrogate_figures

BEST = "best run"
EXAMPLES = (0.1, 0.8, 1.0)
"""Quantiles of the displacement at which runs are drawn as examples."""
BEST_RUNS = ("best", "second", "third", "fourth", "fifth")
"""The runs whose offsets are drawn; the best one is at zero."""
CONSPICUOUS = 0.05
"""Parts of an arc with a smaller p-value are marked in the figure."""


def figure_groups(calibration: Calibration, truth: Mapping[str, float] | None) -> dict[str, Iterator[Captioned]]:
    """Return the figures of a calibration in groups; each is drawn on request.

    Figures of exactly two inputs are left out if there are fewer or more.
    """
    return {
        "fit": fit_figures(calibration),
        "data": chain(_data(calibration, truth), _offsets(calibration), failed_runs(calibration)),
        "likelihood": likelihood_figures(calibration, truth),
        "surrogate": surrogate_figures(calibration),
        "sampler": _sampler(calibration),
        "posterior": _posterior(calibration, truth),
        "under uncertainty": _under_uncertainty(calibration, truth),
        "field": field_figures(calibration, truth),
    }


def fit_figures(calibration: Calibration) -> Iterator[Captioned]:
    """Yield the residuals along the observed polylines; nothing for surfaces."""
    found = calibration.misfit
    drawn = {one.condition: _along(one) for one in (found.conditions if found else ()) if not one.surface}
    if drawn:
        yield Captioned.of("residuals", "fit", plots.plot_residuals(drawn))


def _along(found: ConditionMisfit) -> plots.ResidualsAlong:
    conspicuous = tuple((one.begin, one.end) for one in found.regions if one.p_value < CONSPICUOUS)
    return plots.ResidualsAlong(found.arc_length, found.residual, found.expected.sd, conspicuous)


def _data(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    problem, space = calibration.problem, calibration.problem.space
    at = truth if truth is not None else {**problem.fixed, **space.as_mapping(calibration.posterior.map_estimate)}
    if isinstance(problem.model, DrawsFields):
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
    every = {
        _in_legend(problem.space, [record.inputs[name] for name in problem.space.names]): record.interfaces
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


def _in_legend(space: ParameterSpace, values: Sequence[float] | Float[np.ndarray, " dim"]) -> str:
    """Return inputs with their symbols, as a legend shows them."""
    symbols = [replace(parameter, unit="1").figure_label() for parameter in space]
    return ", ".join(f"{symbol} = {number(float(value), 3)}" for symbol, value in zip(symbols, values, strict=True))


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
    if space.dim <= 2 or not failed:
        return
    inputs = np.array([[record.inputs[name] for name in space.names] for record in calibration.records], float)
    by_kind = {kind: inputs[[its == kind for its in kinds]] for kind, _ in failed.most_common()}
    axes = plots.plot_failed_runs(space, inputs[[not its for its in kinds]], by_kind)
    yield Captioned.of("failed_runs", "runs", axes)


def _sampler(calibration: Calibration) -> Iterator[Captioned]:
    steps, halves = calibration.sampling.steps, calibration.sampling.halves
    figure = plots.plot_tempering(
        [s.temperature for s in steps],
        [s.ess for s in steps],
        [s.acceptance for s in steps],
        particles=calibration.settings.particles if halves is None else len(halves[0].positions),
    )
    yield Captioned.of("tempering", "sampler", figure, halves=halves is not None)


def _posterior(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    posterior, space = calibration.posterior, calibration.problem.space
    if space.dim == 2:
        names = (space.names[0], space.names[1])
        figure = plots.plot_joint(posterior, names, laplace=calibration.laplace, truth=truth)
        yield Captioned.of("posterior", "posterior", figure, two=True)
        yield Captioned.of("particles", "posterior", plots.plot_particles(posterior, names))
    elif space.dim > 2:
        yield Captioned.of("posterior", "posterior", plots.plot_corner(posterior, truth=truth), two=False)
    if space.dim > 3:
        yield Captioned.of("parallel", "posterior", plots.plot_parallel(posterior, truth=truth))
    exact = _by_quadrature(space.names, calibration.quadrature)
    figure = plots.plot_marginals(posterior, exact=exact, truth=truth)
    yield Captioned.of("marginals", "posterior", figure, exact=bool(exact))


def _under_uncertainty(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the calibrated inputs in both readings, and the nuisance inputs (the study's Figs. 9d and 10)."""
    found, space = calibration.under_uncertainty, calibration.problem.space
    if found is None:
        return
    for name, reading in {"joint": found.joint, "cut": found.cut}.items():
        yield from _reading(name, reading, truth)
    exact = None if calibration.cut_quadrature is None else mixture(calibration.cut_quadrature)
    curves = _by_quadrature(found.cut.names, exact)
    figure = plots.plot_marginals(found.cut.extended, found.cut.names, exact=curves, truth=truth)
    yield Captioned.of("cut_marginals", "uncertainty", figure, exact=bool(curves))
    names = [space.names[i] for i in space.nuisance]
    figure = plots.plot_marginals(calibration.posterior, names, truth=truth, whole_box=True)
    yield Captioned.of("nuisance", "uncertainty", figure, names=names)


def _reading(name: str, reading: Reading, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
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
