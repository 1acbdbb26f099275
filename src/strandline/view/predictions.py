"""The interface at any inputs, as the surrogate predicts it, with a band."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.calibration.alternative import Present
from strandline.design.active import Knowledge
from strandline.interface import Interface
from strandline.interface.normals import node_normals
from strandline.view.shapes import offsets_um, outline

__all__ = ["predicted", "predictive_band"]

SDS = 2.0
BAND_DRAWS = 200
"""Draws of the posterior whose interfaces make the predictive band."""


def predicted(
    knowledge: Knowledge, x: Float[np.ndarray, " dim"], observed: Mapping[str, Interface]
) -> dict[str, dict[str, Any]]:
    """Return by condition the predicted polyline, the surrogate's standard deviation along its normals, and offsets.

    Args:
        knowledge: What is known of the interface.
        x: The inputs.
        observed: Observed interfaces by condition.
    """
    surrogate, out = knowledge.surrogate, {}
    interfaces, variances = surrogate.interfaces(x), surrogate.predict(x[None]).variance[0]
    fields = surrogate.modes.basis / surrogate.modes.roots
    parts = surrogate.by_condition(fields)
    for name, interface in interfaces.items():
        along = np.einsum("mpx,px->mp", parts[name], _normals(interface))
        sd = np.sqrt(variances @ along**2 + surrogate.modes.remainder**2)
        out[name] = {
            "line": outline(interface),
            "band": _band(interface, SDS * sd),
            "sd_um": float(f"{1e3 * float(np.sqrt(np.mean(sd**2))):.3g}"),
            "offsets": None if name not in observed else offsets_um(observed[name], interface),
        }
    return out


def predictive_band(now: Present, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return by condition the interface at the posterior mean, and twice the spread of the posterior's interfaces.

    Args:
        now: A posterior with its surrogate.
        seed: Seed of the choice of draws.
    """
    if now.knowledge is None:
        return {}
    surrogate = now.knowledge.surrogate
    chosen = np.random.default_rng(seed).choice(len(now.draws), BAND_DRAWS, p=np.exp(now.log_weights))
    drawn = surrogate.points(surrogate.mean(now.draws[chosen]))
    out = {}
    for name, interface in surrogate.interfaces(now.mean).items():
        off = np.einsum("dpx,px->dp", drawn[name] - drawn[name].mean(axis=0), _normals(interface))
        out[name] = {"line": outline(interface), "band": _band(interface, SDS * off.std(axis=0))}
    return out


def _normals(interface: Interface) -> Float[np.ndarray, "point xyz"]:
    return np.asarray(node_normals(interface.points[None], interface.cells)[0])


def _band(interface: Interface, width: Float[np.ndarray, " point"]) -> list[list[float]] | None:
    """Return the outline of a band on both sides of a polyline, mm; None for a surface."""
    if interface.dim != 2:
        return None
    order = [*interface.cells[:, 0], interface.cells[-1, 1]]
    off = width[:, None] * _normals(interface)
    ends = np.concatenate([(interface.points + off)[order], (interface.points - off)[order][::-1]])
    return [np.round(column, 6).tolist() for column in ends.T]
