"""Studies with an active design: results, resume, another analysis of the same runs, bad input."""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.calibration import Observer
from strandline.cli import main
from strandline.errors import InvalidStudy
from strandline.posterior import read
from strandline.runs import InProcess, Ledger, Progress, RunRecord
from strandline.studies import Outcome, load_study, run_study
from strandline.studies.progress import progress_of
from strandline.testing.studies import TWO_LOADS_STUDY, two_loads, write_study

ACTIVE: dict[str, Any] = {
    **TWO_LOADS_STUDY,
    "design": {"active": {"runs": 50, "batch": 4, "check": 20}},
    "noise": {"sd": 0.05},
    "sampler": {"smc": {"particles": 400, "rejuvenation_steps": 5, "zeta": 0.5}},
}


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    """Draw fewer particles after each batch, and no figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.design.active.sampling.PARTICLES", {1: 1000})
        patch.setattr("strandline.calibration.method._sensitivity", lambda *arguments: None)
        patch.setattr("strandline.studies.run.write_report", lambda *a, folder, **o: folder / "report.html")
        yield


class Stopped(Exception):
    """The driver is stopped."""


def stopping_after(runs: int) -> Observer:
    made: list[RunRecord] = []

    def run(record: RunRecord, progress: Progress) -> None:
        made.append(record)
        if len(made) == runs:
            raise Stopped

    return Observer(run=run)


def run(folder: Path, observer: Observer | None = None) -> Outcome:
    return run_study(load_study(folder), executor=InProcess(), observer=observer)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_study(tmp_path_factory.mktemp("active") / "beam", **ACTIVE)


@pytest.fixture(scope="module")
def summary(folder: Path) -> dict[str, Any]:
    """Of a study that was stopped in its second batch."""
    with pytest.raises(Stopped):
        run(folder, stopping_after(9))
    state = progress_of(load_study(folder))
    assert (state.planned, state.ok) == (50, 9)
    with pytest.raises(InvalidStudy, match="the study is not finished"):
        load_study(folder).runs.require_finished()
    return run(folder).summary


def test_the_certificate_is_in_the_summary(summary: dict[str, Any]) -> None:
    found = summary["certificate"]
    assert found["converged"] is True, found["verdict"]
    assert found["verdict"] == "converged"
    assert [entry["kind"] for entry in found["batches"]][::3] == ["initial", "check"]
    assert sum(entry["runs"] for entry in found["batches"]) == found["runs"] == summary["runs"]["ok"] < 50
    check = found["check"]
    assert check["by"] == "runs at draws of the posterior"
    assert (check["passed"], check["draws"], check["failed"], check["reasons"]) == (True, 4, 0, [])
    assert check["left_out"] > 3
    assert 0.8 < check["effective"] <= 1.0
    assert set(check["shift"]) == set(check["shift_error"]) == set(check["sd_ratio"]) == {"E"}
    assert [step["runs"] for step in found["history"]] == list(np.cumsum([entry["runs"] for entry in found["batches"]]))
    moved = {"since", "change", "change_sd", "effective"}
    assert set(found["history"][0]) == {"runs", "ok", "kind", "mean", "sd", "error_um"} | moved
    assert found["history"][0]["effective"] is None
    assert 0.8 <= found["history"][-1]["effective"] <= 1.0
    assert found["error_um"] == found["history"][-1]["error_um"]
    assert found["feasible_mass"] == pytest.approx(1.0)


def test_the_surrogate_is_told(summary: dict[str, Any]) -> None:
    found = summary["surrogate"]
    assert (found["kind"], found["n_train"]) == ("field", summary["certificate"]["runs"])
    assert set(found["warps"]) == {"E"}
    assert found["common_points"] == "nodes"
    assert found["left_out_error_um"]["median"] <= found["left_out_error_um"]["q95"]
    assert abs(found["variance_effect"]["shift"]["E"]) < 0.05
    assert set(summary["comparison"]["inputs"]["E"]) == {"mean", "sd", "shift_sd", "sd_ratio"}
    json.dumps(summary)


def test_the_posterior_is_exact(summary: dict[str, Any]) -> None:
    E = np.linspace(300.0, 560.0, 2001)
    seen = two_loads({"E": 400.0, "load": 1e-5}, Path()).interfaces
    squares = np.array(
        [
            sum(
                np.sum((one.points - seen[name].points) ** 2)
                for name, one in two_loads({"E": float(e), "load": 1e-5}, Path()).interfaces.items()
            )
            for e in E
        ]
    )
    weights = np.exp(-0.5 * squares / 0.05**2)
    mean = weights @ E / weights.sum()
    sd = np.sqrt(weights @ (E - mean) ** 2 / weights.sum())
    found = summary["certificate"]["history"][-1]
    assert abs(found["mean"]["E"] - mean) < 0.2 * sd
    assert found["sd"]["E"] == pytest.approx(sd, rel=0.15)


def test_what_was_stopped_goes_on_to_the_same_bits(folder: Path, summary: dict[str, Any], tmp_path: Path) -> None:
    other = write_study(tmp_path / "at-once", **ACTIVE)
    straight = run(other).summary
    assert straight["runs"]["reused"] == 0
    assert summary["runs"]["new"] + summary["runs"]["reused"] == straight["runs"]["new"]
    assert straight["certificate"] == summary["certificate"]
    assert read(folder / "posterior.nc").identical(read(other / "posterior.nc"))


def test_a_finished_study_is_known_to_be_so(folder: Path, summary: dict[str, Any]) -> None:
    study = load_study(folder)
    study.runs.require_finished()
    state, number = progress_of(study), summary["certificate"]["runs"]
    assert (state.planned, state.ok, state.to_do, state.results) == (number, number, 0, "current")
    assert study.runs.known == number
    assert study.runs.given is None
    with Ledger.open(study.ledger_path, model=study.model, read_only=True) as ledger:
        assert {record.key for record in ledger} == set(study.runs.needed_keys)


def test_status_and_check_tell_the_most_that_may_be_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fresh = write_study(tmp_path / "beam", **ACTIVE)
    main(["status", str(fresh)])
    assert "0 of 50 runs" in capsys.readouterr().out
    main(["check", str(fresh)])
    assert "50" in capsys.readouterr().out


def test_another_noise_takes_the_runs_that_there_are(
    folder: Path, summary: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """New runs are those of the certificate, where left-out runs do not vouch for the posterior.

    The results can be made anew of them.
    """
    copy = tmp_path / "beam"
    shutil.copytree(folder, copy)
    write_study(copy, **{**ACTIVE, "noise": {"sd": 0.08}})
    again = run(copy).summary
    batches, number = again["certificate"]["batches"], summary["certificate"]["runs"]
    assert batches[0] == {"kind": "given", "runs": number}
    assert again["certificate"]["converged"]
    assert again["runs"]["new"] == sum(entry["runs"] for entry in batches[1:])
    if len(batches) == 1:
        assert again["certificate"]["check"]["by"] == "left-out runs"
    study = load_study(copy)
    study.runs.require_finished()
    assert len(study.runs.given or []) == number
    assert progress_of(study).to_do == 0
    assert again["certificate"]["history"][-1]["sd"]["E"] > 1.3 * summary["certificate"]["history"][-1]["sd"]["E"]
    made = read(copy / "posterior.nc")
    (copy / "posterior.nc").unlink()
    main(["report", str(copy), "--quiet"])
    capsys.readouterr()
    told = json.loads((copy / "summary.json").read_text())
    assert told["runs"]["new"] == 0
    assert told["certificate"] == again["certificate"]
    assert read(copy / "posterior.nc").identical(made)


@pytest.mark.long
def test_runs_of_a_study_that_is_reused_are_given(folder: Path, summary: dict[str, Any], tmp_path: Path) -> None:
    other = write_study(tmp_path / "beam", **{**ACTIVE, "noise": {"sd": 0.08}, "reuse": [str(folder)]})
    found = run(other).summary
    assert found["certificate"]["batches"][0] == {"kind": "given", "runs": summary["certificate"]["runs"]}
    assert found["runs"]["new"] == sum(entry["runs"] for entry in found["certificate"]["batches"][1:])


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "both designs": ({"design": {"sobol": {"runs": 24}, "active": {"runs": 50}}}, "either `sobol"),
    "no design": ({"design": {}}, "either `sobol"),
    "rounds too": ({"design": {"active": {"runs": 50}, "refine": {"runs": 5}}}, "an active design refines itself"),
    "another surrogate": ({"surrogate": {"log_likelihood": {}}}, "for an active design"),
    "two surrogates": ({"surrogate": {"log_likelihood": {}, "field": {}}}, "one of `log_likelihood`, `field`"),
    "unknown criterion": ({"design": {"active": {"runs": 50, "criterion": "entropy"}}}, "design.active.criterion"),
    "too few runs": ({"design": {"active": {"runs": 20}}}, "design.active.runs"),
    "a small check": ({"design": {"active": {"runs": 50, "check": 5}}}, "design.active.check"),
    "much exploration": ({"design": {"active": {"runs": 50, "explore": 0.9}}}, "design.active.explore"),
    "unknown option": ({"design": {"active": {"runs": 50, "rounds": 2}}}, "design.active.rounds"),
    "no number": ({"design": {"active": {"runs": "many"}}}, "design.active.runs"),
}


@pytest.mark.parametrize("case", list(BAD))
def test_bad_input_is_refused_before_any_run(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes, words = BAD[case]
    folder = write_study(tmp_path / "beam", **{**ACTIVE, **changes})
    before = (folder / "study.yaml").read_bytes()
    with pytest.raises(SystemExit) as ended:
        main(["run", str(folder)])
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert words in " ".join(told.err.split())
    assert [path.name for path in folder.iterdir()] == ["study.yaml"]
    assert (folder / "study.yaml").read_bytes() == before


def ended_runs(folder: Path) -> int:
    study = load_study(folder)
    if not study.ledger_path.is_file():
        return 0
    with Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
        return sum(1 for _ in ledger)


@pytest.mark.long
def test_a_killed_study_goes_on_to_the_same_posterior(tmp_path: Path) -> None:
    """The driver is killed with -9 among its first runs and in a later batch; one worker."""
    whole, killed = (write_study(tmp_path / name, **ACTIVE) for name in ("whole", "killed"))
    command = [sys.executable, "-m", "strandline", "run", "--quiet"]
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    for after in (3, 9):
        driver = subprocess.Popen([*command, str(killed)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while driver.poll() is None and ended_runs(killed) < after:
            time.sleep(0.02)
        assert driver.poll() is None
        driver.send_signal(signal.SIGKILL)
        driver.wait()
    subprocess.run([*command, str(killed)], check=True, capture_output=True)
    assert read(whole / "posterior.nc").identical(read(killed / "posterior.nc"))
    one, other = (json.loads((folder / "summary.json").read_text()) for folder in (whole, killed))
    assert one["certificate"] == other["certificate"]
