"""Interfaces as pages draw them: polylines in millimetres, and the bands around them."""

from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit import Prediction
from strandline.discrepancy.normal_offset import signed_distances
from strandline.interface import Interface
from strandline.interface.normals import node_normals

__all__ = ["SDS", "band", "offsets_um", "outline", "point_normals", "predictive_band"]

SDS = 2.0
"""Half of the width of a band, in standard deviations."""
DECIMALS = 6
"""Of coordinates in mm: a nanometre."""


def outline(interface: Interface) -> list[list[float]]:
    """Return the points of a polyline in order, [[x, …], [y, …]], mm; the first one again at the end if it is closed.

    A surface is shown by its points.
    """
    if interface.dim != 2:
        return [np.round(column, DECIMALS).tolist() for column in interface.points.T]
    order = [*interface.cells[:, 0], interface.cells[-1, 1]]
    return [np.round(column, DECIMALS).tolist() for column in interface.points[order].T]


def offsets_um(observed: Interface, predicted: Interface) -> list[float] | None:
    """Return the signed distances of the observed points from a prediction, µm; None if they cannot be compared."""
    if observed.dim != predicted.dim:
        return None
    return [float(f"{1e3 * one:.4g}") for one in signed_distances(observed.points, predicted)]


def predictive_band(
    prediction: Prediction, mean: Float[np.ndarray, " dim"], draws: Float[np.ndarray, "draw dim"]
) -> dict[str, dict[str, Any]]:
    """Return by condition the interface at the posterior mean, and twice the spread of the posterior's interfaces.

    Args:
        prediction: Interfaces as a function of the inputs.
        mean: Posterior mean.
        draws: Equally weighted draws of the posterior.
    """
    central, drawn, out = prediction.points(mean[None]), prediction.points(draws), {}
    for name, template in prediction.templates.items():
        interface = Interface(central[name][0], template.cells)
        off = np.einsum("dpx,px->dp", drawn[name] - drawn[name].mean(axis=0), point_normals(interface))
        out[name] = {"line": outline(interface), "band": band(interface, SDS * off.std(axis=0))}
    return out


def point_normals(interface: Interface) -> Float[np.ndarray, "point xyz"]:
    """Return the unit normal of an interface at each of its points."""
    return np.asarray(node_normals(interface.points[None], interface.cells)[0])


def band(interface: Interface, width: Float[np.ndarray, " point"]) -> list[list[float]] | None:
    """Return the outline of a band on both sides of a polyline, mm; None for a surface."""
    if interface.dim != 2:
        return None
    order = [*interface.cells[:, 0], interface.cells[-1, 1]]
    off = width[:, None] * point_normals(interface)
    ends = np.concatenate([(interface.points + off)[order], (interface.points - off)[order][::-1]])
    return [np.round(column, DECIMALS).tolist() for column in ends.T]
