"""Runs, interfaces and posterior as data of the panels, and the part of a report that holds them."""

import base64
import gzip
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from markupsafe import Markup

from strandline.calibration import Calibration, Prediction, by_field, by_runs, prior_in_words
from strandline.discrepancy import signed_distances
from strandline.interface import Interface, node_normals
from strandline.models import ForwardModel, draws_fields, undeformed_interface
from strandline.parameters import ParameterSpace
from strandline.posterior import systematic_indices
from strandline.report.fields import without_coefficients
from strandline.report.html import PANELS, PLOTLY, bundled, embedded, script_hash
from strandline.runs import LOG_TITLE, RunRecord

SDS = 2.0
"""Half of the width of a band, in standard deviations."""
DECIMALS, DIGITS = 6, 6
"""Of coordinates in mm: a nanometre; of other numbers."""
MOST_RUNS, MOST_OUTLINES, MOST_NUMBERS = 1000, 200, 120_000
"""Runs that a page holds, runs with their interfaces, and numbers of which these may consist."""
BEST = 0.5
"""Share of the runs that a page holds, with or without interface, that have the highest log-likelihood."""
MOST_POINTS, MOST_OBSERVED = 100, 2000
"""Points of a simulated and of an observed interface."""
DRAWS, BAND_DRAWS = 2000, 200
"""Draws of the posterior in the page, and those whose interfaces make its band."""
CHARACTERS, LOG_LINES, FIGURES = 500, 8, 12
"""Characters of a message, and of a log with so many lines; figures of a run."""


def inputs_as_json(space: ParameterSpace) -> list[dict[str, Any]]:
    """Return the inputs as the panels show them."""
    return [
        {
            "name": one.name,
            "label": one.shown,
            "unit": "" if one.unit == "1" else one.unit,
            "low": one.interval[0],
            "high": one.interval[1],
            "nuisance": one.nuisance,
            "prior": prior_in_words(one.prior),
            "middle": float(one.truncated_prior.quantile(0.5)),
        }
        for one in space
    ]


def conditions_as_json(
    model: ForwardModel, observed: Mapping[str, Interface | None], pictures: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return each condition with what was observed (None if not known yet), undeformed interface and picture."""
    rest = undeformed_interface(model)
    flat = None if rest is None or rest.dim != 2 else _few(outline(rest), MOST_POINTS)
    shown = {name: None if seen is None else _few(outline(seen), MOST_OBSERVED) for name, seen in observed.items()}
    return [
        {"name": name, "observed": line, "undeformed": flat, "picture": pictures.get(name)}
        for name, line in shown.items()
    ]


def by_name(space: ParameterSpace, values: Float[np.ndarray, " dim"]) -> dict[str, float | None]:
    """Return a number for each input; None for one that is not finite."""
    each = (value if math.isfinite(value) else None for value in values.tolist())
    return dict(zip(space.names, each, strict=True))


def columns(
    space: ParameterSpace, draws: Float[np.ndarray, "draw dim"], digits: int = DIGITS
) -> dict[str, list[float | None]]:
    """Return the draws of each input, with so many significant digits."""
    return {name: rounded(values, digits) for name, values in zip(space.names, draws.T, strict=True)}


def rounded(values: Sequence[float | None] | Float[np.ndarray, " _"], digits: int = DIGITS) -> list[float | None]:
    """Return numbers with so many significant digits; None for those that are not finite."""
    given = np.array(values, dtype=float).tolist()
    return [float(f"{one:.{digits}g}") if math.isfinite(one) else None for one in given]


def outline(interface: Interface) -> list[list[float]]:
    """Return the points of a polyline, [[x, …], [y, …]], mm, in order, closed by the first one; those of a surface."""
    order = _in_order(interface) if interface.dim == 2 else slice(None)
    return np.round(interface.points[order].T, DECIMALS).tolist()  # type: ignore[no-any-return]


def _in_order(interface: Interface) -> list[int]:
    """Return the numbers of the points along a polyline."""
    return [*interface.cells[:, 0].tolist(), int(interface.cells[-1, 1])]


def offsets_um(observed: Interface, predicted: Interface) -> list[float] | None:
    """Return the signed distances of the observed points from a prediction, µm; None if they cannot be compared."""
    if observed.dim != predicted.dim:
        return None
    return [float(f"{1e3 * one:.4g}") for one in signed_distances(observed.points, predicted)]


def point_normals(interface: Interface) -> Float[np.ndarray, "point xyz"]:
    """Return the unit normal of an interface at each of its points."""
    return np.asarray(node_normals(interface.points[None], interface.cells)[0])


def band(interface: Interface, width: Float[np.ndarray, " point"]) -> list[list[float]] | None:
    """Return the outline of a band on both sides of a polyline, mm; None for a surface."""
    if interface.dim != 2:
        return None
    order, off = _in_order(interface), width[:, None] * point_normals(interface)
    ends = np.concatenate([(interface.points + off)[order], (interface.points - off)[order][::-1]])
    return np.round(ends.T, DECIMALS).tolist()  # type: ignore[no-any-return]


def predictive_band(
    prediction: Prediction, mean: Float[np.ndarray, " dim"], draws: Float[np.ndarray, "draw dim"]
) -> dict[str, dict[str, Any]]:
    """Return by condition the interface at the posterior mean, and twice the spread of those of posterior draws."""
    central, drawn, out = prediction.points(mean[None]), prediction.points(draws), {}
    for name, template in prediction.templates.items():
        interface = Interface(central[name][0], template.cells)
        off = np.einsum("dpx,px->dp", drawn[name] - drawn[name].mean(axis=0), point_normals(interface))
        out[name] = {"line": outline(interface), "band": band(interface, SDS * off.std(axis=0))}
    return out


def explore(
    calibration: Calibration, truth: Mapping[str, float] | None, pictures: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """Return what the template of the section needs: data of the panels, thinned to fit into a page, and scripts.

    The page has `runs` `of` all, `ok` of which succeeded; of `outlines` it has the interfaces, None if nothing observed
    is a polyline.
    """
    every, problem = calibration.all_runs, calibration.problem
    observed = {seen.condition: seen.interface for seen in problem.observations if seen.interface.dim == 2}
    order = _best_first(calibration)
    rows = _some(order, len(every), MOST_RUNS)
    outlines = _outlines(calibration, observed, rows, order)
    data = {
        "facts": {
            "inputs": inputs_as_json(problem.space),
            "fixed": dict(zip(problem.fixed, rounded(list(problem.fixed.values())), strict=True)),
            "truth": None if truth is None else dict(truth),
            "conditions": conditions_as_json(problem.model, observed, pictures or {}),
        },
        "state": {"open": 0},
        "runs": _columns(every, rows, problem.space),
        "details": {row: found for row in rows if (found := _details(every[row]))},
        "interfaces": outlines,
        "posterior": _posterior(calibration, observed),
    }
    plotly, script = PLOTLY.read_bytes(), bundled()
    packed = base64.b64encode(gzip.compress(plotly, mtime=0)).decode("ascii")
    style = Markup((PANELS / "panels.css").read_text(encoding="utf-8"))
    shown = without_coefficients(data, problem.space)
    large = {"data": embedded(shown), "plotly": packed, "script": Markup(script), "style": style}
    return {
        **large,
        "size": sum(map(len, large.values())),
        "licence": PLOTLY.with_name("plotly.LICENSE.txt").read_text(encoding="utf-8"),
        "policy": Markup(" ".join(f"'{script_hash(one)}'" for one in (plotly.decode(), script))),
        "runs": len(rows),
        "of": len(every),
        "ok": sum(every[row].ok for row in rows),
        "outlines": len(outlines) if observed else None,
        "flow": draws_fields(problem.model),
    }


def _best_first(calibration: Calibration) -> list[int]:
    """Return the rows of the runs with a log-likelihood, the highest first."""
    place = {record.key: row for row, record in enumerate(calibration.all_runs)}
    values = next(iter(calibration.log_likelihoods.values()))
    used = [record.key for record in calibration.records if record.ok]
    return [place[used[i]] for i in np.argsort(-values, kind="stable") if used[i] in place]


def _some(best_first: Sequence[int], number: int, most: int, among: Sequence[int] | None = None) -> list[int]:
    """Return at most so many rows, of all or `among` some, in order: the best ones, and others at equal distances."""
    rows = list(range(number)) if among is None else list(among)
    if len(rows) <= most:
        return rows
    allowed = set(rows)
    chosen = set([row for row in best_first if row in allowed][: round(BEST * most)])
    rest = [row for row in rows if row not in chosen]
    return sorted(chosen | {rest[i] for i in _spread(len(rest), most - len(chosen)).tolist()})


def _spread(number: int, most: int) -> Int[np.ndarray, " point"]:
    """Return at most so many indices at equal distances, with the first and the last."""
    return np.unique(np.linspace(0, number - 1, min(number, most)).round().astype(int))


def _columns(every: Sequence[RunRecord], rows: Sequence[int], space: ParameterSpace) -> dict[str, Any]:
    some = [every[row] for row in rows]
    return {
        "row": list(rows),
        "number": list(rows),
        "state": [one.state for one in some],
        "kind": [one.failure_kind for one in some],
        "seconds": rounded([one.seconds for one in some], 3),
        "inputs": {name: rounded([one.inputs[name] for one in some]) for name in space.names},
    }


def _details(record: RunRecord) -> dict[str, Any]:
    """Return message and log of a run that failed, and the figures of any run."""
    found: dict[str, Any] = {}
    figures = [(name, value) for name, value in record.diagnostics.items() if math.isfinite(value)][:FIGURES]
    if figures:
        found["diagnostics"] = {name: float(f"{value:.4g}") for name, value in figures}
    if record.message:
        found["message"] = record.message.partition(f"\n{LOG_TITLE}\n")[0][:CHARACTERS]
    if record.log:
        found["log"] = "\n".join(record.log.splitlines()[-LOG_LINES:])[-CHARACTERS:]
    return found


def _outlines(
    calibration: Calibration, observed: Mapping[str, Interface], rows: Sequence[int], best_first: Sequence[int]
) -> dict[int, dict[str, Any]]:
    """Return interfaces by run and condition, with the signed distances of the observed points."""
    every = calibration.all_runs
    ok = [row for row in rows if every[row].ok]
    if not observed or not ok:
        return {}
    compared = [seen for seen in observed.values() if len(seen.points) <= MOST_OBSERVED]
    each = 2 * MOST_POINTS * len(observed) + sum(len(seen.points) for seen in compared)
    most = max(1, min(MOST_OUTLINES, MOST_NUMBERS // each))

    def shown(seen: Interface, found: Interface) -> dict[str, Any]:
        offsets = offsets_um(seen, found) if len(seen.points) <= MOST_OBSERVED else None
        return {"line": _few(outline(found), MOST_POINTS), "offsets": offsets}

    return {
        row: {name: shown(seen, every[row].interfaces[name]) for name, seen in observed.items()}
        for row in _some(best_first, len(every), most, ok)
    }


def _few(line: Sequence[Sequence[float]], most: int) -> list[list[float]]:
    """Return a polyline through at most so many of its points."""
    kept = _spread(len(line[0]), most)
    return [[column[i] for i in kept.tolist()] for column in line]


def _posterior(calibration: Calibration, observed: Mapping[str, Interface]) -> dict[str, Any]:
    posterior, space = calibration.posterior, calibration.problem.space
    draws = posterior.draws[systematic_indices(posterior.weights, DRAWS, np.random.default_rng(0))]
    return {
        "source": "stored",
        "why_none": "",
        "mean": by_name(space, posterior.mean),
        "sd": by_name(space, posterior.sd),
        "draws": columns(space, draws, 5),
        "bands": _bands(calibration, draws) if observed else {},
        "surrogate": None,
    }


def _bands(calibration: Calibration, draws: Float[np.ndarray, "draw dim"]) -> dict[str, Any]:
    """Return the interface at the posterior mean and a band around it, by condition; nothing if no field is known.

    The interface as a function of the inputs is the study's own surrogate or, without one, learnt from the best runs.
    """
    problem = calibration.problem
    if calibration.field is not None:
        prediction = by_field(calibration.field.knowledge.surrogate)
    else:  # learnt from the best runs
        good = [record for record in calibration.records if record.ok]
        values = next(iter(calibration.log_likelihoods.values()))
        known = problem.space, problem.observations, problem.measure
        prediction = by_runs(calibration.training, good, values, *known)
    if prediction.run_alone:
        return {}
    few, most = np.random.default_rng(0).permutation(draws)[:BAND_DRAWS], {"line": MOST_POINTS, "band": 2 * MOST_POINTS}
    drawn = predictive_band(prediction, calibration.posterior.mean, few).items()
    return {name: {part: line and _few(line, most[part]) for part, line in one.items()} for name, one in drawn}
