"""Pixels and coordinates of the model: known places, inverses, mistakes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strandline.errors import InvalidInput
from strandline.imaging.frame import Frame

PIXEL = (0.006, 0.003)
PLACES: list[tuple[dict[str, Any], list[float], list[float]]] = [
    ({}, [110.0, 50.0], [0.06, 0.0]),
    ({}, [100.0, 40.0], [0.0, 0.03]),
    ({"y": "down"}, [100.0, 60.0], [0.0, 0.03]),
    ({"x": "left"}, [90.0, 50.0], [0.06, 0.0]),
    ({"rotation": 90.0}, [100.0, 40.0], [0.03, 0.0]),
    ({"rotation": 90.0}, [90.0, 50.0], [0.0, 0.06]),
    ({"rotation": 90.0, "y": "down"}, [100.0, 60.0], [0.03, 0.0]),
    ({"rotation": -90.0, "x": "left"}, [100.0, 60.0], [0.03, 0.0]),
    ({"rotation": 180.0}, [90.0, 60.0], [0.06, 0.03]),
]


def test_known_places() -> None:
    for options, pixels, mm in PLACES:
        frame = Frame.from_options({"origin": [100, 50], **options}, "frame", pixel=PIXEL)
        np.testing.assert_allclose(frame.to_mm(np.array([pixels, [100.0, 50.0]])), [mm, [0, 0]], atol=1e-15)
        np.testing.assert_allclose(frame.to_pixels(np.array([mm])), [pixels], rtol=1e-13)


NUMBERS = st.floats(-1e4, 1e4)


@settings(max_examples=25)
@given(
    origin=st.tuples(NUMBERS, NUMBERS),
    pixel=st.tuples(st.floats(1e-4, 1.0), st.floats(1e-4, 1.0)),
    x=st.sampled_from(["right", "left"]),
    y=st.sampled_from(["up", "down"]),
    rotation=st.floats(-360, 360),
    places=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=4),
)
def test_inverse_and_lengths(
    origin: tuple[float, float],
    pixel: tuple[float, float],
    x: str,
    y: str,
    rotation: float,
    places: list[tuple[float, float]],
) -> None:
    frame, points = Frame(origin, pixel, x, y, rotation), np.array(places)
    there = frame.to_mm(points)
    np.testing.assert_allclose(frame.to_pixels(there), points, atol=1e-8)
    away = (points - np.array(origin)) * pixel
    np.testing.assert_allclose(np.hypot(*there.T), np.hypot(*away.T), rtol=1e-12, atol=1e-12)
    assert frame.mirrors == (np.linalg.det(frame.matrix) < 0)


def test_a_rotation_turns_the_model_by_that_angle() -> None:
    """The x axis of the model appears at its angle above the horizontal, measured in mm although pixels are oblong."""
    dx, dy = Frame((0.0, 0.0), PIXEL, rotation=30.0).to_pixels(np.array([[1.0, 0.0]]))[0] * PIXEL
    assert np.degrees(np.arctan2(-dy, dx)) == pytest.approx(30.0, rel=1e-12)


MISTAKES: list[tuple[Any, str]] = [
    ({}, r"observation\.frame\.origin: got nothing"),
    ({"origin": [1]}, r"observation\.frame\.origin: got \[1\]"),
    ({"origin": [1, "a"]}, r"observation\.frame\.origin: got a"),
    ({"origin": [1, float("inf")]}, r"observation\.frame\.origin: got inf"),
    ({"origin": [1, 2], "x": "up"}, r"observation\.frame\.x: got up; expected one of right, left"),
    ({"origin": [1, 2], "y": "dwn"}, "Did you mean down"),
    ({"origin": [1, 2], "y": True}, r"observation\.frame\.y: got True"),
    ({"origin": [1, 2], "rotation": "30°"}, r"observation\.frame\.rotation: got 30°"),
    ({"origin": [1, 2], "rotation": 400}, r"observation\.frame\.rotation: got 400"),
    ({"origin": [1, 2], "rotaton": 3}, "Did you mean rotation"),
    ([1, 2], "expected keys with values"),
]


def test_mistakes_are_one_line() -> None:
    for options, said in MISTAKES:
        with pytest.raises(InvalidInput, match=said) as caught:
            Frame.from_options(options, "observation.frame", pixel=PIXEL)
        assert "\n" not in str(caught.value)
    for changed in ({"pixel": (0.1, 0.0)}, {"x": "down"}, {"rotation": np.nan}):
        with pytest.raises(InvalidInput, match=rf"frame\.{next(iter(changed))}"):
            Frame(**{"origin": (0.0, 0.0), "pixel": PIXEL, **changed})
