"""Which runs have no common points with most others."""

import numpy as np
from tests.unit.discrepancy.surfaces import sheet

from strandline.interface import Interface
from strandline.surrogate.field.odd import flipped, odd_ones


def test_the_surface_that_no_other_fits_is_odd_even_if_it_comes_first() -> None:
    """The others have different meshes of the same square; the first one is three times as large."""
    squares = [sheet(nodes, bend=0.02) for nodes in (6, 7, 8, 9, 10)]
    found = odd_ones([{"": one} for one in [sheet(7, size=3.0), *squares]], 0.01)
    assert list(found) == [0]
    assert odd_ones([{"": one} for one in squares], 0.01) == {}


def test_an_interface_of_another_kind_is_odd() -> None:
    s = np.linspace(0.0, 1.0, 9)
    lines = [Interface.polyline(np.stack([s, height * s * (1 - s)], axis=1)) for height in (0.1, 0.2, 0.3)]
    ring = Interface.polyline(np.stack([np.cos(6 * s[:-1]), np.sin(6 * s[:-1])], axis=1), closed=True)
    found = odd_ones([{"": one} for one in (*lines, ring)], 0.01)
    assert found == {3: "its interface is a closed polyline, most others are an open polyline"}


def test_an_interface_close_to_another_one_in_the_opposite_direction_is_flipped() -> None:
    """Reversing the points of a line of length 1 moves them by 0.58, root mean square."""
    s = np.linspace(0.0, 1.0, 40)
    line = Interface.polyline(np.stack([s, 0 * s], axis=1))
    for off, is_flipped in [(0.0, True), (0.2, True), (0.6, False)]:
        other = Interface.polyline(np.stack([s, 0 * s + off * 0.58], axis=1))
        assert flipped(other.reversed(), line) == is_flipped
        assert not flipped(other, line)
