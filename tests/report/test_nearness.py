"""Whether any run comes near the observation: planted misfits, and sound studies that must not be suspected."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Problem
from strandline.cli import main
from strandline.discrepancy import DISCREPANCIES, Discrepancy
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import Simulation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.report.nearness import Nearest, as_json, nearest_runs, nothing_near
from strandline.runs import RunRecord
from strandline.runs.overview import Overview
from strandline.studies.run import TELLING_RUNS
from strandline.testing.studies import beam, write_study

X = np.linspace(0.0, 1.0, 33)
SPACE = ParameterSpace((Parameter("h", Uniform(0.1, 0.3)),))
MEASURES = [
    ("tracked_points", {}, 1e-6),
    ("measurement_lines", {"lines": 10}, 1e-6),
    ("closest_point", {}, 1e-6),
    ("closest_point", {"direction": "symmetric"}, 1e-6),
    ("closest_point", {"direction": "to_simulated", "weighting": "length"}, 1e-6),
    ("currents", {"width": 0.02}, 1e-5),
]


def arch(height: float) -> Interface:
    return Interface.polyline(np.stack([X, height * np.sin(np.pi * X)], axis=1))


def moved(interface: Interface, scale: float = 1.0, shift: tuple[float, float] = (0.0, 0.0)) -> Interface:
    return Interface.polyline(scale * interface.points + np.array(shift))


def found(
    observed: Interface, heights: np.ndarray, measure: Discrepancy, variance: float, scale: float = 1.0
) -> Nearest:
    """Return what is said of arches of these heights, `scale` times too large, beside the observed one."""
    records = [
        RunRecord(str(k), {"h": float(h), "fixed": 1.0}, "ok", {"": moved(arch(h), scale)})
        for k, h in enumerate(heights)
    ]
    observations = (Observation(observed, variance),)
    likelihood = InterfaceLikelihood(observations, measure)
    values = np.array([likelihood(record.interfaces) for record in records])
    problem = Problem(lambda *_: Simulation.of(arch(0.1)), SPACE, {}, observations, {"m": measure})
    (nearest,) = nearest_runs(problem, records, values)
    return nearest


@pytest.mark.parametrize(("name", "options", "variance"), MEASURES)
class TestEveryMeasure:
    heights = np.linspace(0.1, 0.3, 21)

    def test_a_sound_study(self, name: str, options: dict[str, Any], variance: float) -> None:
        nearest = found(arch(0.2234), self.heights, DISCREPANCIES[name](**options), variance)
        assert nearest.near
        assert nothing_near([nearest]) is None
        assert nearest.extent_ratio == pytest.approx(1.0)

    def test_few_runs_and_little_noise(self, name: str, options: dict[str, Any], variance: float) -> None:
        """The best of six runs is many noise units off, yet the observation lies between two of them."""
        nearest = found(arch(0.2234), self.heights[::4], DISCREPANCIES[name](**options), 1e-4 * variance)
        assert nearest.residual > 5.0
        assert nearest.near

    def test_a_simulator_in_micrometres(self, name: str, options: dict[str, Any], variance: float) -> None:
        nearest = found(arch(0.2), self.heights, DISCREPANCIES[name](**options), variance, scale=1e3)
        assert not nearest.near
        assert "has 0.001 times the extent of the run's: perhaps" in nearest.message

    def test_an_observation_500_mm_away(self, name: str, options: dict[str, Any], variance: float) -> None:
        nearest = found(moved(arch(0.2), shift=(500.0, 0.0)), self.heights, DISCREPANCIES[name](**options), variance)
        assert not nearest.near
        assert "NOTHING IN THE BOX COMES NEAR the observation: the best run (h = " in nearest.message
        assert "Their centres lie 500 mm apart" in nearest.message

    def test_a_truth_outside_the_box(self, name: str, options: dict[str, Any], variance: float) -> None:
        nearest = found(arch(0.6), self.heights, DISCREPANCIES[name](**options), variance)
        assert not nearest.near
        assert nearest.inputs["h"] == 0.3
        assert "wrong" in nearest.message


def test_a_norm_that_no_longer_grows_does_not_hide_the_distance() -> None:
    """With so much noise d² never exceeds 25 σ_N², however far the observation."""
    measure = DISCREPANCIES["currents"](width=0.02)
    nearest = found(moved(arch(0.2), shift=(500.0, 0.0)), np.linspace(0.1, 0.3, 21), measure, 0.02)
    assert nearest.residual < 5.0
    assert not nearest.near


def test_as_json_names_the_run() -> None:
    nearest = found(arch(0.2), np.linspace(0.1, 0.3, 21), DISCREPANCIES["tracked_points"](), 1e-6)
    content = json.loads(json.dumps(as_json([nearest])))
    assert (content["near"], content["message"]) == (True, None)
    assert content["observations"][0]["run"] == "10"
    assert content["observations"][0]["residual"] == pytest.approx(0.0, abs=1e-9)


class InMicrometres:
    """The beam, with its result in µm."""

    fingerprint = "test:beam-in-um"
    inputs = beam.inputs

    def __call__(self, inputs: Any, workdir: Path) -> Simulation:
        return Simulation.of(moved(beam(inputs, workdir).interface, 1e3))


in_micrometres = InMicrometres()
SMALL = {"design": {"sobol": {"runs": 24}}, "sampler": {"smc": {"particles": 300, "rejuvenation_steps": 2}}}
BY_FIELD = {"surrogate": {"field": {}}}


def in_um(folder: Path) -> dict[str, Any]:
    return {"model": {"python": {"function": f"{__name__}:in_micrometres"}}}


def elsewhere(folder: Path) -> dict[str, Any]:
    points = np.loadtxt(folder / "observed.csv", delimiter=",") + np.array([500.0, 0.0])
    np.savetxt(folder / "observed.csv", points, delimiter=",")
    return {}


UNITS, PLACE = "µm and mm differ by a factor of 1000", "Their centres lie 500 mm apart"


@pytest.mark.parametrize(
    ("plant", "words", "changes"),
    [
        pytest.param(None, None, {}, id="sound, log-likelihood", marks=pytest.mark.long),
        pytest.param(None, None, BY_FIELD, id="sound, field"),
        pytest.param(in_um, UNITS, {}, id="micrometres, log-likelihood", marks=pytest.mark.long),
        pytest.param(in_um, UNITS, BY_FIELD, id="micrometres, field", marks=pytest.mark.long),
        pytest.param(elsewhere, PLACE, {}, id="elsewhere, log-likelihood", marks=pytest.mark.long),
        pytest.param(elsewhere, PLACE, BY_FIELD, id="elsewhere, field"),
    ],
)
def test_planted_in_a_study(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    plant: Callable[[Path], dict[str, Any]] | None,
    words: str | None,
    changes: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("strandline.studies.run.TELLING_RUNS", 10**6)  # as where all runs are known already
    observed = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, tmp_path).interface
    np.savetxt(tmp_path / "observed.csv", observed.points, delimiter=",")
    planted = {} if plant is None else plant(tmp_path)
    observation = {"file": "observed.csv", "unit": "mm"}
    arguments = ["run", str(write_study(tmp_path, observation=observation, **SMALL, **changes, **planted)), "--quiet"]
    main(arguments)
    last = capsys.readouterr().out.splitlines()[-1]
    summary = json.loads((tmp_path / "summary.json").read_text("utf-8"))["nearest"]
    page = (tmp_path / "report.html").read_text("utf-8")
    text = page[page.index("</h1>") + 5 :].lstrip()
    assert summary["near"] == (words is None)
    if words is None:
        assert last.startswith("report: ")
        assert "COMES NEAR" not in page
    else:
        assert last.startswith("NOTHING IN THE BOX COMES NEAR")
        assert words in last
        assert summary["message"] == last
        assert text.startswith('<p class="warnings"><strong>NOTHING IN THE BOX COMES NEAR')


def test_a_study_whose_first_runs_have_another_size_ends_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    observed = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, tmp_path).interface
    np.savetxt(tmp_path / "observed.csv", observed.points, delimiter=",")
    observation = {"file": "observed.csv", "unit": "mm"}
    folder = write_study(tmp_path, observation=observation, **SMALL, **in_um(tmp_path))
    with pytest.raises(SystemExit) as ended:
        main(["run", str(folder), "--quiet"])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "size of the observation" in line
    assert UNITS in line
    assert not (folder / "summary.json").exists()
    with Overview(folder / "ledger.sqlite") as ledger:
        assert TELLING_RUNS <= len(ledger.runs()) < SMALL["design"]["sobol"]["runs"]


@pytest.mark.parametrize("measure", [pytest.param("closest_point", marks=pytest.mark.long), "currents"])
def test_a_reversed_contour_gives_the_same_posterior(
    tmp_path: Path, measure: str, without_report: None, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a model without an undeformed state: the runs say from which end it is run through."""
    points = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, tmp_path).interface.points
    options = {"closest_point": {}, "currents": {"width": 0.05}}[measure]
    found = {}
    for name, some in {"as simulated": points, "reversed": points[::-1]}.items():
        (tmp_path / name).mkdir()
        np.savetxt(tmp_path / name / "observed.csv", some, delimiter=",")
        observation = {"file": "observed.csv", "unit": "mm"}
        folder = write_study(tmp_path / name, observation=observation, discrepancy={measure: options}, **SMALL)
        main(["run", str(folder), "--quiet"])
        found[name] = json.loads((folder / "summary.json").read_text("utf-8"))
    capsys.readouterr()
    for name, summary in found.items():
        assert summary["set_aside"] == []
        assert any("were turned round" in line for line in summary["warnings"]) == (name == "reversed")
    for symbol, values in found["as simulated"]["inputs"].items():
        same = found["reversed"]["inputs"][symbol]
        assert (same["mean"], same["sd"]) == pytest.approx((values["mean"], values["sd"]), rel=1e-6)
