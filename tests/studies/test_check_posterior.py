"""A study's posterior checked with the true model: runs, numbers, files, report, and the command."""

import dataclasses
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from strandline.calibration import Observer
from strandline.cli import main
from strandline.discrepancy import ClosestPoint
from strandline.errors import ForwardModelError, InvalidInput, InvalidStudy, TooFewRuns
from strandline.interface import Interface
from strandline.models.protocol import Simulation
from strandline.posterior import from_datatree, read
from strandline.runs import InProcess, Ledger
from strandline.studies import check_posterior, load_study, run_study
from strandline.testing.studies import TWO_LOADS_STUDY, undeclared_beam, write_study


@pytest.fixture
def folder(finished: Any, tmp_path: Path) -> Path:
    target = tmp_path / "beam"
    shutil.copytree(finished.folder, target)
    return target


def checked(folder: Path, *, draws: int = 200, **changes: Any) -> dict[str, Any]:
    """Return what check.json says after a check, some fields of the study replaced."""
    study = dataclasses.replace(load_study(folder), **changes)
    found = check_posterior(study, draws=draws, executor=InProcess())
    content: dict[str, Any] = json.loads((folder / "check.json").read_text("utf-8"))
    assert found.path == folder / "check.json"
    return content


def without_effort(content: dict[str, Any]) -> dict[str, Any]:
    runs = {key: value for key, value in content["runs"].items() if key not in ("new", "reused")}
    return {**content, "runs": runs, "seconds": None}


@dataclass(frozen=True)
class Changed:
    """The beam as a model whose behaviour has changed behind its fingerprint's back."""

    weaker: float = 1.0
    fails_above: float = np.inf
    extra_nodes: bool = False

    @property
    def fingerprint(self) -> str:
        return "test:beam-1"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        if inputs["E"] > self.fails_above:
            raise ForwardModelError("snapped", f"E = {inputs['E']:g} Pa is too much")
        result = undeclared_beam({**inputs, "E": inputs["E"] / self.weaker}, workdir)
        if self.extra_nodes and inputs["E"] > 400:
            return Simulation.of(Interface.polyline(result.interface.points[::2]), {})
        return result


def exact_moments() -> dict[str, tuple[float, float]]:
    """Mean and sd by a sum over a grid with the beam written out: no surrogate, no sampler."""
    E, tilt = (a.ravel() for a in np.meshgrid(np.linspace(300, 560, 201), np.linspace(0, 0.04, 201)))
    x = np.linspace(0, 1, 17)
    bent, truth = (20 / e * x**2 * (3 - x) for e in (E[:, None], 400.0))
    log_weights = -0.5 * np.sum((bent + tilt[:, None] * x - truth - 0.02 * x) ** 2, axis=1) / 0.003**2
    weights = np.exp(log_weights - logsumexp(log_weights))
    means = {name: weights @ values for name, values in (("E", E), ("tilt", tilt))}
    return {
        name: (means[name], float(np.sqrt(weights @ (values - means[name]) ** 2)))
        for name, values in (("E", E), ("tilt", tilt))
    }


def test_reweighted_moments_are_those_of_the_model(folder: Path) -> None:
    content = checked(folder, draws=400)
    assert content["verdict"] == "good"
    assert content["runs"]["failed"] == 0
    for name, (mean, sd) in exact_moments().items():
        found = content["inputs"][name]
        assert abs(found["reweighted_mean"] - mean) < 3 * sd / np.sqrt(content["ess"])
        assert abs(found["reweighted_sd"] / sd - 1) < 3 / np.sqrt(2 * content["ess"])
        assert found["shift"] == pytest.approx((found["reweighted_mean"] - found["mean"]) / found["sd"])
        assert found["sd_ratio"] == pytest.approx(found["reweighted_sd"] / found["sd"])


def test_log_likelihoods_are_those_of_model_and_surrogate(folder: Path) -> None:
    content = checked(folder, draws=50)
    posterior = from_datatree(read(folder / "posterior.nc"), load_study(folder).space)
    particles = content["particles"]
    np.testing.assert_array_equal(particles["surrogate"], posterior.log_likelihood[particles["number"]])
    x = np.linspace(0, 1, 17)
    for number, true in zip(particles["number"], particles["true"], strict=True):
        E, tilt = posterior.draws[number]
        apart = (20 / E - 20 / 400) * x**2 * (3 - x) + (tilt - 0.02) * x
        assert true == pytest.approx(-0.5 * np.sum(apart**2) / 0.003**2, rel=1e-9)
    difference = np.array(particles["true"]) - particles["surrogate"]
    assert content["log_likelihood"]["mean_difference"] == pytest.approx(difference.mean())
    assert content["log_likelihood"]["rms_difference"] == pytest.approx(difference.std())


def test_a_second_check_makes_no_run_and_finds_the_same(folder: Path) -> None:
    ledger = (folder / "ledger.sqlite").read_bytes()
    first = checked(folder, draws=60)
    second = checked(folder, draws=60)
    assert (first["runs"]["new"], first["runs"]["reused"]) == (60, 0)
    assert (second["runs"]["new"], second["runs"]["reused"]) == (0, 60)
    assert without_effort(first) == without_effort(second)
    assert (folder / "ledger.sqlite").read_bytes() == ledger
    more = checked(folder, draws=120)
    assert (more["runs"]["new"], more["runs"]["reused"]) == (60, 60)


def test_a_check_that_was_stopped_goes_on(folder: Path) -> None:
    def stop(record: Any, progress: Any) -> None:
        if progress.finished == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        check_posterior(load_study(folder), draws=40, executor=InProcess(), observer=Observer(run=stop))
    assert not (folder / "check.json").exists()
    content = checked(folder, draws=40)
    assert (content["runs"]["new"], content["runs"]["reused"]) == (33, 7)


def test_draws_that_fail_have_no_weight_and_are_told(folder: Path) -> None:
    content = checked(folder, draws=200, model=Changed(fails_above=420.0))
    posterior = from_datatree(read(folder / "posterior.nc"), load_study(folder).space)
    above = posterior.draws[content["particles"]["number"], 0] > 420
    assert 20 < above.sum() < 180
    assert content["runs"]["failed"] == above.sum()
    assert content["runs"]["by_kind"] == {"snapped": int(above.sum())}
    assert [value is None for value in content["particles"]["true"]] == above.tolist()
    assert [value is None for value in content["particles"]["log_weight"]] == above.tolist()
    weights = np.array([0.0 if v is None else np.exp(v) for v in content["particles"]["log_weight"]])
    assert weights.sum() == pytest.approx(1.0)
    assert content["ess"] == pytest.approx(1 / np.sum(weights**2))
    assert f"{above.sum()} of 200 draws failed in the true model" in content["remarks"][-1]
    page = (folder / "report.html").read_text("utf-8")
    assert f"({above.sum()} × snapped)" in page
    with Ledger.open(folder / "check.sqlite", model=None, read_only=True) as ledger:
        assert ledger.counts().failed == above.sum()


def test_a_wrong_surrogate_is_caught(folder: Path) -> None:
    content = checked(folder, model=Changed(weaker=1.5))
    assert content["verdict"] == "bad"
    assert content["k_hat"] is None or content["k_hat"] > 0.7
    assert content["remarks"][0].startswith("DO NOT TRUST THE SURROGATE")
    assert "Remedy: more runs near the posterior" in content["remarks"][1]
    assert content["remarks"][0] in (folder / "report.html").read_text("utf-8")


def test_nothing_is_made_of_draws_that_all_fail(folder: Path) -> None:
    with pytest.raises(TooFewRuns, match=r"failed at every draw of the posterior: got 0 of 20; e.g. snapped: E = "):
        checked(folder, draws=20, model=Changed(fails_above=0.0))
    assert not (folder / "check.json").exists()


def test_the_band_of_the_interfaces(folder: Path) -> None:
    """The clamped end does not move; at the tip the quantiles are those of the closed form."""
    content = checked(folder, draws=100)
    posterior = from_datatree(read(folder / "posterior.nc"), load_study(folder).space)
    (item,) = content["interfaces"]
    displacement, offset = item["displacement"], item["offset"]
    assert (item["points"], item["note"], displacement["from"]) == (17, None, "median")
    E, tilt = posterior.draws[content["particles"]["number"]].T
    tips = np.quantile(40 / E + tilt, [0.05, 0.5, 0.95])
    found = [displacement["reference"][-1][1] + displacement[key][-1][1] for key in ("q05", "q50", "q95")]
    np.testing.assert_allclose(found, tips)
    assert offset["q05"][0] == offset["q95"][0] == 0.0
    cosine = 1 / np.hypot(1, 60 / np.median(E) + np.median(tilt))  # of the slope at the tip
    np.testing.assert_allclose(offset["q95"][-1], (tips[2] - tips[1]) * cosine, rtol=0.02)
    assert abs(offset["observed"][-1]) < offset["q95"][-1]


def test_interfaces_of_other_nodes_have_no_band(folder: Path) -> None:
    content = checked(folder, model=Changed(extra_nodes=True), discrepancies={"closest_point": ClosestPoint()})
    (item,) = content["interfaces"]
    assert item["note"] == "no band: the interfaces of the draws have from 9 to 17 points"
    assert item["displacement"] is None
    assert item["note"] in (folder / "report.html").read_text("utf-8")


@pytest.mark.usefixtures("without_report")
def test_conditions_and_sensitivities(tmp_path: Path) -> None:
    smc = {"smc": {"particles": 300, "rejuvenation_steps": 3, "zeta": 0.5}}
    folder = write_study(tmp_path / "two", **{**TWO_LOADS_STUDY, "sensitivities": True, "sampler": smc})
    run_study(load_study(folder), executor=InProcess())
    content = checked(folder, draws=30)
    assert [item["condition"] for item in content["interfaces"]] == ["light", "heavy"]
    heavy, light = (max(item["offset"]["q95"]) for item in reversed(content["interfaces"]))
    assert heavy == pytest.approx(2.5 * light, rel=0.05)
    assert content["verdict"] != "bad"
    with Ledger.open(folder / "check.sqlite", model=None, read_only=True) as ledger:
        assert all(record.ok and not record.sensitivities for record in ledger)


class TestReport:
    def test_it_stands_in_the_report_and_a_repeated_run_keeps_it(self, folder: Path, finished: Any) -> None:
        before = (folder / "report.html").read_text("utf-8")
        assert "Checked with the true model" not in before
        content = checked(folder, draws=40)
        page = (folder / "report.html").read_text("utf-8")
        assert page.count("Checked with the true model") == 1
        assert f"{content['inputs']['E']['reweighted_mean']:.4g}" in page
        begin, end = "<!-- check of the posterior -->", "<!-- end of the check -->"
        assert page.partition(begin)[0] == before.partition(begin)[0]
        assert page.partition(end)[2] == before.partition(end)[2]
        checked(folder, draws=40)
        assert (folder / "report.html").read_text("utf-8").count("Checked with the true model") == 1

        old = read(folder / "posterior.nc")
        outcome = run_study(load_study(folder), executor=InProcess())
        assert (outcome.summary["runs"]["new"], outcome.summary["surrogate"]["n_train"]) == (0, 64)
        assert old.identical(read(folder / "posterior.nc"))
        assert (folder / "report.html").read_text("utf-8").count("Checked with the true model") == 1
        assert (folder / "figures" / "check.png").is_file()

    @pytest.mark.parametrize("content", [{"posterior_sha256": "of another posterior"}, {}, [], None])
    def test_a_check_of_another_posterior_is_left_out(self, folder: Path, finished: Any, content: Any) -> None:
        from strandline.studies.check_file import read_check

        text = "not JSON" if content is None else json.dumps(content)
        (folder / "check.json").write_text(text)
        assert read_check(folder, finished.outcome.calibration.posterior) is None

    def test_a_folder_without_a_report_gets_none(self, folder: Path) -> None:
        (folder / "report.html").unlink()
        shutil.rmtree(folder / "figures")
        checked(folder, draws=20)
        assert sorted(path.name for path in (folder / "figures").iterdir()) == ["check.pdf", "check.png"]
        assert not (folder / "report.html").exists()


class TestCommand:
    def test_it_prints_what_it_writes(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["posterior", "check", str(folder), "--draws", "30", "--workers", "1"])
        shown = capsys.readouterr()
        content = json.loads((folder / "check.json").read_text("utf-8"))
        assert "beam: 30 draws of the posterior, 30 ok, 0 failed (30 new runs, 0 reused)" in shown.out
        assert f"Pareto k {content['k_hat']:.2f}: {content['verdict']}" in shown.out
        for name, item in content["inputs"].items():
            row = next(line for line in shown.out.splitlines() if line.split()[:1] == [name])
            assert f"{item['reweighted_mean']:.4g}" in row
            assert f"{item['shift']:+.2f} ± {item['shift_error']:.2f}" in row
        assert content["remarks"][0] in shown.out
        assert shown.err.splitlines() == ["runs at draws …", "  30/30 30 ok, 0 failed", "figures and report …"]
        main(["posterior", "check", str(folder), "--draws", "30", "--quiet"])
        again = capsys.readouterr()
        assert again.err == ""
        assert "(0 new runs, 30 reused)" in again.out
        repeated = json.loads((folder / "check.json").read_text("utf-8"))
        assert without_effort(repeated) == without_effort(content)

    def test_status_is_that_of_the_design(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        main(["status", str(folder)])
        before = capsys.readouterr().out
        checked(folder, draws=20, model=Changed(fails_above=400.0))
        main(["status", str(folder)])
        assert capsys.readouterr().out == before


REFUSED: list[tuple[str, Any, type[Exception], str]] = [
    ("draws", 4001, InvalidInput, "draws of the check: got 4001; expected from 20 to 4000"),
    ("draws", 19, InvalidInput, "got 19; expected from 20"),
    ("summary.json", None, InvalidStudy, "no posterior to check: got a study that is not finished"),
    ("posterior.nc", None, InvalidStudy, "no posterior to check: got a study that is not finished"),
    ("ledger.sqlite", None, InvalidStudy, "0 of 65 forward runs done"),
    ("posterior.nc", b"no netCDF", InvalidStudy, "posterior.nc cannot be read"),
    ("study.yaml", "seed: 2", InvalidStudy, "got results of an earlier study.yaml; expected posterior.nc"),
]


@pytest.mark.parametrize(("what", "value", "kind", "words"), REFUSED)
def test_what_is_refused(
    what: str, value: Any, kind: type[Exception], words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each ends the command with code 2 and one line, and leaves no trace."""
    options = []
    if what == "draws":
        options = ["--draws", str(value)]
    elif value is None:
        (folder / what).unlink()
    elif what == "study.yaml":
        write_study(folder, seed=2)
    else:
        (folder / what).write_bytes(value)
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(SystemExit) as ended:
        main(["posterior", "check", str(folder), *options])
    shown = capsys.readouterr()
    assert ended.value.code == 2
    assert shown.out == ""
    (line,) = shown.err.splitlines()
    assert words in line
    assert [name for name in sorted(path.name for path in folder.iterdir()) if "-shm" not in name] == before
    with pytest.raises(kind):
        check_posterior(load_study(folder), draws=value if what == "draws" else 200)
