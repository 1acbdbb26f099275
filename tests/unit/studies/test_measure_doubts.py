"""What a run makes doubtful about measures: lines that turn with the noise, nodes without observation or too few."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.discrepancy import ClosestPoint, Currents, MeasurementLines, NormalOffset, WhitenedOffset
from strandline.interface import Interface, PointErrors
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import Study, load_study
from strandline.studies.measure_doubts import _steady_piece, measure_lines
from strandline.studies.simulated_nodes import node_lines
from strandline.testing.studies import beam, write_study

RECORD = attempt(beam, RunRequest("key", {"E": 430.0, "tilt": 0.02, "load": 1e-5}), Path())
RUN = RECORD.interfaces[""]
OBSERVED = {"file": "observed.csv", "unit": "mm"}


def told(folder: Path, points: np.ndarray, noise: dict[str, Any] | None = None, **measure: object) -> list[str]:
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    study = write_study(folder, observation=OBSERVED, discrepancy=measure, noise=noise or {"sd": 0.003})
    return list(measure_lines(load_study(study), RECORD))


def noisy(share: float, number: int = 120) -> np.ndarray:
    """Return points on the run's interface, which is nearly horizontal, off in height by a share of their spacing."""
    points = RUN.resampled(number).points
    heights = share * points[-1, 0] / number * np.random.default_rng(1).standard_normal(number)
    return points + np.stack([0 * heights, heights], axis=1)


def test_lines_that_turn_with_the_noise(tmp_path: Path) -> None:
    assert told(tmp_path, noisy(0.02), measurement_lines={"lines": 10}) == []
    (line,) = told(tmp_path, noisy(0.4), measurement_lines={"lines": 10})
    assert "normal_offset" in line
    (smooth,) = (float(value) for value in re.findall(r"`smooth: ([0-9.]+)`", line))
    assert MeasurementLines(smooth=smooth).scatter(Interface.polyline(noisy(0.4))) <= 3.0
    assert told(tmp_path, noisy(0.4), measurement_lines={"lines": 10, "smooth": smooth}) == []


def test_the_piece_has_at_least_four_spacings() -> None:
    seen = Interface.polyline(np.stack([0.01 * np.arange(50), np.zeros(50)], axis=1))
    for scatter, expected in ((10.5, "0.04"), (30.0, "0.1"), (31.0, "0.11")):
        assert _steady_piece(MeasurementLines(), seen, scatter) == expected


def test_errors_correlated_over_much_of_the_interface(tmp_path: Path) -> None:
    points = noisy(0.02)
    whole = 1e3 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    for share, warns in ((0.09, False), (0.12, True)):
        lines = told(tmp_path, points, {"sd": 1, "length": share * whole, "unit": "um"}, normal_offset={})
        assert bool(lines) == warns
        assert not warns or "12 % of the observed interface" in lines[0]


def test_nodes_beyond_the_end_of_a_partly_seen_interface(tmp_path: Path) -> None:
    for part, options, warns in (
        (slice(None), {}, False),
        (slice(0, 11), {}, True),
        (slice(6, None), {"direction": "symmetric"}, True),
        (slice(0, 11), {"direction": "to_simulated"}, False),
        (slice(0, 15), {}, False),
    ):
        lines = told(tmp_path, RUN.points[part], closest_point=options)
        assert bool(lines) == warns
        assert all("direction: to_simulated" in line and "normal_offset" in line for line in lines)
    assert told(tmp_path, RUN.points[:10], normal_offset={}) == []
    assert told(tmp_path, RUN.points * [1.0, -3.0], closest_point={}) == []  # a tip beside the observed one


@pytest.mark.parametrize(("factor", "warns"), [(1.03, False), (1.2, True)])
def test_observed_points_past_an_end_of_the_simulated_interface(tmp_path: Path, factor: float, warns: bool) -> None:
    points = RUN.resampled(60).points
    whole = np.linalg.norm(points[-1] - points[0])
    for side in (1, -1):
        (end, inner) = points[::-side][:2]
        along = (end - inner) / np.linalg.norm(end - inner)
        more = end + np.arange(1, 9)[:, None] / 8 * (factor - 1) * whole * along
        lines = told(tmp_path, np.concatenate([points[::side], more])[::side], normal_offset={})
        assert bool(lines) == warns
        assert not warns or "past an end of the simulated one" in lines[0]


def test_a_gap_in_the_observed_points(tmp_path: Path) -> None:
    points = noisy(0.0)
    gapped = np.concatenate([points[:50], points[65:]])
    measures: list[tuple[dict[str, Any], bool]] = [
        ({"currents": {"width": 0.05}}, True),
        ({"measurement_lines": {"lines": 10}}, True),
        ({"closest_point": {"direction": "to_observed"}}, True),
        ({"closest_point": {"direction": "to_simulated", "weighting": "length"}}, True),
        ({"closest_point": {"direction": "to_simulated"}}, False),
        ({"normal_offset": {}}, False),
    ]
    for measure, warns in measures:
        assert not any("apart" in line for line in told(tmp_path, points, **measure))
        assert any("apart" in line for line in told(tmp_path, gapped, **measure)) == warns


class TestNodes:
    """A simulated polyline with too few nodes: what is said, and what more nodes change."""

    ERRORS = PointErrors(0.001)

    def arc(self, nodes: int, *, turned: float = 0.0) -> Interface:
        """Return a circular arc of radius 1 mm, 3 mm long, with its nodes moved along it."""
        t = np.linspace(0.0, 3.0, nodes) + turned
        return Interface.polyline(np.stack([-np.cos(t), np.sin(t)], axis=1))

    @pytest.fixture
    def study(self, tmp_path: Path) -> Study:
        seen = {"": Interface.polyline(self.arc(2001).points[20:-20:2])}
        study = load_study(write_study(tmp_path))
        measures = {"normal_offset": NormalOffset()}
        return replace(study, observed=seen, truth=None, noise=self.ERRORS, discrepancies=measures)

    def lines(self, study: Study, run: Interface) -> list[str]:
        return list(node_lines(study, RunRecord("", {}, "ok", {"": run})))

    def test_the_change_of_d2_is_that_of_nodes_elsewhere(self, study: Study) -> None:
        """The nodes of the arc move along it, and d² changes although the curve does not."""
        seen, measure = study.observed[""], WhitenedOffset(self.ERRORS)
        spread = {}
        for nodes in (41, 81, 161):
            steps = np.linspace(0, 3.0 / (nodes - 1), 9)[:-1]
            spread[nodes] = float(np.ptp([measure(self.arc(nodes, turned=step), seen) for step in steps]))
            assert bool(self.lines(study, self.arc(nodes))) == (nodes < 161)
        assert spread[161] < 1 < spread[41]

    def test_as_many_nodes_as_it_says_are_enough(self, study: Study) -> None:
        (line,) = self.lines(study, self.arc(41))
        assert line.startswith("warning: between its nodes the simulated polyline is up to 0.7 µm off the smooth curve")
        times = float(line.split("at least ")[1].split(" times")[0])
        assert not self.lines(study, self.arc(int(41 * times) + 1))
        assert self.lines(study, self.arc(int(0.8 * 41 * times)))

    def test_corners_of_the_shape_and_other_measures_say_nothing(self, study: Study) -> None:
        corner = Interface.polyline(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]))
        assert not self.lines(study, corner)
        for measure in (ClosestPoint(), Currents(0.1)):
            assert not self.lines(replace(study, discrepancies={"other": measure}), self.arc(41))
