"""Second derivatives by differences, on quadratics."""

import numpy as np
import pytest

from strandline.calibration.targets import central_hessian

LOW, HIGH = np.array([-1.0, 0.0, 100.0]), np.array([1.0, 2.0, 800.0])
A = np.array([[3.0, 0.5, 0.01], [0.5, 2.0, -0.02], [0.01, -0.02, 0.001]])


def quadratic(x: np.ndarray) -> np.ndarray:
    assert ((x >= LOW) & (x <= HIGH)).all()
    return 1.0 + x @ np.array([1.0, -2.0, 0.3]) - 0.5 * np.einsum("pi,ij,pj->p", x, A, x)


@pytest.mark.parametrize("x", [[0.1, 0.7, 300.0], [-1.0, 2.0, 100.0], [1.0, 1e-9, 799.9]])
@pytest.mark.parametrize("step", [0.01, 0.1, 10.0])
def test_the_hessian_of_a_quadratic_is_exact_at_the_edge_too(x: list[float], step: float) -> None:
    """Points outside the box are not asked for, whatever the step."""
    found = central_hessian(quadratic, np.array(x), step * np.array([1.0, 1.0, 100.0]), LOW, HIGH)
    np.testing.assert_allclose(found, -A, rtol=1e-5, atol=1e-6)


def test_the_error_goes_with_the_square_of_the_step() -> None:
    x, step = np.array([0.1, 0.7, 300.0]), np.array([0.1, 0.1, 20.0])

    def wavy(points: np.ndarray) -> np.ndarray:
        return np.sin(2 * points[:, 0] + points[:, 1]) + 1e-6 * points[:, 2] ** 2

    s = np.sin(0.9)
    exact = np.array([[-4 * s, -2 * s, 0], [-2 * s, -s, 0], [0, 0, 2e-6]])
    errors = [np.abs(central_hessian(wavy, x, step / k, LOW, HIGH) - exact).max() for k in (1, 2)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
