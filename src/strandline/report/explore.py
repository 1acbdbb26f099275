"""The part of a report that a browser makes interactive: runs, interfaces and posterior, as data in the page."""

import base64
import gzip
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from markupsafe import Markup

from strandline.calibration import Calibration
from strandline.calibration.misfit import Prediction, by_field, by_runs
from strandline.calibration.usual_alternatives import prior_in_words
from strandline.interface import Interface
from strandline.models.offers import DrawsFields, undeformed_interface
from strandline.parameters import ParameterSpace
from strandline.posterior import systematic_indices
from strandline.report.inline import PANELS, PLOTLY, bundled, embedded, script_hash
from strandline.report.outlines import offsets_um, outline, predictive_band
from strandline.runs import RunRecord
from strandline.runs.ledger_schema import LOG_TITLE

__all__ = ["Explore", "explore", "inputs_as_json"]

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
DIGITS = 6


@dataclass(frozen=True, eq=False)
class Explore:
    """What the template of the section needs.

    Args:
        data: Data of the panels, JSON.
        runs: Number of runs in the page.
        of: Number of all runs.
        ok: Number of runs in the page that succeeded.
        outlines: Number of runs whose interfaces are in the page; None if nothing observed is a polyline.
        flow: Whether the model offers its fields.
    """

    data: Markup
    runs: int
    of: int
    ok: int
    outlines: int | None
    flow: bool

    @property
    def plotly(self) -> str:
        """The library that draws, compressed by gzip, as base64."""
        return base64.b64encode(gzip.compress(PLOTLY.read_bytes(), mtime=0)).decode("ascii")

    @property
    def licence(self) -> str:
        """The licence of the library."""
        return PLOTLY.with_name("plotly.LICENSE.txt").read_text(encoding="utf-8")

    @property
    def script(self) -> Markup:
        """The panels, which unpack the library."""
        return Markup(bundled("explore"))

    @property
    def style(self) -> Markup:
        """Style of the panels."""
        return Markup("".join((PANELS / name).read_text(encoding="utf-8") for name in ("panels.css", "explore.css")))

    @property
    def size(self) -> int:
        """Number of characters."""
        return sum(map(len, (self.data, self.plotly, self.script, self.style)))

    @property
    def policy(self) -> Markup:
        """The two scripts as the page's security policy has them."""
        return Markup(" ".join(f"'{script_hash(one)}'" for one in (PLOTLY.read_text(encoding="utf-8"), self.script)))


def explore(
    calibration: Calibration,
    truth: Mapping[str, float] | None,
    pictures: Mapping[str, Mapping[str, Any]] | None = None,
) -> Explore:
    """Return what the panels show, thinned so that it fits into a page.

    Args:
        calibration: Result of the calibration.
        truth: Inputs of a synthetic observation.
        pictures: Pictures behind the interfaces by condition, with size, place and address.
    """
    every, space = calibration.all_runs, calibration.problem.space
    observed = {seen.condition: seen.interface for seen in calibration.problem.observations if seen.interface.dim == 2}
    order = _best_first(calibration)
    rows = _some(order, len(every), MOST_RUNS)
    outlines = _outlines(calibration, observed, rows, order)
    data = {
        "facts": {
            "inputs": inputs_as_json(space),
            "fixed": {name: _short(value) for name, value in calibration.problem.fixed.items()},
            "truth": None if truth is None else dict(truth),
            "conditions": _conditions(calibration, observed, pictures or {}),
        },
        "state": {"open": 0},
        "runs": _columns(every, rows, space),
        "details": {row: found for row in rows if (found := _details(every[row]))},
        "interfaces": outlines,
        "posterior": _posterior(calibration, observed),
    }
    return Explore(
        data=embedded(data),
        runs=len(rows),
        of=len(every),
        ok=sum(every[row].ok for row in rows),
        outlines=len(outlines) if observed else None,
        flow=isinstance(calibration.problem.model, DrawsFields),
    )


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


def _best_first(calibration: Calibration) -> list[int]:
    """Return the rows of the runs with a log-likelihood, the highest first."""
    place = {record.key: row for row, record in enumerate(calibration.all_runs)}
    values = next(iter(calibration.log_likelihoods.values()))
    used = [record.key for record in calibration.records if record.ok]
    return [place[used[i]] for i in np.argsort(-values, kind="stable") if used[i] in place]


def _some(best_first: Sequence[int], number: int, most: int, among: Sequence[int] | None = None) -> list[int]:
    """Return rows in order, at most so many: the best ones, and others at equal distances.

    Args:
        best_first: Rows, the best first.
        number: Number of all rows.
        most: Number of rows to return.
        among: Rows to choose from; by default all.
    """
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
        "seconds": [_short(one.seconds, 3) for one in some],
        "inputs": {name: [_short(one.inputs[name]) for one in some] for name in space.names},
    }


def _details(record: RunRecord) -> dict[str, Any]:
    """Return message and log of a run that failed, and the figures of any run."""
    found: dict[str, Any] = {}
    figures = [(name, _short(value, 4)) for name, value in record.diagnostics.items() if math.isfinite(value)]
    if figures:
        found["diagnostics"] = dict(figures[:FIGURES])
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
    return {
        row: {
            name: {
                "line": _few(outline(every[row].interfaces[name]), MOST_POINTS),
                "offsets": offsets_um(seen, every[row].interfaces[name]) if len(seen.points) <= MOST_OBSERVED else None,
            }
            for name, seen in observed.items()
        }
        for row in _some(best_first, len(every), most, ok)
    }


def _few(line: Sequence[Sequence[float]], most: int) -> list[list[float]]:
    """Return a polyline through at most so many of its points."""
    kept = _spread(len(line[0]), most)
    return [[column[i] for i in kept.tolist()] for column in line]


def _conditions(
    calibration: Calibration, observed: Mapping[str, Interface], pictures: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    rest = undeformed_interface(calibration.problem.model)
    flat = None if rest is None or rest.dim != 2 else _few(outline(rest), MOST_POINTS)
    return [
        {
            "name": name,
            "observed": _few(outline(seen), MOST_OBSERVED),
            "undeformed": flat,
            "picture": pictures.get(name),
        }
        for name, seen in observed.items()
    ]


def _posterior(calibration: Calibration, observed: Mapping[str, Interface]) -> dict[str, Any]:
    posterior, names = calibration.posterior, calibration.problem.space.names
    draws = posterior.draws[systematic_indices(posterior.weights, DRAWS, np.random.default_rng(0))]
    return {
        "source": "stored",
        "why_none": "",
        "mean": dict(zip(names, posterior.mean.tolist(), strict=True)),
        "sd": dict(zip(names, posterior.sd.tolist(), strict=True)),
        "draws": {name: [_short(value, 5) for value in draws[:, i].tolist()] for i, name in enumerate(names)},
        "bands": _bands(calibration, observed, draws),
        "surrogate": None,
    }


def _bands(
    calibration: Calibration, observed: Mapping[str, Interface], draws: Float[np.ndarray, "draw dim"]
) -> dict[str, Any]:
    """Return the interface at the posterior mean and a band around it, by condition; nothing if no field is known."""
    if not observed:
        return {}
    prediction = _prediction(calibration)
    if prediction.run_alone:
        return {}
    few = np.random.default_rng(0).permutation(draws)[:BAND_DRAWS]
    found = predictive_band(prediction, calibration.posterior.mean, few)
    return {
        name: {
            "line": _few(one["line"], MOST_POINTS),
            "band": None if one["band"] is None else _few(one["band"], 2 * MOST_POINTS),
        }
        for name, one in found.items()
    }


def _prediction(calibration: Calibration) -> Prediction:
    """Return the interface as a function of the inputs, learnt from the best runs if the study learns none."""
    if calibration.field is not None:
        return by_field(calibration.field.knowledge.surrogate)
    problem = calibration.problem
    return by_runs(
        calibration.training,
        [record for record in calibration.records if record.ok],
        next(iter(calibration.log_likelihoods.values())),
        problem.space,
        problem.observations,
        next(iter(problem.discrepancies.values())),
    )


def _short(value: float, digits: int = DIGITS) -> float | None:
    """Return a number with few digits; None if it is not finite."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None
