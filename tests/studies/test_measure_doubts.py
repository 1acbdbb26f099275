"""What `strandline check` doubts about measures: lines that turn with the noise, nodes that were not observed."""

import re
from pathlib import Path

import numpy as np
import pytest

from strandline.discrepancy import MeasurementLines
from strandline.interface import Interface
from strandline.runs import InProcess, RunRecord, RunRequest
from strandline.studies import Study, load_study
from strandline.studies.measure_doubts import _steady_piece, measure_lines
from strandline.testing.studies import beam, write_study

INPUTS = {"E": 430.0, "tilt": 0.02, "load": 1e-5}
OBSERVED = {"file": "observed.csv", "unit": "mm"}


def study_of(folder: Path, points: np.ndarray, measure: dict[str, object]) -> Study:
    folder.mkdir()
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    return load_study(write_study(folder, observation=OBSERVED, discrepancy=measure))


@pytest.fixture
def record() -> RunRecord:
    (found,) = InProcess()(beam, [RunRequest("key", INPUTS)])
    return found


def told(folder: Path, record: RunRecord, points: np.ndarray, **measure: object) -> list[str]:
    return list(measure_lines(study_of(folder, points, measure), record))


def noisy(record: RunRecord, share: float, number: int = 120) -> np.ndarray:
    """Return points on the run's interface, which is nearly horizontal, off in height by a share of their spacing."""
    points = record.interfaces[""].resampled(number).points
    heights = share * points[-1, 0] / number * np.random.default_rng(1).standard_normal(number)
    return points + np.stack([0 * heights, heights], axis=1)


@pytest.mark.parametrize(("share", "warns"), [(0.02, False), (0.4, True)])
def test_lines_that_turn_with_the_noise(tmp_path: Path, record: RunRecord, share: float, warns: bool) -> None:
    points = noisy(record, share)
    lines = told(tmp_path / "one", record, points, measurement_lines={"lines": 10})
    assert bool(lines) == warns
    if warns:
        (line,) = lines
        assert "normal_offset" in line
        (smooth,) = (float(value) for value in re.findall(r"`smooth: ([0-9.]+)`", line))
        assert MeasurementLines(smooth=smooth).scatter(Interface.polyline(points)) <= 3.0
        assert told(tmp_path / "two", record, points, measurement_lines={"lines": 10, "smooth": smooth}) == []


@pytest.mark.parametrize(("share", "warns"), [(0.09, False), (0.12, True)])
def test_errors_correlated_over_much_of_the_interface(
    tmp_path: Path, record: RunRecord, share: float, warns: bool
) -> None:
    points = noisy(record, 0.02)
    whole = 1e3 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    np.savetxt(tmp_path / "observed.csv", points, delimiter=",")
    noise = {"sd": 1, "length": share * whole, "unit": "um"}
    folder = write_study(tmp_path, observation=OBSERVED, discrepancy={"normal_offset": {}}, noise=noise)
    lines = list(measure_lines(load_study(folder), record))
    assert bool(lines) == warns
    assert not warns or "12 % of the observed interface" in lines[0]


@pytest.mark.parametrize(("scatter", "expected"), [(10.5, "0.04"), (30.0, "0.1"), (31.0, "0.11")])
def test_the_piece_has_at_least_four_spacings(scatter: float, expected: str) -> None:
    seen = Interface.polyline(np.stack([0.01 * np.arange(50), np.zeros(50)], axis=1))
    assert _steady_piece(MeasurementLines(), seen, scatter) == expected


@pytest.mark.parametrize(
    ("part", "options", "warns"),
    [
        (slice(None), {}, False),
        (slice(0, 11), {}, True),
        (slice(6, None), {"direction": "symmetric"}, True),
        (slice(0, 11), {"direction": "to_simulated"}, False),
        (slice(0, 15), {}, False),
    ],
    ids=["whole", "end cut", "begin cut", "the way that is right", "two spacings"],
)
def test_nodes_beyond_the_end_of_a_partly_seen_interface(
    tmp_path: Path, record: RunRecord, part: slice, options: dict[str, str], warns: bool
) -> None:
    points = record.interfaces[""].points[part]
    lines = told(tmp_path / "s", record, points, closest_point=options)
    assert bool(lines) == warns
    assert all("direction: to_simulated" in line and "normal_offset" in line for line in lines)


@pytest.mark.parametrize(("factor", "warns"), [(1.03, False), (1.2, True)])
@pytest.mark.parametrize("side", [1, -1])
def test_observed_points_past_the_end_of_the_simulated_interface(
    tmp_path: Path, record: RunRecord, factor: float, side: int, warns: bool
) -> None:
    points = record.interfaces[""].resampled(60).points
    whole = np.linalg.norm(points[-1] - points[0])
    end, inner = (points[-1], points[-2]) if side > 0 else (points[0], points[1])
    along = (end - inner) / np.linalg.norm(end - inner)
    more = end + np.arange(1, 9)[:, None] / 8 * (factor - 1) * whole * along
    seen = np.concatenate([points, more] if side > 0 else [more[::-1], points])
    lines = told(tmp_path / "one", record, seen, normal_offset={})
    assert bool(lines) == warns
    assert not warns or "past an end of the simulated one" in lines[0]


def test_a_tip_that_lies_beside_the_observed_one_is_not_beyond_it(tmp_path: Path, record: RunRecord) -> None:
    points = record.interfaces[""].points * np.array([1.0, -3.0])
    assert told(tmp_path / "s", record, points, closest_point={}) == []


def test_measures_without_doubts_say_nothing(tmp_path: Path, record: RunRecord) -> None:
    assert told(tmp_path / "s", record, record.interfaces[""].points[:10], normal_offset={}) == []


@pytest.mark.parametrize(
    ("measure", "warns"),
    [
        ({"currents": {"width": 0.05}}, True),
        ({"measurement_lines": {"lines": 10}}, True),
        ({"closest_point": {"direction": "to_observed"}}, True),
        ({"closest_point": {"direction": "to_simulated", "weighting": "length"}}, True),
        ({"closest_point": {"direction": "to_simulated"}}, False),
        ({"normal_offset": {}}, False),
    ],
)
def test_a_gap_in_the_observed_points(
    tmp_path: Path, record: RunRecord, measure: dict[str, dict[str, object]], warns: bool
) -> None:
    points = noisy(record, 0.0)
    (name,) = measure
    assert not any("apart" in line for line in told(tmp_path / "whole", record, points, **measure)), name
    gapped = np.concatenate([points[:50], points[65:]])
    assert any("apart" in line for line in told(tmp_path / "gap", record, gapped, **measure)) == warns
