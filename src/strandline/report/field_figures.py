"""The figures of a posterior from a surrogate of the field: history, errors and predicted interfaces."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from strandline.calibration import Calibration
from strandline.design.active import FieldOutcome
from strandline.interface import GLOBAL, Interface, Observation
from strandline.posterior import interface_band, normal_offsets, observed_offsets, subset
from strandline.report import plots
from strandline.report.captioned import Captioned, whole
from strandline.text import listed

__all__ = ["field_figures"]

DRAWS = 400


def field_figures(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield the figures; none if the surrogate is one of the log-likelihood."""
    found = calibration.field
    if found is None:
        return
    yield from _history(calibration, found, truth)
    chosen = subset(calibration.posterior.weights, min(DRAWS, calibration.posterior.number), 0)
    x = calibration.posterior.draws[chosen]
    errors = plots.plot_field_error(_errors(found, x))
    caption = (
        "Error of the surrogate along the interface: the median over the runs, each predicted from all others, and "
        "the surrogate's own estimate, the median over draws of the posterior."
    )
    yield Captioned("field_error", "surrogate", caption, whole(errors.figure))
    yield from _predictive(calibration, found, x)


def _history(calibration: Calibration, found: FieldOutcome, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    certificate, space = found.certificate, calibration.problem.space
    if certificate is None or len(certificate.steps) < 2:
        return
    steps = certificate.steps
    history = plots.RunHistory(
        runs=np.array([step.runs for step in steps], float),
        mean=np.array([step.mean for step in steps]),
        sd=np.array([step.sd for step in steps]),
        checked=[step.kind == "check" for step in steps],
    )
    at = None if truth is None else [truth[name] for name in space.names]
    figure = plots.plot_run_history(history, [parameter.figure_label() for parameter in space], truth=at)
    caption = "The posterior against the number of runs: means with a band of one standard deviation."
    yield Captioned("run_history", "certificate", caption, whole(figure))


def _errors(found: FieldOutcome, x: Float[np.ndarray, "draw dim"]) -> dict[str, plots.ErrorsAlong]:
    surrogate = found.knowledge.surrogate
    basis, roots = surrogate.modes.basis, surrogate.modes.roots
    cut_off = np.sum(surrogate.modes.tail**2, axis=0)
    left_out = surrogate.left_out_fields() ** 2 + cut_off / roots**2
    predicted = (surrogate.predict(x).variance @ basis**2 + cut_off) / roots**2
    out, begin = {}, 0
    for name, layout in surrogate.layouts.items():
        template = layout.template
        values = slice(begin, begin + template.points.size)
        begin += template.points.size
        shape = template.points.shape
        squares, own = (a[:, values].reshape(-1, *shape).sum(axis=2) for a in (left_out, predicted))
        middle = (np.sqrt(np.median(a, axis=0)) for a in (squares, own))
        out[name] = plots.ErrorsAlong(_arc_length(template), *middle)
    return out


def _predictive(calibration: Calibration, found: FieldOutcome, x: Float[np.ndarray, "draw dim"]) -> Iterator[Captioned]:
    surrogate = found.knowledge.surrogate
    points = surrogate.points(surrogate.mean(x))
    seen = {o.condition: o.interface for o in calibration.problem.observations}
    for name, layout in surrogate.layouts.items():
        if layout.template.dim != 2:
            continue
        band = interface_band(points[name])
        centre = layout.with_points(band.median)
        along = normal_offsets(np.stack([band.low, band.median, band.high]), centre)
        observed = observed_offsets(seen[name], centre)
        low, median, high = np.quantile(normal_offsets(points[name], centre).offset, (0.05, 0.5, 0.95), axis=0)
        drawn = plots.OffsetBand(along.arc_length, low, median, high, observed.arc_length, observed.offset)
        of = f" of {name}" if name else ""
        caption = f"What the posterior predicts{of}: the interface of its draws, and the observed one."
        caption += _as_stated(next(o for o in calibration.problem.observations if o.condition == name))
        axes = plots.plot_offsets(drawn)
        yield Captioned(f"predictive{'_' + name if name else ''}", "certificate", caption, whole(axes.figure))


def _as_stated(seen: Observation) -> str:
    """Return a sentence on the errors of the whole observed interface that the figure does not take out of it."""
    unknown = [name for name in GLOBAL if getattr(seen.noise, name, 0.0) > 0]
    if not unknown:
        return ""
    return f" The observed one is drawn where it was measured: its unknown {listed(unknown)} can explain a distance."


def _arc_length(interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length at each point of a polyline, or the number of each point of a surface."""
    if interface.dim != 2:
        return np.arange(len(interface.points), dtype=float)
    return normal_offsets(interface.points[None], interface).arc_length
