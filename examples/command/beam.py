"""A small simulator that knows nothing of strandline: a cantilever under a dead load at its tip, bent far.

It reads beam.json and writes axis.csv, the bent axis in mm. Elastica: B θ'' = -P cos θ with θ(0) = 0 and θ'(L) = 0,
integrated by Runge-Kutta from the tip, whose angle is found by bisection.
"""

import json
from math import cos, pi, sin
from pathlib import Path


def axis(load: float, stiffness: float, length: float, steps: int) -> list[tuple[float, float, float]]:
    """Return (x, y, θ) from the clamp to the tip; lengths in mm, `load` / `stiffness` in mm⁻²."""

    def from_tip(angle: float) -> list[tuple[float, float, float]]:
        h, theta, bend, x, y = length / steps, angle, 0.0, 0.0, 0.0
        states = [(x, y, theta)]
        for _ in range(steps):
            k1, m1 = bend, -load / stiffness * cos(theta)
            k2, m2 = bend + h / 2 * m1, -load / stiffness * cos(theta + h / 2 * k1)
            k3, m3 = bend + h / 2 * m2, -load / stiffness * cos(theta + h / 2 * k2)
            k4, m4 = bend + h * m3, -load / stiffness * cos(theta + h * k3)
            middle = theta + h / 4 * (k1 + k2)
            after = theta + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            x += h / 6 * (cos(theta) + 4 * cos(middle) + cos(after))
            y += h / 6 * (sin(theta) + 4 * sin(middle) + sin(after))
            theta, bend = after, bend + h / 6 * (m1 + 2 * m2 + 2 * m3 + m4)
            states.append((x, y, theta))
        return states

    low, high = 0.0, pi / 2
    for _ in range(60):
        angle = (low + high) / 2
        low, high = (low, angle) if from_tip(angle)[-1][2] > 0 else (angle, high)
    states = from_tip(low)
    end_x, end_y, _ = states[-1]
    return [(end_x - x, end_y - y, theta) for x, y, theta in reversed(states)]


if __name__ == "__main__":
    given = json.loads(Path("beam.json").read_text())
    states = axis(given["load"], given["E"] * given["height"] ** 3 / 12, given["length"], 40)
    print(f"tip at x = {states[-1][0]:.4f} mm, y = {states[-1][1]:.4f} mm")
    lines = ["x,y", *(f"{x!r},{y!r}" for x, y, _ in states)]
    Path("axis.csv").write_text("\n".join(lines) + "\n")
