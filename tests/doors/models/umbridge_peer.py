"""A small model served by the reference implementation of UM-Bridge, at the port on the command line.

Two inputs x, three outputs (x0², x0 x1, x1), with all derivatives; the second model has Evaluate alone.
"""

import sys
from typing import Any

import umbridge


class Bare(umbridge.Model):
    """Evaluate alone."""

    def get_input_sizes(self, config: Any) -> list[int]:
        return [2]

    def get_output_sizes(self, config: Any) -> list[int]:
        return [3]

    def __call__(self, parameters: Any, config: Any = None) -> list[list[float]]:
        x, y = parameters[0]
        return [[x * x, x * y, y]]

    def supports_evaluate(self) -> bool:
        return True


class Whole(Bare):
    """All four features."""

    def gradient(self, out_wrt: int, in_wrt: int, parameters: Any, sens: Any, config: Any = None) -> list[float]:
        x, y = parameters[0]
        return [2 * x * sens[0] + y * sens[1], x * sens[1] + sens[2]]

    def apply_jacobian(self, out_wrt: int, in_wrt: int, parameters: Any, vec: Any, config: Any = None) -> list[float]:
        x, y = parameters[0]
        return [2 * x * vec[0], y * vec[0] + x * vec[1], vec[1]]

    def apply_hessian(self, out: int, in1: int, in2: int, parameters: Any, sens: Any, vec: Any, config: Any = None):
        return [2 * sens[0] * vec[0] + sens[1] * vec[1], sens[1] * vec[0]]

    supports_gradient = supports_apply_jacobian = supports_apply_hessian = Bare.supports_evaluate


if __name__ == "__main__":
    umbridge.serve_models([Whole("whole"), Bare("bare")], int(sys.argv[1]))
