"""Second derivatives by differences, on quadratics; where quadrature ends; what no problem can be made of."""

import re
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Problem
from strandline.calibration.targets import central_hessian, quadrature
from strandline.discrepancy import TrackedPoints
from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform

LOW, HIGH = np.array([-1.0, 0.0, 100.0]), np.array([1.0, 2.0, 800.0])
A = np.array([[3.0, 0.5, 0.01], [0.5, 2.0, -0.02], [0.01, -0.02, 0.001]])


def quadratic(x: np.ndarray) -> np.ndarray:
    assert ((x >= LOW) & (x <= HIGH)).all()
    return 1.0 + x @ np.array([1.0, -2.0, 0.3]) - 0.5 * np.einsum("pi,ij,pj->p", x, A, x)


def test_the_hessian_of_a_quadratic_is_exact_at_the_edge_too() -> None:
    """Points outside the box are not asked for, whatever the step."""
    for x in ([0.1, 0.7, 300.0], [-1.0, 2.0, 100.0], [1.0, 1e-9, 799.9]):
        for step in (0.01, 0.1, 10.0):
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


def test_above_three_inputs_there_is_no_quadrature() -> None:
    def never(x: Any) -> Any:
        raise AssertionError("evaluated")

    space = ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0)) for name in "abcd"))
    assert quadrature(space, never) is None


def test_a_problem_of_other_things_is_refused_in_one_line() -> None:
    """Made without its constructor, whose types are checked at run time while tests run."""
    usual = {"model": print, "space": ParameterSpace((Parameter("E", Uniform(0.0, 1.0)),)), "fixed": {}}
    rows: list[tuple[str, Any, str]] = [
        ("space", ("E",), "inputs of the problem: got tuple.*a ParameterSpace"),
        ("observations", None, "observations of the problem: got NoneType.*a tuple of Observations"),
        ("observations", ({"points": []},), "observations of the problem: got tuple"),
        ("discrepancies", TrackedPoints(), "measures of the problem: got TrackedPoints.*by name"),
        ("fixed", [1.0], "known inputs of the problem: got list"),
        ("model", "beam", "model of the problem: got str"),
    ]
    for name, value, said in rows:
        problem = object.__new__(Problem)
        for field, content in {**usual, "observations": (), "discrepancies": {}, name: value}.items():
            object.__setattr__(problem, field, content)
        with pytest.raises(InvalidInput) as caught:
            problem.__post_init__()
        (line,) = str(caught.value).splitlines()
        assert re.search(said, line)
