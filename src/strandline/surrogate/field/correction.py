"""What a cheaper model's interface lacks to that of the model itself, learnt from runs of both at the same inputs.

The correction is taken as a linear function of the cheaper interface: a constant plus a Gaussian process with the
linear kernel of the interface's points. It needs far fewer runs than a function of the inputs: what a coarse mesh adds
grows with the displacement, whatever causes it. This is the additive part of Kennedy and O'Hagan (2000), with the
cheaper model's output in place of its inputs. The share of noise is the one with the smallest leave-one-out error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import path_of
from strandline.foundations import NoCommonPoints, require
from strandline.interface import Interface
from strandline.surrogate.field import correspondence

FEWEST_PAIRS = 3  # fewest runs of both models
RIDGES = (1e-3, 1e-2, 1e-1)  # variances of the noise that are tried, in mean variances of the cheaper interfaces
FEW, TYPICAL = 5, (1e-2,)  # number of pairs below which left-out ones cannot tell the variance, and what is taken then

Interfaces = Mapping[str, Interface]


@dataclass(frozen=True, eq=False)
class Correction:
    """Difference between the interfaces of a model and a cheaper one, as a function of the latter.

    The layouts of the points by condition are common to both models. The cheaper interfaces have the mean `middle`, all
    coordinates, and the root mean square distance `scale` from it, mm; `runs` are these less their mean, in units of
    `scale`, with weights: the roots of each value's share of the interface's length (area). The correction has a
    constant part, mm, and factors of the kernel's rows, mm. `left_out` is its error at each pair, learnt from the
    others, `spread` the root mean square distance of the model's own interfaces at the pairs from their mean, mm.
    `node_by_node` tells whether the points are the nodes of both models in all runs.
    """

    layouts: Mapping[str, correspondence.PointLayout]
    middle: Float[np.ndarray, " value"]
    scale: float
    runs: Float[np.ndarray, "pair value"]
    constant: Float[np.ndarray, " value"]
    factors: Float[np.ndarray, "pair value"]
    weights: Float[np.ndarray, " value"]
    left_out: Float[np.ndarray, " pair"]
    spread: float
    node_by_node: bool

    @property
    def pairs(self) -> int:
        return len(self.runs)

    @property
    def error(self) -> float:
        return float(np.sqrt(np.mean(self.left_out**2)))

    def corrected(self, cheaper: Interfaces) -> dict[str, Interface]:
        """Return the interfaces that the model would return, from those of the cheaper one.

        Raises:
            NoCommonPoints: An interface without common points with the others.
        """
        field = _field(cheaper, self.layouts)
        field = field + self.constant + self._slope((field - self.middle)[None])[0]
        points = correspondence.by_condition(field, self.layouts)
        return {name: self.layouts[name].with_points(one) for name, one in points.items()}

    def corrected_slopes(self, slopes: Mapping[str, Float[np.ndarray, "point xyz"]]) -> dict[str, np.ndarray]:
        """Return the derivatives of the corrected interfaces in an input, from those of the cheaper ones, by condition.

        They only have common points if the nodes correspond.
        """
        field = np.concatenate([np.asarray(slopes[name], float).ravel() for name in self.layouts])
        return correspondence.by_condition(field + self._slope(field[None])[0], self.layouts)

    def distance(self, one: Interfaces, other: Interfaces) -> float:
        """Return the distance between interfaces with common points, root mean square along the interface, mm.

        Raises:
            NoCommonPoints: An interface without common points with the others.
        """
        (a, b), _ = correspondence.fields_of([one, other], self.layouts)
        return float(_rms((a - b)[None], self.weights, len(self.layouts))[0])

    def _slope(self, field: Float[np.ndarray, "some value"]) -> Float[np.ndarray, "some value"]:
        """Return the linear part of the correction of a change of the cheaper interface."""
        return np.asarray((field * self.weights / self.scale) @ self.runs.T @ self.factors)


def fit_correction(cheaper: Sequence[Interfaces], model: Sequence[Interfaces]) -> Correction:
    """Return the correction learnt from the interfaces of both models at the same inputs, at least `FEWEST_PAIRS`.

    Raises:
        NoCommonPoints: Interfaces that cannot be brought to common points.
    """
    names = list(model[0])
    alike, what = not any(set(names) - set(run) for run in (*cheaper, *model)), "interfaces of the cheaper model"
    words = f"the model's: {', '.join(names)}", "Let both models return the same conditions."
    require(alike, what, "other conditions", *words, NoCommonPoints)
    layouts = {name: _layout([run[name] for run in model], [run[name] for run in cheaper]) for name in names}
    above = correspondence.fields_of(model, layouts)[0]
    below = np.array([_field(run, layouts) for run in cheaper])
    shares = [np.repeat(layout.weights, layout.template.dim) for layout in layouts.values()]
    weights = np.sqrt(np.concatenate(shares))
    middle, conditions = below.mean(axis=0), len(layouts)
    scale = max(float(np.sqrt(np.mean(_rms(below - middle, weights, 1) ** 2))), np.finfo(float).tiny)
    runs, lacks = (below - middle) * weights / scale, above - below
    kernel, ridges = runs @ runs.T, RIDGES if len(runs) >= FEW else TYPICAL
    noise = max(float(np.trace(kernel)) / len(kernel), 1e-12) * np.eye(len(kernel))
    tried = [correspondence.kriged(kernel + ridge * noise, lacks) for ridge in ridges]
    errors = [_rms(left_out, weights, conditions) for _, _, left_out in tried]
    best = int(np.argmin([np.sum(one**2) for one in errors]))
    constant, factors, _ = tried[best]
    spread = float(np.sqrt(np.mean(_rms(above - above.mean(axis=0), weights, conditions) ** 2)))
    same = all(correspondence.common_layout([run[name] for run in (*model, *cheaper)]).way == "nodes" for name in names)
    return Correction(layouts, middle, scale, runs, constant, factors, weights, errors[best], spread, same)


def _layout(model: Sequence[Interface], cheaper: Sequence[Interface]) -> correspondence.PointLayout:
    """Return the layout of the model's nodes if open polylines can be brought to them, else a common one. So corrected
    interfaces have the nodes that a measure may ask for.
    """
    own = correspondence.common_layout(model)
    lines = all(one.dim == 2 and not one.closed for one in (*model, *cheaper))
    return own if own.way == "nodes" and lines else correspondence.common_layout([*model, *cheaper])


def _brought(interface: Interface, layout: correspondence.PointLayout) -> Float[np.ndarray, "point xyz"]:
    """Return the points of an interface in the layout; of other nodes, at the template's shares of the arclength."""
    template = layout.template
    if layout.way != "nodes" or interface.points.shape == template.points.shape or interface.dim != 2:
        return correspondence.registered(interface, layout)[0]
    turned = interface.reversed() if interface.runs_against(template) else interface
    shares, places = _shares(template), _shares(turned)
    own = np.append(template.cells[:, 0], template.cells[-1, 1])
    out = np.empty_like(template.points)
    out[own] = np.stack([np.interp(shares, places, column) for column in path_of(turned).T], axis=1)
    return out


def _field(run: Interfaces, layouts: Mapping[str, correspondence.PointLayout]) -> Float[np.ndarray, " value"]:
    """Return the points of a run of the cheaper model in the layouts, one after the other."""
    return np.concatenate([_brought(run[name], layout).ravel() for name, layout in layouts.items()])


def _shares(line: Interface) -> Float[np.ndarray, " node"]:
    """Return the share of the arclength at each node of an open polyline, along it."""
    length = np.append(0.0, np.cumsum(line.sizes))
    return np.asarray(length / length[-1])


def _rms(
    fields: Float[np.ndarray, "some value"], weights: Float[np.ndarray, " value"], conditions: int
) -> Float[np.ndarray, " some"]:
    """Return the root mean square of fields along the interface, over all conditions, mm."""
    return np.asarray(np.sqrt(np.sum((fields * weights) ** 2, axis=1) / conditions))
