"""Typed paths, checked like clicked ones."""

from typing import Any

import numpy as np
import pytest

from strandline.errors import InvalidInput
from strandline.imaging.paths import FirstPath, typed_path
from strandline.imaging.paths.first_path import MOST


def test_a_typed_path_is_a_list_of_pairs() -> None:
    found = typed_path([[1, 2], (3.5, 4), [0, 9]], closed=True, size=(10, 10))
    assert found.points.tolist() == [[1.0, 2.0], [3.5, 4.0], [0.0, 9.0]]
    assert found.closed
    assert typed_path(np.array([[1.0, 2.0], [3.0, 4.0], [0.0, 9.0]])).points.shape == (3, 2)


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ("1 2, 3 4", {}, "observation.path: got 1 2, 3 4; expected a list of points"),
        ([1, 2, 3], {}, "observation.path: point 1: got 1"),
        ([[1, 2], [3, 4]], {}, "observation.path has too few points: got 2"),
        ([[1, 2], [3, 4], [30, 9]], {"size": (20, 20)}, "point 3 is outside the picture"),
        ([[0, 0], [9, 9], [9, 0], [0, 9]], {}, r"crosses or touches itself: got \(4.5, 4.5\) px"),
        (np.stack([np.arange(MOST + 1.0), np.zeros(MOST + 1)], axis=1), {}, "too many points: got 20001"),
    ],
)
def test_what_is_no_path_is_refused(points: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        typed_path(points, what="observation.path", **options)


def test_an_open_path_may_end_where_a_closed_one_would_cross() -> None:
    points = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [4.0, -5.0 + 9.0], [5.0, -1e-3 + 1.0]])
    assert not FirstPath(points).closed
    crossing = np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0], [8.0, 9.0]])
    FirstPath(crossing)
    with pytest.raises(InvalidInput, match="crosses or touches itself"):
        FirstPath(crossing, closed=True)
