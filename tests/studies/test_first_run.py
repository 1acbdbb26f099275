"""What `strandline check` says of its one forward run."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.cli import main
from strandline.errors import ForwardModelError
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.testing.studies import TWO_LOADS_STUDY, beam, two_loads, write_study

TRUTH = {"E": 430.0, "tilt": 0.02, "load": 1e-5}
OBSERVED = {"file": "observed.csv", "unit": "mm"}
CLOSEST = {"closest_point": {}}


class Resting:
    """The beam, which also says where it rests: straight on y = 0, and how it bends on a finer mesh."""

    fingerprint = "test:resting"
    inputs = beam.inputs
    finer = 0.0

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        return beam(inputs, workdir)

    def undeformed(self) -> Interface:
        x = np.linspace(0.0, 1.0, 17)
        return Interface.polyline(np.stack([x, 0.0 * x], axis=1))

    def on_finer_mesh(self, inputs: Mapping[str, float]) -> dict[str, Interface]:
        points = beam(inputs, Path()).interface.points
        return {"": Interface.polyline(points + np.array([0.0, self.finer]))}


class Strict(Resting):
    def on_finer_mesh(self, inputs: Mapping[str, float]) -> dict[str, Interface]:
        raise ForwardModelError("limit_point", "it folds")


class Rough(Resting):
    finer = 0.0004


resting, strict, rough = Resting(), Strict(), Rough()


def observe(folder: Path, points: np.ndarray) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    return folder


def check(folder: Path, simulator: Any, *options: str, **changes: Any) -> None:
    """Check the study with `simulator` in place of the model that study.yaml names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.build.build_model", lambda *_, **__: simulator)
        main(["check", str(write_study(folder, **changes)), *options])


def checked(
    folder: Path, capsys: pytest.CaptureFixture[str], *options: str, simulator: Any = beam, **changes: Any
) -> str:
    check(folder, simulator, *options, **changes)
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


def refused(folder: Path, capsys: pytest.CaptureFixture[str], simulator: Any, **changes: Any) -> str:
    before = sorted(folder.iterdir())
    with pytest.raises(SystemExit) as ended:
        check(folder, simulator, **changes)
    shown = capsys.readouterr()
    assert (ended.value.code, shown.out) == (2, "")
    assert len(shown.err.splitlines()) == 1
    assert sorted(folder.iterdir()) == sorted({*before, folder / "study.yaml"})
    return shown.err


@pytest.fixture
def points(tmp_path: Path) -> np.ndarray:
    return np.asarray(beam(TRUTH, tmp_path).interface.points)


def test_the_distance_is_in_micrometres(tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray) -> None:
    straight = np.stack([np.linspace(0, 1, 17), 0.0 * np.linspace(0, 1, 17)], axis=1)
    folder = observe(tmp_path / "s", points + np.array([0.0, 0.0021]))
    shown = checked(folder, capsys, observation=OBSERVED, discrepancy=CLOSEST)
    slope = np.gradient(points[:, 1], points[:, 0]).max()
    (line,) = [line for line in shown.splitlines() if "distance of the observed points from this run:" in line]
    rms, largest = (float(word) for word in line.split() if word[0].isdigit())
    assert 2.1 / np.hypot(1, slope) - 0.01 < rms <= largest <= 2.11
    assert line.count("µm") == 2
    far = checked(observe(folder, straight + np.array([0.0, 5.0])), capsys, observation=OBSERVED, discrepancy=CLOSEST)
    (line,) = [line for line in far.splitlines() if "distance of the observed points from this run:" in line]
    assert line.endswith(" mm")
    assert float(line.split()[-2]) == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(
    ("scale", "ratio", "units"),
    [
        (1000.0, "1e+03 times", "Perhaps the observation is in µm and was read in mm"),
        (149.0, "149 times", "µm and mm differ by a factor of 1000"),
        (10.001, "10 times", "mm and cm differ by a factor of 10"),
        (1e-3, "0.001 times", "Perhaps the observation is in mm and was read in µm"),
        (0.0999, "0.0999 times", "mm and cm differ by a factor of 10"),
    ],
)
@pytest.mark.parametrize("simulator", [resting, beam], ids=["resting", "beam"])
def test_another_size_is_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    points: np.ndarray,
    scale: float,
    ratio: str,
    units: str,
    simulator: Any,
) -> None:
    folder = observe(tmp_path / "s", scale * points)
    line = refused(folder, capsys, simulator, observation=OBSERVED)
    assert "size of the observation" in line
    assert ratio in line
    assert units in line


@pytest.mark.parametrize("scale", [9.0, 0.12])
def test_less_than_ten_times_is_not_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, scale: float
) -> None:
    shown = checked(observe(tmp_path / "s", scale * points), capsys, observation=OBSERVED)
    assert "warning: the ends of the observed interface and of this run lie" in shown


@pytest.mark.parametrize("simulator", [resting, beam], ids=["resting", "beam"])
def test_a_reversed_contour_is_no_upside_down_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, simulator: Any
) -> None:
    folder = observe(tmp_path / "s", points[::-1])
    shown = checked(folder, capsys, observation=OBSERVED, simulator=simulator, discrepancy=CLOSEST)
    assert "y upwards" not in shown
    assert "the observed points run opposite to the model's interface and will be turned round" in shown
    upside_down = points[:, ::-1]
    assert "y upwards" in checked(observe(folder, upside_down), capsys, observation=OBSERVED, simulator=simulator)


@pytest.mark.parametrize(("sd", "hidden"), [(0.003, False), (0.2, False), (10.0, True)])
def test_the_displacement_in_units_of_the_noise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, sd: float, hidden: bool
) -> None:
    shown = checked(tmp_path / "s", capsys, simulator=resting, noise={"sd": sd})
    moved = points[-1, 1]
    assert f"largest displacement: {1e3 * moved:.3g} µm, {moved / sd:.3g} σ_N (σ_N = " in shown
    assert ("below the noise: the data cannot show it" in shown) == hidden


@pytest.mark.parametrize(("sd", "hidden"), [(0.1, False), (0.5, True)])
def test_many_points_together_show_what_each_alone_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, sd: float, hidden: bool
) -> None:
    assert np.sqrt(np.mean(points[:, 1] ** 2)) < 0.1 < np.sqrt(np.sum(points[:, 1] ** 2)) < 0.5
    shown = checked(tmp_path / "s", capsys, simulator=resting, discrepancy={"normal_offset": {}}, noise={"sd": sd})
    assert ("below the noise: the data cannot show it" in shown) == hidden


def test_a_norm_has_a_noise_length(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A shift of the beam by the length that is printed costs d² = σ_N²."""
    currents = {"currents": {"width": 0.05}}
    shown = checked(tmp_path / "s", capsys, simulator=resting, discrepancy=currents, noise={"variance": 1e-4})
    (line,) = [line for line in shown.splitlines() if "largest displacement" in line]
    assert line.endswith(" µm that the noise hides")
    length = 1e-3 * float(line.split()[-6])
    rest = resting.undeformed()
    measure = load_study(tmp_path / "s").discrepancies["currents"]
    squares = [measure(Interface.polyline(rest.points + length * axis), rest) for axis in np.eye(2)]
    assert min(squares) < 1e-4 < max(squares)


@pytest.mark.parametrize("measure", [{"currents": {"width": 0.05}}, CLOSEST], ids=["currents", "closest_point"])
def test_an_sd_of_each_point_and_another_number_of_nodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, measure: dict[str, Any]
) -> None:
    """The simulated and the undeformed interface have 17 nodes, the observed one 33 points."""
    fine = Interface.polyline(points).resampled(33).points
    folder = observe(tmp_path / "s", np.column_stack([fine, np.tile([0.002, 0.003, 0.004], 11)]))
    shown = checked(
        folder,
        capsys,
        simulator=resting,
        observation={**OBSERVED, "columns": [1, 2], "sd": 3},
        discrepancy=measure,
        noise={"sd": "column", "length": 50, "unit": "um"},
    )
    assert "largest displacement: " in shown
    assert "next finer mesh: " in shown


@pytest.mark.parametrize(
    ("simulator", "observation", "words", "warns"),
    [
        (resting, OBSERVED, "0 µm, 0 σ_N", False),
        (rough, OBSERVED, "0.4 µm, 0.133 σ_N (σ_N = 3 µm)", True),
        (rough, {"synthetic": TRUTH}, "0.4 µm, 0.133 σ_N (σ_N = 3 µm)", False),
    ],
    ids=["fine enough", "too coarse", "made on the same mesh"],
)
def test_the_next_finer_mesh(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    points: np.ndarray,
    simulator: Any,
    observation: dict[str, Any],
    words: str,
    warns: bool,
) -> None:
    shown = checked(observe(tmp_path / "s", points), capsys, simulator=simulator, observation=observation)
    assert f"next finer mesh: the interface differs by at most {words}" in shown
    assert ("the mesh is too coarse for this noise" in shown) == warns


def test_a_finer_mesh_that_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = checked(tmp_path / "s", capsys, simulator=strict)
    assert "on the next finer mesh this run fails (limit_point)" in shown


def test_the_range_of_the_log_likelihood(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], without_report: None
) -> None:
    small = {"design": {"sobol": {"runs": 16}}, "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2}}}
    folder = write_study(tmp_path / "s", **small)
    assert "over the box" not in checked(folder, capsys, **small)
    found = run_study(load_study(folder), executor=InProcess())
    (values,) = found.calibration.log_likelihoods.values()
    shown = checked(folder, capsys, **small)
    low, high = f"from {values.min():.4g} to {values.max():.4g}", f"median {np.median(values):.4g}"
    assert f"log-likelihood over the box: {low}, {high}, by 16 known runs" in shown


@pytest.mark.parametrize(
    "changes",
    [{}, {"observation": OBSERVED}, {**TWO_LOADS_STUDY, "simulator": two_loads}],
    ids=["synthetic", "file", "two"],
)
def test_the_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, changes: dict[str, Any]
) -> None:
    folder = observe(tmp_path / "s", points)
    shown = checked(folder, capsys, "--plot", **changes)
    assert f"wrote {folder / 'check.png'}\n" in shown
    assert (folder / "check.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in folder.iterdir()) == ["check.png", "observed.csv", "study.yaml"]


def test_the_picture_shows_what_there_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], points: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    from strandline.report import plots

    drawn: list[Any] = []
    monkeypatch.setattr(plots, "plot_interfaces", lambda *a, **k: drawn.append((a, k)) or _axes())
    folder = observe(tmp_path / "s", points)
    checked(folder, capsys, "--plot", observation=OBSERVED, simulator=resting)
    (((seen,), options),) = drawn
    np.testing.assert_array_equal(seen.points, points)
    np.testing.assert_array_equal(options["reference"].points, resting.undeformed().points)
    np.testing.assert_array_equal(next(iter(options["simulated"].values())).points, points)


def _axes() -> Any:
    from matplotlib.figure import Figure

    return Figure().subplots()


@pytest.mark.parametrize(("seconds", "warns"), [(31.0, True), (29.0, False)])
def test_a_batch_that_takes_long_to_choose(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    points: np.ndarray,
    seconds: float,
    warns: bool,
) -> None:
    monkeypatch.setattr("strandline.studies.first_run.seconds_of_a_batch", lambda *_: seconds)
    folder = observe(tmp_path / "s", points)
    active = {"design": {"active": {"runs": 60}}, "surrogate": {"field": {}}}
    shown = checked(folder, capsys, observation=OBSERVED, discrepancy=CLOSEST, **active)
    expected = "choosing a batch takes about 31 s, to compare interfaces with 17 observed points; to shorten it, keep"
    assert (expected in shown) == warns
    assert ("one in 2 of them" in shown) == warns


def test_only_an_active_design_chooses_batches(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, points: np.ndarray
) -> None:
    monkeypatch.setattr("strandline.studies.first_run.seconds_of_a_batch", lambda *_: 1e6)
    shown = checked(observe(tmp_path / "s", points), capsys, observation=OBSERVED, discrepancy=CLOSEST)
    assert "choosing a batch" not in shown
