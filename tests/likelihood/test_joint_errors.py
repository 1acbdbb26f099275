"""Several observations, each with global errors of its own: every one takes its own part of all of them."""

import numpy as np
import pytest

from strandline.interface import Interface, Observation, PointErrors
from strandline.likelihood.joint_errors import JointErrors

TURNED = PointErrors(0.001, 0.01, shift=0.01, rotation=2.0)
SHIFTED = PointErrors(0.001, 0.01, shift=0.02)
BY = np.array([0.3, -0.2, 0.5, -0.7, 0.4])
"""Two shifts and a rotation of the first observation, two shifts of the second, in standard deviations."""


def arch(height: float) -> Interface:
    s = np.linspace(0.0, 1.0, 21)
    return Interface.polyline(np.stack([s, 4 * height * s * (1 - s)], axis=1))


SEEN = Observation(arch(0.2), TURNED, "slow"), Observation(arch(0.4), SHIFTED, "fast")
JOINT = JointErrors(SEEN, (TURNED, SHIFTED))


def test_the_sizes_are_those_of_each() -> None:
    assert JOINT.sizes(BY) == (TURNED.sizes(BY[:3], 2), SHIFTED.sizes(BY[3:], 2))
    assert JOINT.sizes(BY)[0] != JOINT.sizes(np.roll(BY, 2))[0]


def test_each_interface_follows_its_own_observation() -> None:
    templates = {"slow": arch(0.25), "fast": arch(0.35)}
    points = {name: one.points[None] for name, one in templates.items()}
    found = JOINT.followed(points, templates, BY[None])
    for seen, errors, part in ((SEEN[0], TURNED, slice(0, 3)), (SEEN[1], SHIFTED, slice(3, 5))):
        name, middle = seen.condition, seen.interface.points.mean(axis=0)
        alone = errors.followed(points[name], templates[name], BY[None, part], middle=middle)
        np.testing.assert_array_equal(found[name], alone)
    moved = found["fast"] - points["fast"]
    assert np.linalg.norm(moved, axis=2) == pytest.approx(0.02 * np.hypot(0.7, 0.4))
