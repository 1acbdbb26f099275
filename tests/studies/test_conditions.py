"""Studies of several conditions, and of sensitivities: loading, refusing, running."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.cli import main
from strandline.errors import InvalidStudy
from strandline.posterior import read
from strandline.runs import InProcess, Ledger
from strandline.studies import load_study, run_study
from strandline.studies.progress import progress_of
from strandline.testing.models import TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

INPUTS = {"E": 400.0, "load": 1e-5}
SMALL: dict[str, Any] = {
    **TWO_LOADS_STUDY,
    "design": {"sobol": {"runs": 16}},
    "sampler": {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}},
}
BOTH = [{"condition": name, "file": f"{name}.csv", "unit": "um"} for name in ("heavy", "light")]


def observed(folder: Path, observation: Any = BOTH, **changes: Any) -> Path:
    """Write a study whose observations are files, in µm."""
    write_study(folder, **SMALL | {"observation": observation} | changes)
    for name, interface in TwoLoads()(INPUTS, folder).interfaces.items():
        np.savetxt(folder / f"{name}.csv", interface.points * 1000, delimiter=",", fmt="%.17g")
    return folder


def test_files_are_read_by_condition(tmp_path: Path) -> None:
    study = load_study(observed(tmp_path))
    assert list(study.observed) == ["heavy", "light"]
    assert (study.truth, study.turned, study.sensitivities) == (None, (), False)
    for name, interface in TwoLoads()(INPUTS, tmp_path).interfaces.items():
        np.testing.assert_allclose(study.observed[name].points, interface.points, rtol=1e-12)
    assert list(load_study(observed(tmp_path, BOTH[:1])).observed) == ["heavy"]


def test_a_synthetic_observation_observes_every_condition(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, **SMALL))
    assert (study.observed, study.truth) == ({}, INPUTS)


@pytest.mark.parametrize(
    ("observation", "words"),
    [
        ([], ["observation: got []; expected at least one entry"]),
        ([{"file": "light.csv", "unit": "mm"}], ["observation.0.condition: got nothing", "Add it."]),
        ([{**BOTH[0], "condition": ""}], ["observation.0.condition", "a short name without slashes"]),
        ([{**BOTH[0], "condition": "a/b"}], ["observation.0.condition: got a/b"]),
        ([{"condition": "light", "file": "light.csv"}], ["observation.0", "`unit: mm`"]),
        ([{"condition": "light", "synthetic": INPUTS}], ["observation.0", "observes all of them"]),
        ([{**BOTH[0], "condtion": "light"}], ["unknown key: got observation.0.condtion", "Did you mean condition?"]),
        ([BOTH[0], BOTH[0]], ["observation", "each condition once"]),
        (
            [{**BOTH[0], "condition": "haevy"}],
            ["no such condition: got haevy; expected some of light, heavy", "mean heavy?"],
        ),
        ({"file": "light.csv", "unit": "um"}, ["the condition is not named", "Give a list"]),
        ({**BOTH[0]}, ["unknown key: got observation.condition"]),
    ],
)
def test_refused(tmp_path: Path, observation: Any, words: list[str]) -> None:
    with pytest.raises(InvalidStudy) as caught:
        load_study(observed(tmp_path, observation))
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_list_for_a_model_of_one_condition_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match="a single condition without a name: got heavy; expected one mapping"):
        load_study(write_study(tmp_path, observation=BOTH))


def test_sensitivities_are_asked_of_models_that_offer_them(tmp_path: Path) -> None:
    study = load_study(write_study(tmp_path, **SMALL, sensitivities=True))
    assert study.sensitivities
    assert study.runs.needed_keys == load_study(write_study(tmp_path, **SMALL)).runs.needed_keys
    with pytest.raises(InvalidStudy, match="sensitivities: got true, but this model offers none"):
        load_study(write_study(tmp_path, sensitivities=True))
    with pytest.raises(InvalidStudy, match="sensitivities: got yes please; expected true or false"):
        load_study(write_study(tmp_path, sensitivities="yes please"))
    model = {"python": {"function": "strandline.testing.studies:two_loads", "sensitivities": True}}
    with pytest.raises(InvalidStudy, match="Move the key to the top level"):
        load_study(write_study(tmp_path, **SMALL | {"model": model}))


def test_from_the_study_file_to_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two observed files give the posterior of a synthetic observation, and all results tell the conditions."""
    synthetic = run_study(load_study(write_study(tmp_path / "synthetic", **SMALL)), executor=InProcess())
    folder = observed(tmp_path / "files", list(reversed(BOTH)))
    main(["check", str(folder)])
    shown = capsys.readouterr().out
    assert "observed conditions: light, heavy" in shown
    assert "tracked_points: log-likelihood -" in shown
    outcome = run_study(load_study(folder), executor=InProcess())
    np.testing.assert_allclose(outcome.calibration.posterior.mean, synthetic.calibration.posterior.mean, rtol=1e-6)

    summary = json.loads((folder / "summary.json").read_text())["likelihood"]
    variance = pytest.approx(1e-4)
    expected = [{"condition": name, "noise_variance": variance, "points": 34} for name in ("light", "heavy")]
    assert summary["conditions"] == expected
    assert summary["independent_terms"] == 2 * 2 * 34
    data = read(folder / "posterior.nc")["observed_data"].to_dataset()
    heavy = TwoLoads()(INPUTS, tmp_path).interfaces["heavy"].points
    np.testing.assert_allclose(data["interface_heavy"], heavy, rtol=1e-12)
    page = outcome.report.read_text()
    assert "<tr><td>heavy</td><td>34</td><td>0.0001</td></tr>" in page
    assert "by condition." in page
    assert page.count('id="interfaces"') == 1


def test_sensitivities_are_added_to_known_runs(tmp_path: Path, without_report: None) -> None:
    folder = write_study(tmp_path / "study", **SMALL)
    plain = run_study(load_study(folder), executor=InProcess())
    write_study(folder, **SMALL, sensitivities=True)
    study = load_study(folder)
    assert (study.runs.known, progress_of(study).to_do) == (0, 16)
    with pytest.raises(InvalidStudy, match="0 of 17 forward runs done"):
        study.runs.require_finished()
    asked = run_study(study, executor=InProcess())
    assert (asked.summary["runs"]["new"], asked.summary["runs"]["reused"]) == (16, 0)
    assert (study.runs.known, progress_of(study).to_do) == (16, 0)
    study.runs.require_finished()
    for one, other in zip(plain.calibration.records, asked.calibration.records, strict=True):
        assert one.key == other.key
        assert (list(one.sensitivities), list(other.sensitivities)) == ([], ["light", "heavy"])
    np.testing.assert_array_equal(asked.calibration.posterior.draws, plain.calibration.posterior.draws)

    second = load_study(write_study(tmp_path / "second", **SMALL, sensitivities=True, reuse=["../study"]))
    assert run_study(second, executor=InProcess()).summary["runs"]["new"] == 0
    with Ledger.open(second.ledger_path, model=second.model, read_only=True) as ledger:
        assert all(record.sensitivities and record.origin for record in ledger)


class TestForward:
    def test_a_file_for_each_condition_that_can_be_observed(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        folder = write_study(tmp_path / "study", **SMALL)
        main(["forward", str(folder), "--set", "E=400", "--csv", str(folder / "seen.csv")])
        told = "tip_light 0.1, tip_heavy 0.25\n  light: 34 points\n  heavy: 34 points\n"
        wrote = "".join(f"wrote {folder / f'seen-{name}.csv'}\n" for name in TwoLoads.conditions)
        assert capsys.readouterr().out.endswith(told + wrote)
        files = [{"condition": name, "file": f"seen-{name}.csv", "unit": "mm"} for name in TwoLoads.conditions]
        study = load_study(write_study(folder, **SMALL | {"observation": files}))
        for name, interface in TwoLoads()(INPUTS, tmp_path).interfaces.items():
            np.testing.assert_array_equal(study.observed[name].points, interface.points)

    def test_sensitivities(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        folder, exact = write_study(tmp_path / "study", **SMALL), TwoLoads(sensitivities=True)(INPUTS, tmp_path)
        options = ["--set", "E=400", "--csv", str(tmp_path / "s.csv"), "--sensitivities"]
        main(["forward", str(folder), *options, "--json"])
        found = json.loads(capsys.readouterr().out)
        assert found["csv"] == {name: str(tmp_path / f"s-{name}.csv") for name in TwoLoads.conditions}
        for condition in TwoLoads.conditions:
            for name in INPUTS:
                np.testing.assert_array_equal(
                    found["sensitivities"][condition][name], exact.sensitivities[condition][name]
                )
            table = np.genfromtxt(tmp_path / f"s-{condition}.csv", delimiter=",", names=True)
            assert table.dtype.names == ("x", "y", "dx_dE", "dy_dE", "dx_dload", "dy_dload")
            np.testing.assert_array_equal(table["dy_dE"], exact.sensitivities[condition]["E"][:, 1])
        main(["forward", str(folder), *options])
        assert "  heavy: d/dE up to 0.000626755 mm per Pa\n" in capsys.readouterr().out

    def test_a_model_without_sensitivities(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit) as ended:
            main(["forward", str(write_study(tmp_path)), "--set", "E=400", "--set", "tilt=0", "--sensitivities"])
        assert ended.value.code == 2
        assert "this model offers none" in capsys.readouterr().err

    def test_the_second_file_is_tried_before_the_run(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (tmp_path / "s-heavy.csv").mkdir()
        with pytest.raises(SystemExit) as ended:
            main(["forward", str(write_study(tmp_path, **SMALL)), "--set", "E=400", "--csv", str(tmp_path / "s.csv")])
        assert ended.value.code == 2
        assert "s-heavy.csv, a folder" in capsys.readouterr().err
        assert not (tmp_path / "s-light.csv").exists()
