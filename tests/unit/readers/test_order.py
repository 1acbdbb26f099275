"""Tables whose points are in no order, or that leave open whether they are closed."""

import numpy as np
import pytest
from tests.unit.readers.reads import read, refused

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def written(folder, points):
    np.savetxt(folder / "a.csv", points, delimiter=",")
    return folder / "a.csv"


def arc(degrees, number):
    angles = np.radians(np.linspace(0, degrees, number))
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def drop(rows=60):
    """The pixels of a drop's edge row by row, as OpenDrop 3.3 lists them."""
    height = np.arange(rows)
    half = np.round(40 * np.sqrt(1 - (height / rows) ** 2))
    return np.stack([np.stack([100 - half, height], axis=1), np.stack([100 + half, height], axis=1)], axis=1).reshape(
        -1, 2
    )


def test_edge_pixels_row_by_row_are_refused(tmp_path):
    for turn in (np.eye(2), TURN):
        told = refused("jumps to and fro between two sides", written(tmp_path, drop() @ turn))
        assert "`sort: x` does it if x grows along it, `sort: y` if y does. Of OpenDrop take fit.csv" in told
    told = refused("jumps to and fro between two sides", written(tmp_path, drop()), sort="y")
    assert "line. Sorting does not order these. Of OpenDrop take fit.csv" in told
    assert len(read(written(tmp_path, np.concatenate([drop()[::2], drop()[-1::-2]]))).points) == 120


def test_points_in_no_order_are_refused_with_the_option_that_orders_them(tmp_path):
    path = written(tmp_path, arc(60, 6)[[3, 0, 4, 1, 5, 2]])
    assert "`sort: x` does it if x grows along it" in refused("crosses itself", path, "invalid_interface")
    assert len(read(path, sort="x").points) == 6


def test_outlines_with_near_sides_or_long_pieces_are_in_order(tmp_path):
    t = np.linspace(0, 1, 50)
    strip = np.concatenate([np.stack([t, 0 * t], axis=1), np.stack([t[::-1], 0 * t + 0.003], axis=1)])
    tooth = np.array([[0, 0], [0.02, 0], [0.03, 1], [0.5, 1], [0.52, 0]])
    gear = np.concatenate([tooth + np.array([k, 0]) for k in range(20)]) @ TURN
    saw = np.stack([np.arange(60.0), 10.0 * (np.arange(60) % 2)], axis=1)
    for points in (strip, gear, saw):
        assert len(read(written(tmp_path, points), closed=False).points) == len(points)


@pytest.mark.parametrize("number", [12, 50, 400])
def test_an_outline_whose_ends_nearly_meet_must_say_whether_it_is_closed(tmp_path, number):
    ring = arc(360, number + 1)[:-1]
    message = refused("does not repeat it", written(tmp_path, ring))
    assert "`closed: true`" in message
    for closed in (True, False):
        assert read(tmp_path / "a.csv", closed=closed).closed is closed
    assert not read(written(tmp_path, arc(360 - 4 * 360 / number, number))).closed
    assert read(written(tmp_path, arc(360, number))).closed
    assert read(written(tmp_path, arc(360, number)), closed=True).closed
    ellipse, first = arc(360, number + 1)[:-1] * [1.0, 0.4], number // 4 + 1
    apart = np.roll(ellipse, -first, axis=0)  # its ends are where points are farthest apart
    refused("does not repeat it", written(tmp_path, apart))
    assert not read(written(tmp_path, arc(180, number) * [2.5 / number, 1.0])).closed
