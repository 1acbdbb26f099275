"""A small model served by the reference implementation of UM-Bridge, at the port on the command line.

Two inputs x, three outputs (x0², x0 x1, x1), with all derivatives; the second model has Evaluate alone.
"""

import sys
from typing import Any

import umbridge


class Whole(umbridge.Model):
    """All four features."""

    def __init__(self, name: str = "whole") -> None:
        super().__init__(name)

    def get_input_sizes(self, config: Any) -> list[int]:
        return [2]

    def get_output_sizes(self, config: Any) -> list[int]:
        return [3]

    def __call__(self, parameters: Any, config: Any = None) -> list[list[float]]:
        x, y = parameters[0]
        return [[x * x, x * y, y]]

    def gradient(self, out_wrt: int, in_wrt: int, parameters: Any, sens: Any, config: Any = None) -> list[float]:
        x, y = parameters[0]
        return [2 * x * sens[0] + y * sens[1], x * sens[1] + sens[2]]

    def apply_jacobian(self, out_wrt: int, in_wrt: int, parameters: Any, vec: Any, config: Any = None) -> list[float]:
        x, y = parameters[0]
        return [2 * x * vec[0], y * vec[0] + x * vec[1], vec[1]]

    def apply_hessian(
        self, out_wrt: int, in_wrt1: int, in_wrt2: int, parameters: Any, sens: Any, vec: Any, config: Any = None
    ) -> list[float]:
        return [2 * sens[0] * vec[0] + sens[1] * vec[1], sens[1] * vec[0]]

    def supports_evaluate(self) -> bool:
        return True

    def supports_gradient(self) -> bool:
        return True

    def supports_apply_jacobian(self) -> bool:
        return True

    def supports_apply_hessian(self) -> bool:
        return True


class Bare(umbridge.Model):
    """Evaluate alone; it fails where x0 is above 1 and yields NaN where it is below -1."""

    def __init__(self, name: str = "bare") -> None:
        super().__init__(name)

    def get_input_sizes(self, config: Any) -> list[int]:
        return [2]

    def get_output_sizes(self, config: Any) -> list[int]:
        return [4]

    def __call__(self, parameters: Any, config: Any = None) -> list[list[float]]:
        x, y = parameters[0]
        if x > 1:
            raise RuntimeError("the matrix is singular")
        return [[0.0, 0.0, 1.0, float("nan") if x < -1 else x + y]]

    def supports_evaluate(self) -> bool:
        return True


if __name__ == "__main__":
    umbridge.serve_models([Whole(), Bare()], int(sys.argv[1]))
