"""Curves, and batches of interfaces one beside the other, that tests share."""

import numpy as np
from tests.unit.discrepancy.surfaces import sheet, sphere

from strandline.discrepancy import Currents, Discrepancy
from strandline.interface import Interface


def line(*points: tuple[float, float], closed: bool = False) -> Interface:
    return Interface.polyline(np.array(points, float), closed=closed)


def graph(x: np.ndarray, y: np.ndarray | float, *, closed: bool = False) -> Interface:
    """Return the polyline through (x, y)."""
    return Interface.polyline(np.stack([x, y + 0.0 * x], axis=1), closed=closed)


def level(y: float, nodes: int = 11, *, length: float = 1.0) -> Interface:
    """Return a horizontal line."""
    return graph(np.linspace(0.0, length, nodes), y)


def arch(height: float = 0.3, nodes: int = 61) -> Interface:
    """Return a parabola over a base of 1 mm."""
    x = np.linspace(0.0, 1.0, nodes)
    return graph(x, 4 * height * x * (1 - x))


def ring(nodes: int, radius: float = 1.0, *, flat: float = 1.0) -> Interface:
    """Return a closed circle, counter-clockwise, or an ellipse that is flatter by a factor."""
    angle = 2 * np.pi * np.arange(nodes) / nodes
    return graph(radius * np.cos(angle), flat * radius * np.sin(angle), closed=True)


def runs(kind: str, number: int, *, noise: float = 0.02) -> tuple[np.ndarray, Interface, Interface]:
    """Return points of perturbed interfaces, a template and an observed interface."""
    rng = np.random.default_rng(1)
    s = np.linspace(0.0, 1.0, 24)
    base = {
        "open": lambda: graph(s, 0.2 * np.sin(4 * s)),
        "closed": lambda: ring(23, flat=0.6),
        "sheet": lambda: sheet(5, bend=0.1),
        "sphere": lambda: sphere(1.0, 1),
    }[kind]()
    seen = Interface(base.points + 0.5 * noise * rng.standard_normal(base.points.shape), base.cells)
    smooth = rng.normal(size=(number, 1, base.dim)) * np.sin(3 * base.points.sum(axis=1))[:, None]
    jagged = 0.2 * rng.standard_normal((number, *base.points.shape))
    return base.points + noise * (smooth + jagged), base, seen


def one_by_one(measure: Discrepancy, points: np.ndarray, template: Interface, seen: Interface) -> np.ndarray:
    return np.array([measure(Interface(row, template.cells), seen) for row in points])


def within(measure: Discrepancy, found: np.ndarray, expected: np.ndarray, seen: Interface) -> bool:
    """Tell whether d² is right, the refined currents to their tolerance of <T,T>."""
    bound = 1e-10
    if isinstance(measure, Currents):
        square = measure.inner(seen, seen)
        bound = (measure.tolerance if measure.quadrature == "refined" else 1e-12) * square
    return bool((found >= 0).all() and (np.abs(found - expected) <= bound).all())
