"""The benchmark of the quick commands asks them what it says, of a study that is as it says."""

import subprocess

import pytest
from verification.benchmarks import startup

from strandline.studies import load_study
from strandline.studies.progress import progress_in, progress_of, recorded_plan


def test_the_study_is_one_whose_runs_are_made(tmp_path):
    folder = startup.cantilever_study(tmp_path / "study", 16)
    assert recorded_plan(folder) is not None
    state = progress_in(folder)
    assert (state.planned, state.ok, state.to_do) == (16, 16, 0)
    assert state == progress_of(load_study(folder))
    startup.cantilever_study(folder, 16, make=False, seed=2)
    assert recorded_plan(folder) is None
    assert progress_in(folder).ok == 16


def test_the_median_is_of_the_calls_after_the_first_and_failures_are_not_timed(monkeypatch):
    assert startup.seconds(["pass"]) > 0
    with pytest.raises(subprocess.CalledProcessError):
        startup.seconds(["raise SystemExit(2)"])
    times = iter([9.0, 1.0, 5.0, 2.0])
    monkeypatch.setattr(startup, "seconds", lambda arguments: next(times))
    figure = startup.measured("a", "b", ["pass"], 3, aim=0.5)
    assert (figure.value, figure.unit) == (2.0, "s")
    assert figure.remark == "median of 3, 1 to 5; the first time 9 s; aim 0.5 s"
