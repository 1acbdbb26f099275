"""What one forward run shows about a study before the others are made."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.cli import main
from strandline.discrepancy import Currents
from strandline.errors import ForwardModelError, InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel, Simulation
from strandline.runs import RunRecord, RunRequest, attempt
from strandline.studies import Study, load_study
from strandline.studies.cheaper import cheaper_lines
from strandline.studies.first_run import (
    batch_lines,
    displacement_lines,
    facing,
    mesh_lines,
    require_same_size,
    shape_lines,
    turned_lines,
)
from strandline.testing.studies import TWO_LOADS_STUDY, beam, write_study

TRUTH = {"E": 430.0, "tilt": 0.02, "load": 1e-5}
POINTS = np.asarray(beam(TRUTH, Path()).interface.points)
OBSERVED = {"file": "observed.csv", "unit": "mm"}


class Resting:
    """The beam, which also says where it rests, straight on y = 0, and how it bends on a finer mesh."""

    fingerprint = "test:resting"
    inputs = beam.inputs

    def __init__(self, finer: float = 0.0) -> None:
        self.finer = finer

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return beam(inputs, workdir)

    def undeformed(self) -> Interface:
        return Interface.polyline(POINTS * [1.0, 0.0])

    def on_finer_mesh(self, inputs: Mapping[str, float]) -> dict[str, Interface]:
        return {"": Interface.polyline(beam(inputs, Path()).interface.points + np.array([0.0, self.finer]))}


class Folding(Resting):
    def on_finer_mesh(self, inputs: Mapping[str, float]) -> dict[str, Interface]:
        raise ForwardModelError("limit_point", "it folds")


def observing(folder: Path, points: np.ndarray, **changes: Any) -> Study:
    """Return a study that observes the points, with closest_point as its measure."""
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    changes = {"discrepancy": {"closest_point": {}}, "observation": OBSERVED, **changes}
    return load_study(write_study(folder, **changes))


def told(study: Study, simulator: Any = beam) -> str:
    """Return all that a run of the simulator in place of the study's model shows."""
    record = attempt(simulator, RunRequest("key", TRUTH), Path())
    study = facing(replace(study, model=simulator), record)
    require_same_size(study, record)
    shown = (shape_lines, displacement_lines, mesh_lines, batch_lines)
    return "\n".join([*turned_lines(study), *(line for lines in shown for line in lines(study, record))])


def test_the_distance_is_in_micrometres_and_from_1_mm_in_millimetres(tmp_path: Path) -> None:
    shown = told(observing(tmp_path, POINTS + np.array([0.0, 0.0021])))
    slope = np.gradient(POINTS[:, 1], POINTS[:, 0]).max()
    (line,) = [line for line in shown.splitlines() if "distance of the observed points from this run:" in line]
    rms, largest = (float(word) for word in line.split() if word[0].isdigit())
    assert 2.1 / np.hypot(1, slope) - 0.01 < rms <= largest <= 2.11
    assert line.count("µm") == 2
    far = told(observing(tmp_path, POINTS * [1, 0] + [0.0, 5.0]))
    (line,) = [line for line in far.splitlines() if "distance of the observed points from this run:" in line]
    assert line.endswith(" mm")
    assert float(line.split()[-2]) == pytest.approx(5.0, abs=0.1)


def test_another_size_is_refused_with_the_unit_that_was_mistaken(tmp_path: Path) -> None:
    for scale, ratio, units in (
        (1000.0, "1e+03 times", "Perhaps the observation is in µm and was read in mm"),
        (149.0, "149 times", "µm and mm differ by a factor of 1000"),
        (10.001, "10 times", "mm and cm differ by a factor of 10"),
        (1e-3, "0.001 times", "Perhaps the observation is in mm and was read in µm"),
        (0.0999, "0.0999 times", "mm and cm differ by a factor of 10"),
    ):
        with pytest.raises(InvalidStudy, match="size of the observation") as caught:
            told(observing(tmp_path, scale * POINTS))
        assert ratio in str(caught.value)
        assert units in str(caught.value)
    for scale in (9.0, 0.12):
        assert "the ends of the observed interface and of this run lie" in told(observing(tmp_path, scale * POINTS))


def test_a_reversed_contour_is_no_upside_down_one(tmp_path: Path) -> None:
    shown = told(observing(tmp_path, POINTS[::-1]))
    assert "y upwards" not in shown
    assert "the observed points run opposite to the model's interface and will be turned round" in shown
    assert "y upwards" in told(observing(tmp_path, POINTS[:, ::-1]))


@pytest.mark.parametrize(
    ("measure", "sd", "hidden"),
    [
        ("tracked_points", 0.2, False),
        ("tracked_points", 10.0, True),
        ("normal_offset", 0.1, False),  # many points together show what each alone does not
        ("normal_offset", 0.5, True),
    ],
)
def test_the_displacement_in_units_of_the_noise(tmp_path: Path, measure: str, sd: float, hidden: bool) -> None:
    assert np.sqrt(np.mean(POINTS[:, 1] ** 2)) < 0.1 < np.sqrt(np.sum(POINTS[:, 1] ** 2)) < 0.5
    shown = told(load_study(write_study(tmp_path, discrepancy={measure: {}}, noise={"sd": sd})), Resting())
    moved = POINTS[-1, 1]
    assert f"largest displacement: {1e3 * moved:.3g} µm, {moved / sd:.3g} σ_N (σ_N = " in shown
    assert ("below the noise: the data cannot show it" in shown) == hidden


def test_a_norm_has_a_noise_length(tmp_path: Path) -> None:
    """A shift of the beam by the length that is printed costs d² = σ_N²."""
    study = load_study(write_study(tmp_path, discrepancy={"currents": {"width": 0.05}}, noise={"variance": 1e-4}))
    (line,) = [line for line in told(study, Resting()).splitlines() if "largest displacement" in line]
    assert line.endswith(" µm that the noise hides")
    length, rest = 1e-3 * float(line.split()[-6]), Resting().undeformed()
    squares = [Currents(0.05)(Interface.polyline(rest.points + length * axis), rest) for axis in np.eye(2)]
    assert min(squares) < 1e-4 < max(squares)


@pytest.mark.parametrize("measure", [{"currents": {"width": 0.05}}, {"closest_point": {}}], ids=str)
def test_an_sd_of_each_point_and_another_number_of_nodes(tmp_path: Path, measure: dict[str, Any]) -> None:
    """The simulated and the undeformed interface have 17 nodes, the observed one 33 points."""
    fine = np.column_stack([Interface.polyline(POINTS).resampled(33).points, np.tile([0.002, 0.003, 0.004], 11)])
    seen = {**OBSERVED, "columns": [1, 2], "sd": 3}
    noise = {"sd": "column", "length": 50, "unit": "um"}
    shown = told(observing(tmp_path, fine, observation=seen, discrepancy=measure, noise=noise), Resting())
    assert "largest displacement: " in shown
    assert "next finer mesh: " in shown


def test_the_next_finer_mesh(tmp_path: Path) -> None:
    """A model that makes the observation itself makes the same error in it."""
    seen = observing(tmp_path, POINTS, discrepancy={"tracked_points": {}})
    made = load_study(write_study(tmp_path / "made"))
    for study, finer, words, warns in (
        (seen, 0.0, "0 µm, 0 σ_N", False),
        (seen, 0.0004, "0.4 µm, 0.133 σ_N (σ_N = 3 µm)", True),
        (made, 0.0004, "0.4 µm, 0.133 σ_N (σ_N = 3 µm)", False),
    ):
        shown = told(study, Resting(finer))
        assert f"next finer mesh: the interface differs by at most {words}" in shown
        assert ("the mesh is too coarse for this noise" in shown) == warns
    assert "on the next finer mesh this run fails (limit_point)" in told(made, Folding())


def test_a_batch_that_takes_long_to_choose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    active = {"design": {"active": {"runs": 60}}, "surrogate": {"field": {}}}
    expected = "choosing a batch takes about 31 s, to compare interfaces with 17 observed points; to shorten it, keep"
    for seconds, changes, warns in ((31.0, active, True), (29.0, active, False), (1e6, {}, False)):
        monkeypatch.setattr("strandline.studies.first_run.seconds_of_a_batch", lambda *_, now=seconds: now)
        shown = told(observing(tmp_path, POINTS, **changes))
        assert (expected in shown) == ("one in 2 of them" in shown) == warns


def test_the_picture_shows_what_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    from strandline.report import plots

    drawn: list[Any] = []
    monkeypatch.setattr(plots, "plot_interfaces", lambda *a, **k: drawn.append((a, k)) or Figure().subplots())
    monkeypatch.setattr("strandline.studies.build.build_model", lambda *_, **__: Resting())
    observing(tmp_path, POINTS)
    main(["check", str(tmp_path), "--plot"])
    (((seen,), options),) = drawn
    np.testing.assert_array_equal(seen.points, POINTS)
    np.testing.assert_array_equal(options["reference"].points, Resting().undeformed().points)
    np.testing.assert_array_equal(next(iter(options["simulated"].values())).points, POINTS)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["check.png", "observed.csv", "study.yaml"]


def test_the_picture_of_two_conditions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", str(write_study(tmp_path, **TWO_LOADS_STUDY)), "--plot"])
    assert f"wrote {tmp_path / 'check.png'}\n" in capsys.readouterr().out
    assert (tmp_path / "check.png").read_bytes().startswith(b"\x89PNG")


def test_a_check_compares_the_two_models(tmp_path: Path) -> None:
    from tests.study.studies.softer import softer

    from strandline.models.fidelities import is_cheaper

    cheaper = {"model": {"python": {"function": "tests.study.studies.softer:softer"}}, "cost": 0.2}
    study = load_study(write_study(tmp_path, design={"active": {"runs": 60}}, fidelities=[cheaper]))

    def make(model: ForwardModel, inputs: Mapping[str, float]) -> RunRecord:
        return replace(attempt(model, RunRequest("", inputs), tmp_path), seconds=0.5 if is_cheaper(inputs) else 2.0)

    def in_micrometres(model: ForwardModel, inputs: Mapping[str, float]) -> RunRecord:
        """The planted mistake: the cheaper model's result has another unit."""
        made = make(model, inputs)
        return replace(made, interfaces={"": Interface.polyline(1e3 * made.interface.points)})

    record = make(study.model, TRUTH)
    (line,) = cheaper_lines(study.model, record, make)
    off = 1e3 * np.ptp(softer(TRUTH, tmp_path).interface.points - POINTS)
    assert "ok in 0.5 s, 0.25 of the time (stated cost 0.2)" in line
    assert float(line.split("at most ")[1].split(" µm")[0]) == pytest.approx(off, rel=0.1)
    assert list(cheaper_lines(beam, record, make)) == []
    warning, _ = cheaper_lines(study.model, record, in_micrometres)
    assert warning.startswith("warning: the interface of the cheaper model is off by")
    assert "another unit" in warning
