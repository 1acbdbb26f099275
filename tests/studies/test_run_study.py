"""From a study folder to its results."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from scipy.special import logsumexp

import strandline.report.page
from strandline import __version__
from strandline.calibration import Observer
from strandline.errors import InvalidInput, InvalidStudy, LedgerError, ResultsNotWritten, TooFewRuns
from strandline.posterior import read
from strandline.report.captioned import Captioned
from strandline.runs import InProcess, Ledger
from strandline.studies import Outcome, load_study, run_study
from strandline.studies.run import submit_study
from strandline.testing.studies import BEAM_STUDY, beam, write_study

KEYS = {
    "study": str,
    "version": str,
    "seed": int,
    "log_evidence": float,
    "runs": {"ok": int, "failed": int, "by_kind": dict},
    "surrogate": {"n_train": int, "loo_rms": float, "loo_rms_near_mode": float, "hyperparameters": dict},
    "sampler": {"tempering_steps": int, "likelihood_evaluations": int, "ess": float},
    "quadrature_check": {"max_mean_error_sd": float, "max_sd_ratio_error": float},
    "seconds": {"forward": float, "surrogate": float, "sampling": float, "report": float},
}
"""What programs may count on in summary.json."""
RESULTS = ["figures", "ledger.lock", "ledger.sqlite", "posterior.nc", "report.html", "study.yaml", "summary.json"]


def rerun(folder: Path, **changes: Any) -> Outcome:
    if changes:
        write_study(folder, **changes)
    return run_study(load_study(folder), executor=InProcess())


def same_content(one: xr.DataTree, other: xr.DataTree) -> bool:
    return one.identical(other)


def contents(folder: Path) -> dict[str, bytes]:
    """Names and bytes of the files, but for those that SQLite lays beside a ledger in order to read it."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(("-wal", "-shm"))]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def require_keys(found: dict[str, Any], wanted: dict[str, Any]) -> None:
    for key, kind in wanted.items():
        assert key in found
        if isinstance(kind, dict):
            require_keys(found[key], kind)
        else:
            assert isinstance(found[key], kind), f"{key}: {found[key]!r}"


def test_summary_has_what_programs_count_on(finished: Any) -> None:
    summary = json.loads((finished.folder / "summary.json").read_text())
    require_keys(summary, KEYS)
    assert (summary["study"], summary["version"], summary["seed"]) == ("beam", __version__, 1)
    assert summary["runs"] == {"ok": 64, "failed": 0, "by_kind": {}, "new": 64, "reused": 0}
    assert summary["surrogate"]["n_train"] == 64
    for name, unit in (("E", "Pa"), ("tilt", "1")):
        item = summary["inputs"][name]
        require_keys(item, dict.fromkeys(("mean", "sd", "median", "q05", "q95", "map"), float))
        assert item["unit"] == unit
        assert item["q05"] < item["median"] < item["q95"]
        require_keys(summary["quadrature_check"][name], {"mean": float, "sd": float})
    assert summary == json.loads(json.dumps(finished.outcome.summary))


def test_summary_and_posterior_tell_the_same(finished: Any) -> None:
    particles = read(finished.folder / "posterior.nc")["weighted_posterior"]
    weights = particles["weight"].to_numpy()
    for name, item in finished.outcome.summary["inputs"].items():
        values = particles[name].to_numpy()
        mean = weights @ values
        assert item["mean"] == pytest.approx(mean)
        assert item["sd"] == pytest.approx(np.sqrt(weights @ (values - mean) ** 2))
        best = np.argmax((particles["log_likelihood"] + particles["log_prior"]).to_numpy())
        assert item["map"] == values[best]
    assert finished.outcome.summary["log_evidence"] == particles.attrs["log_evidence"]


def test_sensitivities_of_each_input_are_told(finished: Any) -> None:
    found = finished.outcome.summary["sensitivity"]
    assert found["of"] == "log-likelihood"
    assert list(found["inputs"]) == ["E", "tilt"]
    for item in found["inputs"].values():
        assert set(item) == {"first", "first_low", "first_high", "total", "total_low", "total_high"}
        assert item["first_low"] < item["first"] < item["first_high"]
        assert item["total_low"] < item["total"] < item["total_high"]
        assert item["total"] > item["first"] - 0.02
    assert sum(item["first"] for item in found["inputs"].values()) < 1.05


def test_the_posterior_is_that_of_the_model_itself(finished: Any) -> None:
    """Against a sum over a grid with the model itself: no surrogate, no sampler, σ_N² written out."""
    E, tilt = (a.ravel() for a in np.meshgrid(np.linspace(300, 560, 201), np.linspace(0, 0.04, 201)))
    x = np.linspace(0, 1, 17)
    bent, truth = (1e-5 / e * 2e6 * x**2 * (3 - x) for e in (E[:, None], 400.0))
    d2 = np.sum((bent + tilt[:, None] * x - truth - 0.02 * x) ** 2, axis=1)
    log_weights = -0.5 * d2 / 0.003**2
    weights = np.exp(log_weights - logsumexp(log_weights))
    for name, values in (("E", E), ("tilt", tilt)):
        mean = weights @ values
        sd = np.sqrt(weights @ (values - mean) ** 2)
        found = finished.outcome.summary["inputs"][name]
        assert abs(found["mean"] - mean) < 0.2 * sd
        assert abs(found["sd"] / sd - 1) < 0.1
    evidence = logsumexp(log_weights) - np.log(len(E))
    assert finished.outcome.summary["log_evidence"] == pytest.approx(evidence, abs=0.25)


def test_a_good_calibration_has_no_warnings(finished: Any) -> None:
    assert finished.outcome.summary["warnings"] == []


def test_nothing_is_left_lying_about(finished: Any) -> None:
    assert sorted(path.name for path in finished.folder.iterdir()) == RESULTS


@pytest.mark.usefixtures("without_report")
def test_a_rerun_repeats_no_run_and_gives_the_same_posterior(finished: Any, tmp_path: Path) -> None:
    folder = tmp_path / "beam"
    shutil.copytree(finished.folder, folder)
    before = read(folder / "posterior.nc")
    (folder / "posterior.nc").unlink()
    outcome = rerun(folder)
    assert (outcome.summary["runs"]["new"], outcome.summary["runs"]["reused"]) == (0, 64)
    assert same_content(before, read(folder / "posterior.nc"))
    other = before.copy(deep=True)
    other["weighted_posterior"]["E"].to_numpy()[0] += 1e-12
    assert not same_content(before, other)


@pytest.mark.usefixtures("without_report")
def test_a_larger_design_and_another_prior_reuse_the_runs_of_another_folder(finished: Any, tmp_path: Path) -> None:
    inputs = {**BEAM_STUDY["inputs"], "E": {"prior": {"lognormal": [6.0, 0.1]}, "box": [300, 560], "unit": "Pa"}}
    outcome = rerun(
        tmp_path / "informed",
        inputs=inputs,
        design={"sobol": {"runs": 70}},
        noise={"sd": 0.004},
        discrepancy=[{"closest_point": {}}, {"currents": {"width": 0.05}}],
        reuse=[str(finished.folder)],
    )
    runs = outcome.summary["runs"]
    assert (runs["ok"], runs["new"], runs["reused"]) == (70, 6, 64)
    assert list(outcome.summary["measures"]) == ["closest_point", "currents"]
    assert outcome.summary["inputs"]["E"]["prior_mass_cut"] > 0
    with Ledger.open(tmp_path / "informed" / "ledger.sqlite", model="test:beam-1", read_only=True) as ledger:
        origins = [record.origin for record in ledger]
    assert sum(origin is None for origin in origins) == 6
    assert len(origins) == 71  # the design and the synthetic observation


def test_every_run_failed(tmp_path: Path) -> None:
    """The truth is fine, but nothing of the design is."""
    folder = write_study(tmp_path, fixed={"load": 1.0}, design={"sobol": {"runs": 8}})
    with pytest.raises(TooFewRuns, match=r"every forward run failed: got 0 of 8 \(8 × large_deflection") as caught:
        rerun(folder)
    assert "at least 4" in caught.value.expected
    assert sorted(path.name for path in folder.iterdir()) == ["ledger.lock", "ledger.sqlite", "study.yaml"]


def test_too_few_runs_succeeded(tmp_path: Path) -> None:
    inputs = {**BEAM_STUDY["inputs"], "E": {"prior": {"uniform": [1, 100]}, "unit": "Pa"}}
    folder = write_study(tmp_path, inputs=inputs, design={"sobol": {"runs": 4}})
    with pytest.raises(TooFewRuns, match=r"too few successful forward runs: got 2 of 4 \(2 × large_deflection"):
        rerun(folder)


def test_a_synthetic_observation_that_fails(tmp_path: Path) -> None:
    folder = write_study(tmp_path, observation={"synthetic": {"E": 400, "tilt": 0, "load": 1}})
    with pytest.raises(InvalidStudy, match="synthetic observation could not be made: got large_deflection at E = 400"):
        rerun(folder)


def test_a_measure_that_cannot_be_used_costs_no_run_of_the_design(tmp_path: Path) -> None:
    folder = write_study(tmp_path, discrepancy={"measurement_lines": {"lines": [[5, 0, 0, 1]]}})
    with pytest.raises(InvalidInput, match="measurement line 0 misses the observed interface"):
        rerun(folder)
    with Ledger.open(folder / "ledger.sqlite", model="test:beam-1", read_only=True) as ledger:
        assert ledger.counts().total == 1


def test_a_ledger_of_another_model_is_left_as_it_is(tmp_path: Path) -> None:
    folder = write_study(tmp_path)
    Ledger.open(folder / "ledger.sqlite", model="something else").close()
    (folder / "ledger.lock").unlink(missing_ok=True)
    before = contents(folder)
    with pytest.raises(LedgerError, match="keeps the runs of another model: got something else in the ledger"):
        rerun(folder)
    assert contents(folder) == before


BROKEN = {
    "posterior.nc": ("strandline.studies.run.write", ImportError("No module named 'h5py'")),
    "report.html": ("strandline.report.page._replaced", OSError(28, "No space left on device", "/full/report.html")),
    "summary.json": ("strandline.studies.run.write_json", OSError(28, "No space left on device")),
    "figures (second)": ("strandline.report.page.draw_check", RuntimeError("no ink")),
    "figures": ("strandline.report.page._whole_folder", PermissionError(13, "Permission denied")),
}


def two_figures(*_: Any) -> dict[str, Iterator[Captioned]]:
    """Return two small figures; the second is drawn by what a test may break."""

    def drawn(name: str) -> Iterator[Captioned]:
        if name == "second":
            strandline.report.page.draw_check({})
        yield Captioned(name, "data", name, Figure())

    return {name: drawn(name) for name in ("first", "second")}


@pytest.mark.parametrize("name", BROKEN)
def test_a_result_that_cannot_be_written_leaves_the_others(
    finished: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """And no older one in its place: where the summary stands, what it does not name as missing belongs to it."""
    folder = tmp_path / "beam"
    shutil.copytree(finished.folder, folder)
    for old in ("posterior.nc", "report.html", "summary.json", "figures/second.png"):
        (folder / old).write_text("old")
    place, error = BROKEN[name]

    def broken(*args: Any, **options: Any) -> Any:
        raise error

    monkeypatch.setattr("strandline.report.page.draw_check", lambda check: None)
    monkeypatch.setattr("strandline.report.page.figure_groups", two_figures)
    monkeypatch.setattr(place, broken)
    monkeypatch.setattr("strandline.studies.run.summarise", lambda *a, **o: dict(finished.outcome.summary))
    monkeypatch.setattr("strandline.studies.run.calibrate", lambda *a, **o: finished.outcome.calibration)
    with pytest.raises(ResultsNotWritten, match="finished forward runs are kept") as raised:
        rerun(folder)
    assert list(raised.value.missing) == [name]
    assert f"{name}: " in str(raised.value)
    assert str(getattr(error, "strerror", None) or error) in str(raised.value)
    written = {"posterior.nc", "report.html", "summary.json"} - {name}
    assert {path for path in written if (folder / path).read_bytes() != b"old"} == written
    assert not (folder / name).exists()
    if name != "figures":
        figures = {path.stem for path in (folder / "figures").glob("*.png")}
        assert figures == ({"first"} if name == "figures (second)" else {"first", "second"})
    if name != "summary.json":
        summary = json.loads((folder / "summary.json").read_text())
        assert list(summary["missing"]) == [name]
        assert summary["warnings"][0].startswith(f"{name} could not be written: ")
    if name.startswith("figures") or name == "posterior.nc":
        assert f"{name} could not be written: " in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("broken", "told"),
    [
        ("h5netcdf.File", r"posterior\.nc could not be written at the end: got ImportError: no h5py; .* Install"),
        ("strandline.studies.results.template", r"report\.html could not be written at the end: got ImportError"),
    ],
)
def test_what_cannot_be_written_at_the_end_is_refused_before_the_first_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str, told: str
) -> None:
    def missing(*args: Any, **options: Any) -> None:
        raise ImportError("no h5py")

    monkeypatch.setattr(broken, missing)
    study = load_study(write_study(tmp_path))
    for begin in (run_study, submit_study):
        with pytest.raises(InvalidInput, match=told):
            begin(study, executor=InProcess())
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


def test_the_observer_hears_of_every_stage_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stages: list[str] = []
    runs: list[int] = []
    observer = Observer(stage=stages.append, run=lambda record, progress: runs.append(progress.finished))

    def stop(*args: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("strandline.calibration.learning.fit_log_likelihood", stop)
    study = load_study(write_study(tmp_path, design={"sobol": {"runs": 8}}))
    with pytest.raises(KeyboardInterrupt):
        run_study(study, executor=InProcess(), observer=observer)
    assert stages == ["observation", "forward", "surrogate"]
    assert runs == list(range(1, 9))


def test_other_inputs_are_other_runs(finished: Any) -> None:
    study = replace(finished.study, fixed={"load": 2e-5})
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert ledger.latest(study.runs.design_keys) == {}
        assert len(ledger.latest(finished.study.runs.design_keys)) == 64


def test_the_beam_is_its_closed_form() -> None:
    """y = F x² (3L - x) / (6 E I) + tilt x; with F = 1e-5 N/m, h = 0.1 mm: 20 x² (3 - x) / E in mm."""
    points = beam({"E": 400.0, "tilt": 0.02, "load": 1e-5}, Path()).interface.points
    x = points[:, 0]
    np.testing.assert_allclose(points[:, 1], 20 / 400 * x**2 * (3 - x) + 0.02 * x, rtol=1e-12)
