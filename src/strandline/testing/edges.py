"""Conformance suite for ways to find an edge in the picture of a camera, ``module:name`` in ``edge: {method: …}``.

The picture is a disc before a darker background, blurred over 1.5 pixels, with independent noise of a twentieth of the
contrast.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from strandline.imaging import Edge, EdgeMethod, find_edge
from strandline.testing import checks_of, require_parts

SIZE, RADIUS, BLUR, NOISE = 200, 60.0, 1.5, 0.05
"""Rows and columns of the picture, and the disc, pixels; noise of a pixel, for a contrast of 1."""
PICTURES = 4


def check_it_has_the_parts_of_a_method(method: EdgeMethod) -> None:
    """`bias` above 0, at least one pass, and `locate`."""
    require_parts(method, EdgeMethod)
    assert method.bias > 0, f"a bias of {method.bias}: no edge is free of an offset"
    assert method.passes >= 1, f"{method.passes} passes"


def check_it_finds_the_edge(method: EdgeMethod) -> None:
    """All points lie within 1.5 pixels of the disc's edge, and on average within three times the stated offset."""
    off = np.concatenate([_off(_found(method, seed), _centre(seed)) for seed in range(PICTURES)])
    assert np.abs(off).max() < 1.5, f"a point is {np.abs(off).max():.2g} pixels off"
    found = f"the edge is {off.mean():.2g} pixels off, with a bias of {method.bias:.2g}"
    assert abs(off.mean()) < 3 * method.bias, found


def check_it_knows_its_error(method: EdgeMethod) -> None:
    """The stated standard deviation of a point is within a factor of 2 of the true one."""
    edges = [_found(method, seed) for seed in range(PICTURES)]
    true = float(np.concatenate([_off(edge, _centre(seed)) for seed, edge in enumerate(edges)]).std())
    stated = float(np.mean([edge.errors.sd for edge in edges]))
    assert 0.5 < stated / true < 2.0, f"the stated standard deviation is {stated / true:.2g} times the true one"


def check_it_does_not_depend_on_the_light(method: EdgeMethod) -> None:
    """Half the brightness leaves the edge where it is."""
    one, half = _found(method, 0), _found(method, 0, light=0.5)
    assert len(one.points) == len(half.points), "half the brightness gives another number of points"
    moved = float(np.abs(np.asarray(one.points) - np.asarray(half.points)).max())
    assert moved < 0.1, f"half the brightness moves a point by {moved:.2g} pixels"


def check_it_repeats_itself(method: EdgeMethod) -> None:
    """The same picture gives the same edge to the bit."""
    first, second = (_found(method, 1) for _ in range(2))
    assert np.array_equal(first.points, second.points), "the second time gives another edge"


def _centre(seed: int) -> Float[np.ndarray, "2"]:
    return SIZE / 2 + np.random.default_rng([seed, 1]).random(2)


def _found(method: EdgeMethod, seed: int, light: float = 1.0) -> Edge:
    """Return the edge of a disc; its first path is half a pixel off."""
    random, centre = np.random.default_rng(seed), _centre(seed)
    y, x = np.mgrid[:SIZE, :SIZE]
    inside = ndtr((RADIUS - np.hypot(x - centre[0], y - centre[1])) / BLUR)
    values = light * (2.0 + inside + NOISE * random.standard_normal(inside.shape))
    angle = 2 * np.pi * np.arange(24) / 24
    path = centre + (RADIUS + 0.5) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return find_edge(values, path, method=method, closed=True)


def _off(edge: Edge, centre: Float[np.ndarray, "2"]) -> Float[np.ndarray, " point"]:
    return np.asarray(np.linalg.norm(np.asarray(edge.points) - centre, axis=1) - RADIUS)


CHECKS: dict[str, Callable[[EdgeMethod], None]] = checks_of(globals())
