"""What one forward run shows about a study, and makes doubtful about its measures, before the others are made."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.study.studies.exact import softer

from strandline.calibration import Observer
from strandline.cli import main
from strandline.discrepancy import Currents, MeasurementLines, NormalOffset, WhitenedOffset, require_plausible
from strandline.foundations import ForwardModelError, InvalidInput, InvalidStudy
from strandline.interface import Interface, PointErrors
from strandline.models.fidelities import is_cheaper
from strandline.report import plots
from strandline.runs import Progress, RunRecord, RunRequest, attempt
from strandline.studies import load_study
from strandline.studies.foresight import first_run
from strandline.studies.foresight.measure_doubts import _sagittas, measure_lines, node_lines
from strandline.studies.load.models import cheaper_lines
from strandline.studies.run import _checking_sizes
from strandline.testing.studies import beam, write_study

TRUTH = {"E": 430.0, "tilt": 0.02, "load": 1e-5}
POINTS = np.asarray(beam(TRUTH, Path()).interface.points)
OBSERVED = {"file": "observed.csv", "unit": "mm"}


class Resting:
    """The beam, which also says where it rests, straight on y = 0, and how it bends on a finer mesh, if it does."""

    fingerprint = "test:resting"
    inputs = beam.inputs

    def __init__(self, finer=0.0):
        self.finer = finer

    def __call__(self, inputs, workdir):
        return beam(inputs, workdir)

    def undeformed(self):
        return Interface.polyline(POINTS * [1.0, 0.0])

    def on_finer_mesh(self, inputs):
        if self.finer == np.inf:
            raise ForwardModelError("limit_point", "it folds")
        return {"": Interface.polyline(beam(inputs, Path()).interface.points + np.array([0.0, self.finer]))}


def observing(folder, points, **changes):
    """Return a study that observes the points, with closest_point as its measure."""
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    changes = {"discrepancy": {"closest_point": {}}, "observation": OBSERVED, **changes}
    return load_study(write_study(folder, **changes))


def told(study, simulator=beam):
    """Return all that a run of the simulator in place of the study's model shows."""
    record = attempt(simulator, RunRequest("key", TRUTH), Path())
    study = first_run.facing(replace(study, model=simulator), record)
    first_run.require_same_size(study, record)
    parts = (first_run.shape_lines, first_run.displacement_lines, first_run.mesh_lines)
    return "\n".join([*first_run.turned_lines(study), *(line for lines in parts for line in lines(study, record))])


def test_the_distance_is_in_micrometres_and_from_1_mm_in_millimetres(tmp_path):
    for points, distance, unit in (
        (POINTS + np.array([0.0, 0.0021]), 2.1, "µm"),
        (POINTS * [1, 0] + [0.0, 5.0], 5.0, "mm"),
    ):
        shown = told(observing(tmp_path, points))
        (line,) = [line for line in shown.splitlines() if "distance of the observed points from this run:" in line]
        assert line.endswith(f" {unit}")
        assert float(line.split()[-2]) == pytest.approx(distance, rel=0.06)
    first, last = np.round(points[[0, -1]], 4).tolist()
    assert f"from {first} to {last}, length" in shown


def test_another_size_is_refused_with_the_unit_that_was_mistaken(tmp_path):
    for scale, words in (
        (1000.0, r"1e\+03 times.*Perhaps the observation is in µm and was read in mm"),
        (10.001, "10 times.*mm and cm differ by a factor of 10"),
        (1e-3, "0.001 times.*Perhaps the observation is in mm and was read in µm"),
        (0.0999, "0.0999 times.*mm and cm differ by a factor of 10"),
    ):
        with pytest.raises(InvalidStudy, match=f"size of the observation.*{words}"):
            told(observing(tmp_path, scale * POINTS))
    assert "the ends of the observed interface and of this run lie" in told(observing(tmp_path, 9.0 * POINTS))
    for unit, large, guessed in (("mm", 20.0, False), ("um", 1e-3, True), ("mm", 1e-3, False)):
        with pytest.raises(InvalidInput) as refused:
            require_plausible("file", Interface.polyline(large * POINTS), Interface.polyline(POINTS), unit=unit)
        assert ("Perhaps the observation is in" in str(refused.value)) is guessed


def test_a_reversed_contour_is_no_upside_down_one(tmp_path):
    shown = told(observing(tmp_path, POINTS[::-1]))
    assert "y upwards" not in shown
    assert "the observed points run opposite to the model's interface and will be turned round" in shown
    assert "y upwards" in told(observing(tmp_path, POINTS + np.array([0.5, 0.0])))


def test_exchanged_columns_are_named_and_end_a_study_after_its_first_runs(tmp_path):
    """Not if one of them comes near: here, the observation is its mirror image."""

    def seen(study, records):
        observer = _checking_sizes(Observer(), study)
        for record in records:
            observer.run(record, Progress(4, 1, 1, 0, 0, 0.0))

    study = observing(tmp_path, POINTS[:, ::-1])
    assert "With x and y exchanged it would lie " in told(study)
    runs = [attempt(beam, RunRequest("key", {**TRUTH, "E": young}), Path()) for young in (300.0, 400.0, 500.0)]
    with pytest.raises(InvalidStudy, match=r"axes of the observation: .*With x and y exchanged it would"):
        seen(study, [*runs, runs[0]])
    near = replace(runs[0], interfaces={"": Interface.polyline(POINTS[:, ::-1])})
    seen(study, [*runs, near])


def test_the_displacement_in_units_of_the_noise(tmp_path):
    """With normal_offset many points together show what each alone does not."""
    moved = POINTS[-1, 1]
    for measure, sd, hidden in (("tracked_points", 10.0, True), ("normal_offset", 0.1, False)):
        shown = told(load_study(write_study(tmp_path, discrepancy={measure: {}}, noise={"variance": sd**2})), Resting())
        assert f"largest displacement: {1e3 * moved:.3g} µm, {moved / sd:.3g} σ_N (σ_N = " in shown
        assert ("below the noise: the data cannot show it" in shown) == hidden


def test_a_noise_larger_than_the_whole_interface(tmp_path):
    for share, warns in ((0.9, False), (1.1, True)):
        study = load_study(write_study(tmp_path, noise={"sd": share * float(np.ptp(RUN.points[:, 0]))}))
        lines = list(first_run.noise_lines(study, RECORD))
        assert ["the data tell nothing" in line for line in lines] == [True] * warns


def test_a_norm_has_a_noise_length(tmp_path):
    """A shift of the beam by the length that is printed costs d² = σ_N²."""
    study = load_study(write_study(tmp_path, discrepancy={"currents": {"width": 0.05}}, noise={"variance": 1e-4}))
    (line,) = [line for line in told(study, Resting()).splitlines() if "largest displacement" in line]
    assert line.endswith(" µm that the noise hides")
    length, rest = 1e-3 * float(line.split()[-6]), Resting().undeformed()
    squares = [Currents(0.05)(Interface.polyline(rest.points + length * axis), rest) for axis in np.eye(2)]
    assert min(squares) < 1e-4 < max(squares)


def test_an_sd_of_each_point_and_another_number_of_nodes(tmp_path):
    """The simulated and the undeformed interface have 17 nodes, the observed one 33 points."""
    fine = np.column_stack([Interface.polyline(POINTS).resampled(33).points, np.tile([0.002, 0.003, 0.004], 11)])
    seen, noise = {**OBSERVED, "columns": [1, 2], "sd": 3}, {"sd": "column", "length": 50, "unit": "um"}
    shown = told(observing(tmp_path, fine, observation=seen, noise=noise), Resting())
    assert re.search("largest displacement: .*next finer mesh: ", shown, re.DOTALL)


def test_the_next_finer_mesh(tmp_path):
    """A model that makes the observation itself makes the same error in it."""
    seen = observing(tmp_path, POINTS, discrepancy={"tracked_points": {}})
    made = load_study(write_study(tmp_path / "made"))
    for study, warns in ((seen, True), (made, False)):
        shown = told(study, Resting(0.0004))
        assert "next finer mesh: the interface differs by at most 0.4 µm, 0.133 σ_N (σ_N = 3 µm)" in shown
        assert ("the mesh is too coarse for this noise" in shown) == warns
    assert "on the next finer mesh this run fails (limit_point)" in told(made, Resting(np.inf))


def test_the_picture_shows_what_there_is(tmp_path, monkeypatch):
    drawn = Mock(side_effect=lambda *_, **__: Figure().subplots())
    monkeypatch.setattr(plots, "plot_interfaces", drawn)
    observing(tmp_path, POINTS)
    main(["check", str(tmp_path), "--plot"])
    ((seen,), options) = drawn.call_args
    np.testing.assert_array_equal(seen.points, POINTS)
    np.testing.assert_array_equal(next(iter(options["simulated"].values())).points, POINTS)
    assert (tmp_path / "check.png").read_bytes().startswith(b"\x89PNG")


def test_a_check_compares_the_two_models(tmp_path):
    cheaper = {"model": {"python": {"function": "tests.study.studies.exact:softer"}}, "cost": 0.2}
    study = load_study(write_study(tmp_path, design={"active": {"runs": 60}}, fidelities=[cheaper]))

    def make(model, inputs, unit=1.0):
        made = attempt(model, RunRequest("", inputs), tmp_path)
        interface = Interface.polyline(unit * made.interface.points)
        return replace(made, interfaces={"": interface}, seconds=0.5 if is_cheaper(inputs) else 2.0)

    record = make(study.model, TRUTH)
    (line,) = cheaper_lines(study.model, record, make)
    off = 1e3 * np.ptp(softer(TRUTH, tmp_path).interface.points - POINTS)
    assert "ok in 0.5 s, 0.25 of the time (stated cost 0.2)" in line
    assert float(line.split("at most ")[1].split(" µm")[0]) == pytest.approx(off, rel=0.1)
    assert list(cheaper_lines(beam, record, make)) == []
    warning, _ = cheaper_lines(study.model, record, partial(make, unit=1e3))
    assert "another unit" in warning


RECORD = attempt(beam, RunRequest("key", TRUTH), Path())
RUN = RECORD.interfaces[""]


def doubts(folder, points, noise=None, **measure):
    study = observing(folder, points, discrepancy=measure, noise=noise or {"variance": 9e-6})
    return list(measure_lines(study, RECORD))


def noisy(share, number=120):
    """Return points on the run's interface, which is nearly horizontal, off in height by a share of their spacing."""
    points = RUN.resampled(number).points
    heights = share * points[-1, 0] / number * np.random.default_rng(1).standard_normal(number)
    return points + np.stack([0 * heights, heights], axis=1)


def test_lines_that_turn_with_the_noise(tmp_path):
    assert doubts(tmp_path, noisy(0.02), measurement_lines={"lines": 10}) == []
    (line,) = doubts(tmp_path, noisy(0.4), measurement_lines={"lines": 10})
    assert "normal_offset" in line
    (smooth,) = (float(value) for value in re.findall(r"`smooth: ([0-9.]+)`", line))
    assert MeasurementLines(smooth=smooth).scatter(Interface.polyline(noisy(0.4))) <= 3.0
    assert MeasurementLines(smooth=smooth / 2).scatter(Interface.polyline(noisy(0.4))) > 3.0
    assert doubts(tmp_path, noisy(0.4), measurement_lines={"lines": 10, "smooth": smooth}) == []


def test_an_observed_point_far_from_all_others(tmp_path):
    """Neither noise nor a gap makes one."""
    points = noisy(0.2, 30)
    spacing = points[-1, 0] / 30
    moved = points.copy()
    moved[12, 1] += 14 * spacing
    for seen, number in ((moved, 1), (points, 0), (np.delete(points, range(5, 15), axis=0), 0)):
        lines = doubts(tmp_path, seen, {"sd": 3, "unit": "um"}, normal_offset={})
        found = [line for line in lines if "from all others" in line]
        assert len(found) == number
    assert f"({moved[12, 0]:.4g}, {moved[12, 1]:.4g}) mm" in doubts(tmp_path, moved, closest_point={})[0]


def test_errors_correlated_over_much_of_the_interface(tmp_path):
    points = noisy(0.02)
    whole = 1e3 * float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    for share, warns in ((0.09, False), (0.12, True)):
        lines = doubts(tmp_path, points, {"sd": 1, "length": share * whole, "unit": "um"}, normal_offset={})
        assert ["12 % of the observed interface" in line for line in lines] == [True] * warns


def longer(share, side):
    """Return points on the run's interface and, beyond one of its ends, on a straight line."""
    points = RUN.resampled(60).points
    (end, inner) = points[::-side][:2]
    along = (end - inner) / np.linalg.norm(end - inner)
    more = end + np.arange(1, 9)[:, None] / 8 * share * np.linalg.norm(points[-1] - points[0]) * along
    return np.concatenate([points[::side], more])[::side]


def test_what_was_observed_in_part_and_what_was_not_simulated(tmp_path):
    gapped = np.concatenate([noisy(0.0)[:50], noisy(0.0)[65:]])
    beyond, past, gap = "direction: to_simulated", "past an end of the simulated one", "apart"
    for points, measure, words in (
        (RUN.points, {"closest_point": {}}, ""),
        (RUN.points[6:], {"closest_point": {"direction": "symmetric"}}, beyond),
        (RUN.resampled(200).points[:176], {"closest_point": {}}, ""),  # two spacings of the run
        (RUN.points[:11], {"closest_point": {"direction": "to_simulated"}}, ""),
        (RUN.points * [1.0, -3.0], {"closest_point": {}}, ""),  # a tip beside the observed one
        (longer(0.03, 1), {"normal_offset": {}}, ""),
        (longer(0.2, -1), {"normal_offset": {}}, past),
        (noisy(0.0), {"currents": {"width": 0.05}}, ""),
        (gapped, {"currents": {"width": 0.05}}, gap),
        (gapped, {"closest_point": {"direction": "to_observed"}}, gap),
        (gapped, {"closest_point": {"direction": "to_simulated"}}, ""),
        (gapped, {"normal_offset": {}}, ""),
    ):
        assert [words in line for line in doubts(tmp_path, points, **measure)] == [True] * bool(words)


def test_a_simulated_polyline_with_too_few_nodes(tmp_path):
    """The nodes of an arc of 1 mm, 3 mm long, move along it: d² changes although the curve does not, unless many do."""

    def arc(nodes, turned=0.0):
        t = np.linspace(0.0, 3.0, nodes) + turned
        return Interface.polyline(np.stack([-np.cos(t), np.sin(t)], axis=1))

    def lines(run, measure=None):
        measures = {"one": measure or NormalOffset()}
        content = {"observed": {"": seen}, "truth": None, "noise": errors, "discrepancies": measures}
        return list(node_lines(replace(study, **content), RunRecord("", {}, "ok", {"": run})))

    study, errors, spread = load_study(write_study(tmp_path)), PointErrors(0.001), {}
    seen = Interface.polyline(arc(2001).points[20:-20:2])
    for nodes in (41, 161):
        moved = [arc(nodes, step) for step in np.linspace(0, 3.0 / (nodes - 1), 9)[:-1]]
        spread[nodes] = float(np.ptp([WhitenedOffset(errors)(one, seen) for one in moved]))
    assert spread[161] < 1 < spread[41]
    np.testing.assert_allclose(_sagittas(arc(41)), 1 - np.cos(3.0 / 80), rtol=1e-3)
    assert not lines(arc(161))
    (line,) = lines(arc(41))
    assert line.startswith("warning: between its nodes the simulated polyline is up to 0.7 µm off the smooth curve")
    times = float(line.split("at least ")[1].split(" times")[0])
    assert not lines(arc(int(41 * times) + 1))
    assert lines(arc(int(0.8 * 41 * times)))
    corner = Interface.polyline(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]))
    assert lines(corner) == lines(arc(41), Currents(0.1)) == []


def test_the_centre_of_a_ring_is_that_of_its_area():
    """Also if most of its points lie on one side."""
    angle = 2 * np.pi * np.linspace(0.0, 1.0, 200, endpoint=False) ** 3
    uneven = Interface.polyline(np.stack([3 + np.cos(angle), 1 + np.sin(angle)], axis=1), closed=True)
    np.testing.assert_allclose(first_run._middle(uneven), [3, 1], atol=2e-3)
