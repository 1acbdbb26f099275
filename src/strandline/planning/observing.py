"""How all interfaces of an experiment are observed: predicted interfaces as signals, slopes as Fisher information."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.calibration.experiment import CoordinateErrors
from strandline.discrepancy import NormalOffset
from strandline.interface import ErrorModel, Observation, PointErrors
from strandline.likelihood.joint_errors import error_model
from strandline.likelihood.shared_errors import shared_errors
from strandline.planning.signals import signals_of
from strandline.planning.view import View

__all__ = ["Nodes", "Observing"]

Nodes = Mapping[str, Float[np.ndarray, "_ _ _"]]
"""Nodes of simulated interfaces by condition, one interface a row, mm."""


@dataclass(frozen=True, eq=False)
class Observing:
    """The views of an experiment, and the interfaces about which the displacements are small.

    Args:
        views: Views by condition.
        reference: Nodes of a simulated interface by condition, mm.
    """

    views: Mapping[str, View]
    reference: Mapping[str, Float[np.ndarray, "_ _"]]

    def signals(self, nodes: Nodes) -> Float[np.ndarray, "draw signal"]:
        """Return what would be observed of interfaces, in standard deviations of independent errors."""
        rows = [view.rows(self.reference[n], nodes[n] - self.reference[n]) for n, view in self.views.items()]
        return signals_of(np.hstack(rows), self.information)

    def fisher(self, slopes: Mapping[str, Float[np.ndarray, "_ xyz dim"]]) -> Float[np.ndarray, "dim dim"]:
        """Return the Fisher information of the inputs.

        Args:
            slopes: Derivatives of the nodes in the inputs by condition, mm per unit of the input.
        """
        rows = [view.rows(self.reference[n], np.moveaxis(slopes[n], -1, 0)) for n, view in self.views.items()]
        return self.information(np.hstack(rows).T)

    def information(self, directions: Float[np.ndarray, "row some"]) -> Float[np.ndarray, "some some"]:
        """Return Vᵀ C⁻¹ V for displacements V of all observed points and the covariance C of their errors, 1/mm²."""
        model = self._model
        if model is not None:
            return model.information(directions)
        total, first = np.zeros((directions.shape[1], directions.shape[1])), 0
        for name, view in self.views.items():
            errors, number = view.errors, len(view.footprint.corners)
            if isinstance(errors, CoordinateErrors):
                rows = directions[first : first + number * self.reference[name].shape[1]]
                total += rows.T @ rows / errors.sd**2
            else:
                rows = directions[first : first + number]
                total += errors.model(view.seen(self.reference[name])).information(rows)
            first += len(rows)
        return total

    @cached_property
    def _model(self) -> ErrorModel | None:
        """Covariance of all errors together; None if an interface has errors of coordinates."""
        seen, known = [], []
        for name, view in self.views.items():
            if not isinstance(view.errors, PointErrors):
                return None
            seen.append(Observation(view.seen(self.reference[name]), view.errors, name))
            known.append(view.errors)
        joint = shared_errors(seen, NormalOffset())
        return error_model(seen, known) if joint is None else joint.model

    def displacement(self, undeformed: Mapping[str, Float[np.ndarray, "_ _"]]) -> float:
        """Return the displacement of the reference from other nodes, root mean square, in standard deviations.

        Args:
            undeformed: Nodes of the undeformed interface by condition, mm.
        """
        squares = []
        for name, view in self.views.items():
            here = view.seen(self.reference[name])
            rows = view.rows(self.reference[name], (self.reference[name] - undeformed[name])[None])[0]
            sds = view.errors.sds(here) if isinstance(view.errors, PointErrors) else np.array(view.errors.sd)
            squares.append((rows / sds) ** 2)
        return float(np.sqrt(np.concatenate(squares).mean()))
