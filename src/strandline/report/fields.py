"""Random fields in a report, and what of their many coefficients it leaves out."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from strandline.calibration import Calibration
from strandline.parameters import ParameterSpace
from strandline.posterior import FieldPosterior, Posterior
from strandline.report import plots
from strandline.report.plots.random_field import directions
from strandline.report.plots.style import Captioned


def random_field_figures(calibration: Calibration, truth: Mapping[str, float] | None) -> Iterator[Captioned]:
    """Yield a sheet for each random field."""
    for name, found in calibration.posterior.fields.items():
        field, true = found.field, _true(found, truth)
        kind = ("line", "plane", "space")[len(directions(field.support.points)) - 1]
        figure = plots.plot_random_field(found, truth=None if true is None else field.values(true.inputs)[0])
        yield Captioned.of("random_field", f"field {name}", figure, of=name, kind=kind, log=field.prior.log)


def _true(found: FieldPosterior, truth: Mapping[str, float] | None) -> FieldPosterior | None:
    """Return a field of which the true inputs are the only draw, if they are known."""
    if truth is None or not set(found.field.names) <= set(truth):
        return None
    inputs = np.array([[truth[one] for one in found.field.names]])
    return FieldPosterior(found.field, inputs, np.ones(1), inputs)


def _functionals(found: FieldPosterior, true: FieldPosterior | None) -> dict[str, Any]:
    known = {} if true is None else {which: {"truth": one.mean} for which, one in true.functionals.items()}
    return {which: asdict(one) | known.get(which, {}) for which, one in found.functionals.items()}


def fields_as_json(posterior: Posterior, truth: Mapping[str, float] | None) -> dict[str, Any]:
    """Return what summary.json says of each random field."""
    return {
        name: {
            "unit": found.field.unit,
            "modes": found.field.count,
            "share_of_variance": found.field.share,
            "prior": found.field.words,
            "points": len(found.share_left),
            "functionals": _functionals(found, _true(found, truth)),
            "share_of_prior_sd_left": {
                "least": float(found.share_left.min()),
                "median": float(np.median(found.share_left)),
                "largest": float(found.share_left.max()),
                "points_above_90_percent": found.unknown,
            },
            "statement": found.statement,
        }
        for name, found in posterior.fields.items()
    }


def without_coefficients(content: Any, space: ParameterSpace) -> Any:
    """Return content of a JSON file without the entries of coefficients of fields, at any depth."""
    held = set(space.names) - set(space.scalars)
    return _without(content, held) if held else content


def _without(content: Any, held: set[str]) -> Any:
    if isinstance(content, Mapping):
        return {name: _without(value, held) for name, value in content.items() if name not in held}
    if isinstance(content, list | tuple):
        return [_without(one, held) for one in content if not (isinstance(one, Mapping) and one.get("name") in held)]
    return content
