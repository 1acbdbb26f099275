"""A simulated polyline with too few nodes: what is said, and what more nodes change."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strandline.discrepancy import ClosestPoint, Currents, NormalOffset, WhitenedOffset
from strandline.interface import Interface, PointErrors
from strandline.runs import RunRecord
from strandline.studies import Study, load_study
from strandline.studies.simulated_nodes import node_lines
from strandline.testing.studies import write_study

ERRORS = PointErrors(0.001)


def arc(nodes: int, *, turned: float = 0.0) -> Interface:
    """Return a circular arc of radius 1 mm, 3 mm long, with its nodes moved along it."""
    t = np.linspace(0.0, 3.0, nodes) + turned
    return Interface.polyline(np.stack([-np.cos(t), np.sin(t)], axis=1))


@pytest.fixture
def study(tmp_path: Path) -> Study:
    study = load_study(write_study(tmp_path))
    seen = {"": Interface.polyline(arc(2001).points[20:-20:2])}
    return replace(study, observed=seen, truth=None, noise=ERRORS, discrepancies={"normal_offset": NormalOffset()})


def lines(study: Study, nodes: int) -> list[str]:
    return list(node_lines(study, RunRecord("", {}, "ok", {"": arc(nodes)})))


def test_the_change_of_d2_is_that_of_nodes_elsewhere(study: Study) -> None:
    """The nodes of the arc move along it, and d² changes although the curve does not."""
    assert study.observed is not None
    seen = study.observed[""]
    spread = {}
    for nodes in (41, 81, 161):
        step = 3.0 / (nodes - 1)
        moved = [WhitenedOffset(ERRORS)(arc(nodes, turned=share * step), seen) for share in np.linspace(0, 1, 9)[:-1]]
        spread[nodes] = float(np.ptp(moved))
        assert bool(lines(study, nodes)) == (nodes < 161)
    assert spread[161] < 1 < spread[41]


def test_as_many_nodes_as_it_says_are_enough(study: Study) -> None:
    (line,) = lines(study, 41)
    assert line.startswith("warning: between its nodes the simulated polyline is up to 0.7 µm off the smooth curve")
    times = float(line.split("at least ")[1].split(" times")[0])
    assert not lines(study, int(41 * times) + 1)
    assert lines(study, int(0.8 * 41 * times))


def test_corners_of_the_shape_and_other_measures_say_nothing(study: Study) -> None:
    corner = Interface.polyline(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]))
    record = RunRecord("", {}, "ok", {"": corner})
    assert not list(node_lines(study, record))
    for measure in (ClosestPoint(), Currents(0.1)):
        assert not lines(replace(study, discrepancies={"other": measure}), 41)
