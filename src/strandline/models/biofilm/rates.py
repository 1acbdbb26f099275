"""Rates of change on a grid of times: backward differences of second order, with steps of any length.

The rate at the new time is the slope of the parabola through the new value and the last two, BDF2; with one earlier
value it is that of the straight line, backward Euler. Source: Hairer and Wanner, Solving Ordinary Differential
Equations II (1996), section V.1, and Grigorieff, Numer. Math. 42 (1983) 359: stable if no step exceeds 2.41 times the
one before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["LARGEST_RATIO", "Moment", "Rates", "differences", "extrapolated", "share_of_error"]

LARGEST_RATIO = 1.8
"""Largest ratio of a step to the one before, below the bound for stability, 1 + √2."""

Values = Float[np.ndarray, " dof"]


@dataclass(frozen=True, eq=False)
class Moment:
    """All coefficients of the state at one time, and their rates.

    Args:
        time: Time, scaled.
        values: Coefficients of velocity, pressures and displacement (dof,).
        rates: Their derivatives with respect to time (dof,).
    """

    time: float
    values: Values
    rates: Values


class Rates:
    """Rates of all coefficients as affine functions of the coefficients at the new time; zero in a steady state.

    Args:
        size: Number of coefficients.
    """

    def __init__(self, size: int) -> None:
        self.leading = 0.0
        self._first, self._second = np.zeros(size), np.zeros(size)

    def set(self, time: float, last: Sequence[Moment]) -> None:
        """Prepare the step to `time` from the last moments, newest first: two, or one at a start."""
        used = last[:2]
        self.leading, *weights = differences([time, *(moment.time for moment in used)])
        pairs = list(zip(weights, used, strict=True))
        self._first = np.sum([weight * moment.values for weight, moment in pairs], axis=0)
        self._second = np.sum([weight * moment.rates for weight, moment in pairs], axis=0)

    def rest(self) -> None:
        """Leave out all that changes with time: the equations are those of the steady state."""
        self.leading = 0.0
        self._first, self._second = np.zeros_like(self._first), np.zeros_like(self._second)

    def first(self, values: Values) -> Values:
        """Return the rates of the coefficients."""
        return self.leading * values + self._first

    def second(self, values: Values) -> Values:
        """Return the rates of the rates: of a displacement, its acceleration."""
        return self.leading * self.first(values) + self._second


def differences(times: Sequence[float]) -> tuple[float, ...]:
    """Return weights of the values at `times`, two or three of them, newest first, in the slope at the newest one."""
    new, last, *before = times
    h = new - last
    if not before:
        return 1.0 / h, -1.0 / h
    k = last - before[0]
    return 1.0 / h + 1.0 / (h + k), -(h + k) / (h * k), h / (k * (h + k))


def extrapolated(time: float, last: Sequence[Moment]) -> Values:
    """Return the values at `time` on the polynomial through the last moments, newest first, at most three.

    At a start, values before the first moment are those that its rates lead back to.
    """
    times, values = [moment.time for moment in last[:3]], [moment.values for moment in last[:3]]
    wanted = 2 if len(last) == 1 else 3
    while len(times) < wanted:
        back = time - last[0].time
        values.append(values[-1] - back * last[-1].rates)
        times.append(times[-1] - back)
    result = np.zeros_like(values[0])
    for k, value in enumerate(values):
        others = [t for j, t in enumerate(times) if j != k]
        result += float(np.prod([(time - t) / (times[k] - t) for t in others])) * value
    return result


def share_of_error(time: float, last: Sequence[Moment]) -> float:
    """Return the local error of a step as a share of the difference between its result and `extrapolated`.

    Both differ from the solution by multiples of its third derivative, of the second at a start: the result by
    h (h + k) / 6a with the leading weight a, the extrapolated value by -h (h + k) (h + k + l) / 6, after steps l, k, h.
    """
    if len(last) == 1:
        return 0.5
    h, k = time - last[0].time, last[0].time - last[1].time
    before = last[1].time - last[2].time if len(last) > 2 else h
    own = 1.0 / differences([time, last[0].time, last[1].time])[0]
    return own / (own + h + k + before)
