"""The least value over the global errors, against a search that knows nothing of the measure."""

import numpy as np
import pytest
from scipy.optimize import minimize

from strandline.discrepancy import ClosestPoint, Currents, Discrepancy, MeasurementLines, TrackedPoints
from strandline.discrepancy.normal_offset import WhitenedOffset
from strandline.interface import Interface, PointErrors
from strandline.likelihood.registered import Registered, curvature_inverse

S = np.linspace(0.0, 1.0, 41)
ERRORS = PointErrors(0.002, 0.02, shift=0.03, rotation=3.0)


def arch(height: float, *, lean: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)) -> Interface:
    points = np.stack([S + lean * np.sin(np.pi * S), 4 * height * S * (1 - S)], axis=1)
    return Interface.polyline(points + np.array(shift))


@pytest.mark.parametrize(
    ("measure", "variance"),
    [(TrackedPoints(), 8e-5), (ClosestPoint(), 4e-5), (Currents(0.1), 1e-5), (MeasurementLines(10), 1e-4)],
    ids=lambda one: type(one).__name__,
)
def test_steps_lead_from_the_first_guess_to_the_least_value(measure: Discrepancy, variance: float) -> None:
    """A twentieth of the way is left at most."""
    simulated, observed = arch(0.26, lean=0.02, shift=(0.03, -0.02)), arch(0.25)
    middle = observed.points.mean(axis=0)

    def value(g: np.ndarray) -> float:
        moved = ERRORS.followed(simulated.points[None], simulated, g[None], middle=middle)[0]
        return measure(Interface(moved, simulated.cells), observed) / variance + float(g @ g)

    first = WhitenedOffset(ERRORS).global_errors(simulated.points[None], simulated, observed)[0]
    least = minimize(value, first, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6, "maxiter": 2000}).fun
    inverse = curvature_inverse(measure, variance, ERRORS, observed, len(S))
    found = Registered(measure, variance, ERRORS, inverse)(simulated, observed)
    assert value(first) > 2 * least
    assert least - 1e-3 < found < least + 0.05 * (value(first) - least)
