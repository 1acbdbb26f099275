"""An interface at a prompt and in a notebook."""

import re
from xml.etree import ElementTree

import numpy as np

from strandline.interface import Interface


def corners(points: list[list[float]]) -> np.ndarray:
    drawing = Interface.polyline(np.array(points))._repr_svg_()
    assert drawing is not None
    (line,) = ElementTree.fromstring(drawing)
    return np.array(re.findall(r"[\d.]+", line.attrib["points"]), float).reshape(-1, 2)


def test_one_line_at_a_prompt() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 0.25]])
    assert repr(Interface.polyline(points)) == "<Interface: polyline of 3 points, 2 × 0.5 mm>"


def test_the_drawing_keeps_proportions_and_has_y_upwards() -> None:
    got = corners([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0]])
    across, up = got[1] - got[0], got[2] - got[1]
    np.testing.assert_allclose(across[0], 2 * -up[1], rtol=1e-3)
    assert across[1] == up[0] == 0.0


def test_a_level_line_has_a_height() -> None:
    assert np.isfinite(corners([[0.0, 0.0], [1.0, 0.0]])).all()


def test_a_surface_has_no_drawing() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    surface = Interface(points, np.array([[0, 1, 2]]))
    assert surface._repr_svg_() is None
    assert repr(surface) == "<Interface: surface of 3 points, 1 × 1 × 0 mm>"
