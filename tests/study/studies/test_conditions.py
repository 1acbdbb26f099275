"""Studies of several conditions, and of sensitivities: from files to results."""

import json

import numpy as np
import pytest
from tests.study.conftest import finish
from tests.unit.cli.command_line import printed, refused
from tests.unit.studies.test_refusals import BOTH

from strandline.foundations import InvalidStudy
from strandline.posterior import read
from strandline.runs import InProcess, Ledger
from strandline.studies import check_posterior, load_study, run_study
from strandline.studies.load.progress import progress_of
from strandline.testing.models import TwoLoads
from strandline.testing.studies import TWO_LOADS_STUDY, write_study

INPUTS = {"E": 400.0, "load": 1e-5}
OWN = {"sd": 30, "unit": "um", "conditions": {"light": {"sd": 10, "length": 15, "unit": "um"}}}
SMALL = {**TWO_LOADS_STUDY, "design": {"sobol": {"runs": 16}}, "discrepancy": {"closest_point": {}}, "noise": OWN}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A study that observes files, in µm, in another order than the model's."""
    folder = tmp_path_factory.mktemp("files") / "two"
    folder.mkdir()
    for name, interface in TwoLoads()(INPUTS, folder).interfaces.items():
        np.savetxt(folder / f"{name}.csv", interface.points * 1000, delimiter=",", fmt="%.17g")
    return finish(folder, **SMALL | {"observation": BOTH})


def test_all_results_tell_the_conditions(files, capsys):
    summary = json.loads((files.folder / "summary.json").read_text())
    estimate, likelihood = summary["inputs"]["E"], summary["likelihood"]
    assert abs(estimate["mean"] - 400.0) < estimate["sd"]
    heavy, light = likelihood["conditions"]
    assert (light["point_sd"], heavy["point_sd"], light["correlation_length"]) == pytest.approx((0.01, 0.03, 0.015))
    data = read(files.folder / "posterior.nc")["observed_data"].to_dataset()
    points = TwoLoads()(INPUTS, files.folder).interfaces["heavy"].points
    np.testing.assert_allclose(data["interface_heavy"], points, rtol=1e-12)
    assert "<tr><td>heavy</td><td>34</td>" in files.outcome.report.read_text()
    assert "observed conditions: heavy, light" in printed(capsys, "check", str(files.folder))


def test_sensitivities_are_added_to_known_runs(files, tmp_path):
    """Synthetic observations, and a check of the posterior, which makes runs without sensitivities."""
    plain = {"noise": {"sd": 30, "unit": "um"}, "draft": True, "report": "none"}
    content = {**SMALL, **plain, "sensitivities": True, "reuse": [str(files.folder)]}
    content["sampler"] = json.loads((files.folder / "study.yaml").read_text())["sampler"]
    study = load_study(write_study(tmp_path / "study", **content))
    assert (study.runs.known, progress_of(study).to_do) == (0, 16)
    with pytest.raises(InvalidStudy, match="0 of 17 forward runs done"):
        study.runs.require_finished()
    asked = run_study(study, executor=InProcess())
    assert (asked.summary["runs"]["new"], asked.summary["runs"]["reused"]) == (16, 0)
    assert (study.runs.known, progress_of(study).to_do) == (16, 0)
    for one, other in zip(files.outcome.calibration.records, asked.calibration.records, strict=True):
        assert one.key == other.key
        assert (list(one.sensitivities), list(other.sensitivities)) == ([], ["light", "heavy"])
    checked = check_posterior(load_study(study.folder), draws=30, executor=InProcess()).content
    assert [item["condition"] for item in checked["interfaces"]] == ["light", "heavy"]
    light, heavy = (max(item["offset"]["q95"]) for item in checked["interfaces"])
    assert heavy == pytest.approx(2.5 * light, rel=0.1)
    with Ledger.open(study.folder / "check.sqlite", model=None, read_only=True) as ledger:
        assert all(record.ok and not record.sensitivities for record in ledger)


def test_a_forward_run_writes_a_file_for_each_condition(tmp_path, capsys):
    """The files can be observed, and have the slopes that are asked for; what cannot be is refused before the run."""
    folder, exact = write_study(tmp_path / "study", **SMALL), TwoLoads(sensitivities=True)(INPUTS, tmp_path)
    run = ["forward", str(folder), "--set", "E=400", "--csv"]
    assert "light: 34 points\n  heavy: 34 points\n" in printed(capsys, *run, str(folder / "seen.csv"))
    seen = [{"condition": name, "file": f"seen-{name}.csv", "unit": "mm"} for name in TwoLoads.conditions]
    study = load_study(write_study(folder, **SMALL | {"observation": seen}))
    for name, interface in exact.interfaces.items():
        np.testing.assert_array_equal(study.observed[name].points, interface.points)
    run = [*run, str(tmp_path / "s.csv"), "--sensitivities"]
    found = json.loads(printed(capsys, *run, "--json"))
    for condition in TwoLoads.conditions:
        for name in INPUTS:
            slopes = found["sensitivities"][condition][name]
            np.testing.assert_array_equal(slopes, exact.sensitivities[condition][name])
        table = np.genfromtxt(tmp_path / f"s-{condition}.csv", delimiter=",", names=True)
        assert table.dtype.names == ("x", "y", "dx_dE", "dy_dE", "dx_dload", "dy_dload")
        np.testing.assert_array_equal(table["dy_dE"], exact.sensitivities[condition]["E"][:, 1])
    (tmp_path / "t-heavy.csv").mkdir()
    assert "t-heavy.csv is a folder" in refused(capsys, *run[:-2], str(tmp_path / "t.csv"))
    assert not (tmp_path / "t-light.csv").exists()
