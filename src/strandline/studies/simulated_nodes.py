"""Whether a simulated polyline has enough nodes for the noise: between nodes it cuts corners off a smooth curve.

Its chords lie up to the sagitta L α / 8 beside the curve, for segments of length L that turn by α. Where the nodes lie
changes with the inputs, so this error looks like information about them. About their mean, the errors of n observed
points have a root mean square of √(4/45) times the sagitta, and they change d² by up to twice the sum of their squares
over the noise variance.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import NormalOffset
from strandline.interface import Interface
from strandline.likelihood.compared import errors_of
from strandline.runs import RunRecord
from strandline.studies.first_run import observations_of
from strandline.studies.study import Study

__all__ = ["node_lines"]

SHARE = 4 / 45
"""Mean square of a parabola about its mean, in squares of its height."""
MOST = 1.0
"""Change of d² from which the nodes are too few."""
CORNER = 0.3
"""Turn of the polyline, radians, from which it counts as a corner of the shape itself."""


def node_lines(study: Study, record: RunRecord) -> Iterator[str]:
    """Yield a warning for each condition whose simulated polyline has too few nodes for the errors of the points.

    Nothing is said where the model itself makes the observation, or for measures other than signed distances.
    """
    if study.truth is not None or not isinstance(next(iter(study.discrepancies.values())), NormalOffset):
        return
    for seen in study.observations(observations_of(study)):
        condition = seen.condition
        errors, one = errors_of(seen), record.interfaces[condition]
        if errors is None or one.dim != 2:
            continue
        local, sagittas = errors.model(seen.interface).local, _sagittas(one)
        change = 2 * SHARE * float(np.mean(sagittas**2)) * float((1 / local).sum())
        if change > MOST:
            of = f" ({condition})" if condition else ""
            times = int(np.ceil(change**0.25 * 10)) / 10
            yield (
                f"warning{of}: between its nodes the simulated polyline is up to {1e3 * sagittas.max():.2g} µm off "
                f"the smooth curve, too far for {len(seen.interface.points)} points with this noise; let the simulator "
                f"return at least {times:g} times as many nodes"
            )


def _sagittas(polyline: Interface) -> Float[np.ndarray, " segment"]:
    """Return the height of the arc over each segment, mm, from the mean of the angles by which its ends turn."""
    step = polyline.ends - polyline.starts
    after = np.roll(step, -1, axis=0)
    turn = np.abs(np.arctan2(step[:, 0] * after[:, 1] - step[:, 1] * after[:, 0], (step * after).sum(axis=1)))
    turn = np.where(turn < CORNER, turn, 0.0)
    before = np.roll(turn, 1)
    if not polyline.closed:
        turn[-1], before[0] = before[-1], turn[0]
    return np.asarray(polyline.lengths * 0.5 * (turn + before) / 8)
