"""The executor that study.yaml names: every option arrives, and what cannot be is one clear line."""

import sys
from pathlib import Path
from typing import Any

import pytest

from strandline.errors import InvalidStudy
from strandline.runs import InProcess, LocalProcesses
from strandline.runs.executors import EXECUTORS, with_workers
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.studies import load_study
from strandline.studies.keys.executor import ExecutorChoice
from strandline.testing.studies import write_study

JOBS = {"cores": 4, "memory": "8GB", "walltime": "01:00:00"}


def executor_of(folder: Path, executor: Any) -> Any:
    return load_study(write_study(folder, executor=executor)).executor


def refused(folder: Path, executor: Any) -> str:
    with pytest.raises(InvalidStudy) as caught:
        executor_of(folder, executor)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_every_executor_has_a_key() -> None:
    keys = {name for name, field in ExecutorChoice.model_fields.items() if not field.exclude}
    assert keys == set(EXECUTORS)


def test_every_option_arrives(tmp_path: Path) -> None:
    assert executor_of(tmp_path, None) == LocalProcesses()
    assert executor_of(tmp_path, {"in_process": {}}) == InProcess()
    assert executor_of(tmp_path, {"local": {"workers": 3, "timeout": 5}}) == LocalProcesses(3, 5.0)
    jobs = {**JOBS, "queue": "q", "account": "a", "interface": "lo", "extra": ["--x"], "prologue": ["y"]}
    options = {"cluster": "pbs", "minimum": 0, "maximum": 7, "timeout": 60}
    expected = DaskCluster(cluster="pbs", minimum=0, maximum=7, timeout=60.0, jobs=jobs)
    assert executor_of(tmp_path, {"dask": {**options, "jobs": jobs}}) == expected
    assert executor_of(tmp_path, {"dask": {"address": "tcp://h:1"}}) == DaskCluster(address="tcp://h:1")


def test_every_option_of_an_array_arrives(tmp_path: Path) -> None:
    options = {"walltime": "1-00", "partition": "p", "account": "a", "cpus": 2, "memory": "1G", "max_running": 3}
    found = executor_of(
        tmp_path, {"slurm_array": {**options, "timeout": 9, "max_jobs": 4, "extra": ["--x"], "poll": 1}}
    )
    command = (sys.executable, "-m", "strandline.studies.array_task", str(tmp_path))
    more: dict[str, Any] = {"timeout": 9.0, "max_jobs": 4, "extra": ("--x",), "poll": 1.0}
    assert found == SlurmArray(tmp_path / "slurm", command, **options, **more)
    assert found.options(10) == [
        "--array=0-9%3",
        "--no-requeue",
        "--signal=B:USR1@45",
        "--time=1-00",
        "--partition=p",
        "--account=a",
        "--cpus-per-task=2",
        "--mem=1G",
        "--x",
    ]


@pytest.mark.parametrize(
    ("executor", "said"),
    [
        ({"local": {}, "dask": {}}, "one of in_process, local, dask, slurm_array"),
        ({"slurm": {}}, "unknown key: got executor.slurm"),
        ({"in_process": {"workers": 2}}, "executor.in_process.workers"),
        ({"dask": {"jobs": {**JOBS, "project": "x"}}}, "executor.dask.jobs.project"),
        ({"dask": {"cluster": "slurm"}}, "Add cores"),
        ({"dask": {"cluster": "slurm", "jobs": {**JOBS, "walltime": 3600}}}, "executor.dask.jobs.walltime"),
        ({"dask": {"cluster": "slurm", "timeout": 3600, "jobs": JOBS}}, "at most 3540 s"),
        ({"slurm_array": {"timeout": 241, "walltime": "00:05:00"}}, "at most 240 s"),
        ({"slurm_array": {"walltime": "5"}}, "in quotes"),
        ({"slurm_array": {"cpu": 2}}, "Did you mean cpus?"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, executor: Any, said: str) -> None:
    assert said in refused(tmp_path, executor)


def test_another_number_of_workers(tmp_path: Path) -> None:
    assert with_workers(LocalProcesses(3, 5.0), 2) == LocalProcesses(2, 5.0)
    queued = DaskCluster(cluster="slurm", minimum=1, maximum=3, jobs=JOBS)
    assert with_workers(queued, 2) == DaskCluster(cluster="slurm", workers=2, jobs=JOBS)
    assert with_workers(InProcess(), 2) == InProcess()
    assert with_workers(queued, None) is queued
