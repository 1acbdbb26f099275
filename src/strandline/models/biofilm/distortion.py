"""A rigorous lower bound of the deformation's Jacobian J = det(I + ∇d) on every element."""

from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.models.biofilm.materials import deformation_gradient

__all__ = ["NODES_P2", "jacobian_bound", "on_elements", "quadratic_nodes"]

NODES_P2 = ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (0.5, 0.5), (0.0, 0.5), (0.5, 0.0))
"""Reference coordinates of the three corners and of the midpoints of edges (0,1), (1,2), (2,0)."""


def on_elements(mesh: Any, function: Any) -> Float[np.ndarray, "cell 6 component"]:
    """Return a coefficient function at the six P2 nodes of each element, seen from inside it."""
    rule = ng.IntegrationRule(points=list(NODES_P2), weights=[0.0] * len(NODES_P2))
    values = np.asarray(function(mesh.MapToAllElements(rule, ng.VOL)))
    return values.reshape(mesh.ne, len(NODES_P2), -1)


def jacobian_bound(mesh: Any, displacement: Any, is_solid: Bool[np.ndarray, " cell"]) -> tuple[float, float]:
    """Return lower bounds of J over the fluid and over the solid; above zero, no element is inverted anywhere.

    With a quadratic displacement on a straight triangle J is a quadratic polynomial. Its smallest Bernstein coefficient
    (value at a corner; 2 J(midpoint) - mean of the two corners on an edge) bounds it from below.
    """
    J = on_elements(mesh, ng.Det(deformation_gradient(displacement)))[:, :, 0]
    corner, middle = J[:, :3], J[:, 3:]
    edge = 2.0 * middle - 0.5 * (corner + np.roll(corner, -1, axis=1))
    bound = np.minimum(corner.min(axis=1), edge.min(axis=1))
    return float(bound[~is_solid].min()), float(bound[is_solid].min())


def quadratic_nodes(mesh: Any) -> tuple[Int[np.ndarray, "cell 6"], int]:
    """Return the numbers of each element's six P2 nodes, shared with its neighbours, and how many nodes there are."""
    corners = np.array([[v.nr for v in element.vertices] for element in mesh.Elements(ng.VOL)])
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    return np.concatenate([corners, mesh.nv + number.reshape(-1, 3)], axis=1), mesh.nv + len(unique)
