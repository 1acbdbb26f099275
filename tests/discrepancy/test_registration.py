"""Sums of residuals of observations that are shifted or turned, and of those that are not."""

import numpy as np

from strandline.discrepancy.registration import Rows, Sums, linear_sums


def test_without_global_errors_the_sums_are_taken_once_over_all_points() -> None:
    asked: list[bool] = []

    def sums(points: Rows, rough: bool) -> Sums:
        asked.append(rough)
        return np.array([2.0]), np.zeros((1, 0))

    found = linear_sums({"": np.zeros((1, 4, 2))}, sums, lambda b: b, lambda points, g: points, np.zeros((0, 0)))
    assert found[0] == 2.0
    assert asked == [False]


def test_global_errors_are_estimated_from_some_points_and_the_sums_taken_over_all() -> None:
    """Residuals of a line that is 0.3 too high, with one global error: its offset, of sd 1."""
    asked: list[bool] = []

    def sums(points: Rows, rough: bool) -> Sums:
        asked.append(rough)
        r = points[""][:, :, 1]
        return (r**2).sum(axis=1), r.sum(axis=1)[:, None]

    def followed(points: Rows, g: np.ndarray) -> Rows:
        return {"": points[""] - g[:, :1, None] * np.array([0.0, 1.0])}

    gram = np.array([[4.0]])
    line = np.stack([np.arange(4.0), np.full(4, 0.3)], axis=1)[None]
    squares, products = linear_sums({"": line}, sums, lambda b: b / 5.0, followed, gram)
    np.testing.assert_allclose(squares, 4 * 0.3**2)
    np.testing.assert_allclose(products, [[4 * 0.3]])
    assert asked == [True, True, False]
