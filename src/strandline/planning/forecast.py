"""The interface of a candidate as a function of the inputs: by the surrogate, or carried over from one run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.interface import Interface
from strandline.planning.transferred import transfer
from strandline.surrogate.field import FieldSurrogate
from strandline.surrogate.field.correspondence import fields_of

__all__ = ["Forecast", "carried", "covered", "field_of", "slopes_of_field"]

STEP = 1e-3
"""Step of the differences of a forecast, in widths of the box."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """The field of an experiment as a function of the inputs.

    Args:
        surrogate: Surrogate of the present field, whose points the field has.
        fields: Function from inputs (point, dim) to fields (point, value), mm.
    """

    surrogate: FieldSurrogate
    fields: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, "point value"]]

    def slopes(self, x: Float[np.ndarray, " dim"]) -> dict[str, Float[np.ndarray, "_ xyz dim"]]:
        """Return the derivatives of the points in the inputs at x by condition, mm per unit of the input."""
        low, high = self.surrogate.warping.low, self.surrogate.warping.high
        steps = np.diag(STEP * (high - low))
        ahead, behind = np.clip(x + steps, low, high), np.clip(x - steps, low, high)
        fields = self.fields(np.concatenate([ahead, behind]))
        rows = (fields[: len(x)] - fields[len(x) :]) / np.diag(ahead - behind)[:, None]
        return {name: np.moveaxis(one, 0, -1) for name, one in self.surrogate.by_condition(rows).items()}


def covered(surrogate: FieldSurrogate, known: Mapping[int, float]) -> Forecast:
    """Return the forecast of an experiment that the surrogate covers.

    Args:
        surrogate: The surrogate.
        known: Values of inputs that the experiment sets, by column.
    """

    def fields(x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point value"]:
        return surrogate.modes.fields(surrogate.mean(_with(x, known)))

    return Forecast(surrogate, fields)


def carried(
    surrogate: FieldSurrogate,
    at: Float[np.ndarray, " dim"],
    field: Float[np.ndarray, " value"],
    slopes: Float[np.ndarray, "value dim"],
    covariance: Float[np.ndarray, "dim dim"],
    known: Mapping[int, float],
) -> Forecast:
    """Return the forecast of another experiment, carried over from one run of it; see `transfer`.

    Args:
        surrogate: Surrogate of the present field.
        at: Inputs of the run.
        field: Field of the run.
        slopes: Its derivatives in the inputs.
        covariance: Covariance of the inputs.
        known: Values of inputs that the experiment sets, by column.
    """
    there = transfer(surrogate, _with(at[None], known)[0], field, slopes, covariance)
    return Forecast(surrogate, lambda x: there.fields(_with(x, known)))


def _with(x: Float[np.ndarray, "point dim"], known: Mapping[int, float]) -> Float[np.ndarray, "point dim"]:
    out = x.copy()
    for column, value in known.items():
        out[:, column] = value
    return out


def field_of(surrogate: FieldSurrogate, interfaces: Mapping[str, Interface]) -> Float[np.ndarray, " value"]:
    """Return interfaces by condition as a field of the surrogate, mm.

    Raises:
        NoCommonPoints: They have no points in common with it.
    """
    return np.asarray(fields_of([interfaces], surrogate.layouts)[0][0])


def slopes_of_field(
    surrogate: FieldSurrogate,
    sensitivities: Mapping[str, Mapping[str, Float[np.ndarray, "_ _"]]],
    names: Sequence[str],
) -> Float[np.ndarray, "value dim"] | None:
    """Return a run's sensitivities as derivatives of the field; None if it has other points or lacks an input."""
    if any(layout.way != "nodes" for layout in surrogate.layouts.values()):
        return None
    if any(name not in sensitivities.get(condition, {}) for condition in surrogate.layouts for name in names):
        return None
    rows = [np.stack([sensitivities[one][name].ravel() for name in names], axis=1) for one in surrogate.layouts]
    return np.concatenate(rows)
