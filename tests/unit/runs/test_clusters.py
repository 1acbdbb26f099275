"""Executors for clusters, without a cluster: options, keys, what is submitted, and what comes back."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from strandline.foundations import InvalidInput, end_of
from strandline.runs import LocalProcesses, RunRecord
from strandline.runs.executors import slurm_batch, with_workers
from strandline.runs.executors.dask import DaskCluster, _listening, _shared_folder
from strandline.runs.executors.shared import walltime_seconds
from strandline.runs.executors.slurm_array import SlurmArray, _out_of_walltime, _without_result
from strandline.runs.executors.slurm_batch import ArrayBatch, known_batches, read_run
from strandline.testing.executors import requests_for, same_outcome
from strandline.testing.models import Cantilever

JOBS = {"cores": 1, "memory": "500MB", "walltime": "01:00:00"}
SLURM = {"cluster": "slurm", "jobs": JOBS}
BEAM = Cantilever()
REQUESTS = requests_for(BEAM)


def slurm_array(**options):
    return SlurmArray(Path("slurm"), ("run",), **options)


def test_a_walltime_is_read_as_slurm_writes_it():
    seconds = {"05:30": 330, "02:30:15": 9015, "1-12": 129600, "2-01:30": 178200, "0-00:00:07": 7, "00:05:00": 300}
    assert {text: walltime_seconds(text) for text in seconds} == seconds


SENSELESS = [
    (LocalProcesses, {"workers": 0}, "at least 1"),
    (LocalProcesses, {"timeout": 0.0}, "seconds above 0"),
    (LocalProcesses, {"timeout": 366 * 24 * 3600.0 + 1.0}, "a year"),
    (DaskCluster, {"cluster": "local", "address": "tcp://here:1"}, "one of the two"),
    (DaskCluster, {"workers": 2, "maximum": 3}, "workers alone"),
    (DaskCluster, {"address": "tcp://here:1", "workers": 3}, "the workers that the scheduler has"),
    (DaskCluster, SLURM | {"minimum": 3, "maximum": 2}, "a maximum that is at least as large"),
    (DaskCluster, {"jobs": JOBS}, "this cluster has no jobs"),
    (DaskCluster, SLURM | {"jobs": {"cores": 1, "memory": "1GB"}}, "Add walltime"),
    (DaskCluster, {"cluster": "pbs", "jobs": JOBS | {"project": "x"}}, "Remove project"),
    (DaskCluster, SLURM | {"jobs": JOBS | {"walltime": "60"}}, "in quotes"),
    (DaskCluster, SLURM | {"timeout": 3541.0}, "at most 3540 s"),
    (slurm_array, {"timeout": 241.0, "walltime": "00:05:00"}, "at most 240 s"),
]


def test_senseless_options_are_refused_and_those_at_their_bounds_taken():
    """A run that outlives its job would be killed and submitted again, for ever and without an error."""
    for executor, options, said in SENSELESS:
        with pytest.raises(InvalidInput, match=said):
            executor(**options)
    assert DaskCluster(**SLURM, timeout=3540.0, minimum=2, maximum=2).kind == "slurm"
    assert slurm_array(timeout=240.0, walltime="00:05:00", max_jobs=1, poll=0.5).poll == 0.5
    assert LocalProcesses(1, timeout=366 * 24 * 3600.0).workers == 1


def test_nothing_is_started_for_what_cannot_be_sent_or_for_no_request(monkeypatch):
    monkeypatch.setattr("strandline.runs.executors.dask.opened", lambda *_: pytest.fail("a cluster was started"))
    assert list(DaskCluster(**SLURM, workers=2)(BEAM, [])) == []
    for executor in (DaskCluster(), LocalProcesses(1)):
        pulled = iter(REQUESTS)
        with pytest.raises(InvalidInput, match="cannot be sent to worker processes"):
            executor(lambda inputs, workdir: None, pulled)
        assert len(list(pulled)) == len(REQUESTS)


def test_a_missing_extra_names_its_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(InvalidInput, match=r'cryptography.*pip install "strandline\[dask\]"'):
        list(DaskCluster(workers=1)(BEAM, REQUESTS))


def test_the_scheduler_of_jobs_listens_at_one_address_and_shows_no_pages():
    from distributed.utils import get_ip

    options = _listening("slurm", {})
    assert options == {"dashboard": False, "dashboard_address": "127.0.0.1:0", "host": get_ip()}
    assert "host" not in _listening("slurm", {"interface": "ib0"})


def test_a_folder_for_keys_that_cannot_be_written_is_one_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert _shared_folder("slurm") == str(tmp_path / ".cache" / "strandline")
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    with pytest.raises(InvalidInput, match=r"folder for the keys.*jobqueue\.pbs\.shared-temp-directory"):
        _shared_folder("pbs")


def test_the_options_of_an_array_are_those_of_sbatch():
    assert slurm_array().options(10) == ["--array=0-9", "--no-requeue", "--signal=B:USR1@45"]
    asked = {"walltime": "00:05:00", "partition": "p", "account": "a", "cpus": 2, "memory": "1G", "max_running": 3}
    found = " ".join(slurm_array(**asked, extra=("--hold",)).options(10))
    limits = "--time=00:05:00 --partition=p --account=a --cpus-per-task=2 --mem=1G --hold"
    assert found == f"--array=0-9%3 --no-requeue --signal=B:USR1@30 {limits}"


def test_a_batch_is_read_as_it_was_written_and_keeps_what_came_back(tmp_path):
    batch = ArrayBatch.new(tmp_path, BEAM, REQUESTS, 50.0)
    batch.submitted("17")
    again = ArrayBatch.read(batch.folder)
    assert (again, again.job, again.timeout) == (batch, "17", 50.0)
    record, other = (RunRecord(REQUESTS[0].key, REQUESTS[0].inputs, state) for state in ("failed", "killed"))
    batch.put(0, record)
    batch.put(0, other)
    for name in ("x.run", "4.tmp"):
        (batch.folder / "results" / name).touch()
    assert batch.present() == ({0: batch.folder / "results" / "0.run"}, frozenset())
    assert same_outcome(read_run(batch.present()[0][0]), record), "the first result counts"
    batch.take(0)
    batch.take(1)
    batch.put(0, other)
    assert batch.present() == ({}, {0, 1})
    (batch.folder / "logs" / "0.txt").write_text("x" * 9000 + "end")
    assert len(end_of(batch.folder / "logs" / "0.txt")) == 8192
    assert end_of(batch.folder / "logs" / "1.txt") == ""
    batch.remove()
    assert list(tmp_path.iterdir()) == []


def test_batches_are_listed_oldest_first_without_those_that_another_driver_removes(tmp_path, monkeypatch):
    made = [ArrayBatch.new(tmp_path, BEAM, REQUESTS, 50.0) for _ in range(3)]
    assert [batch.name for batch in known_batches(tmp_path)] == [batch.name for batch in made]
    read = ArrayBatch.read

    def remove_the_others_first(folder):
        for batch in made:
            if batch.folder != folder:
                batch.remove()
        return read(folder)

    monkeypatch.setattr(ArrayBatch, "read", remove_the_others_first)
    assert len(list(known_batches(tmp_path))) == 1


def test_a_job_without_a_result_is_told_by_its_state(tmp_path):
    batch = ArrayBatch.new(tmp_path, BEAM, REQUESTS, 50.0)
    (batch.folder / "logs" / "3.txt").write_text("the last words\n")
    ends = {
        "TIMEOUT": ("timeout", "walltime"),
        "NODE_FAIL": ("killed", "node_failed"),
        "CANCELLED+": ("killed", "cancelled"),
        "OUT_OF_MEMORY": ("killed", "out_of_memory"),
        "FAILED": ("killed", "worker_died"),
        None: ("killed", "worker_died"),
    }
    for word, end in ends.items():
        record = _without_result(batch, 3, REQUESTS[3], word)
        assert (record.state, record.failure_kind) == end
        assert record.log == "the last words"
    assert "SLURM no longer knows it" in record.message
    for said, kind in (
        ("slurmstepd: error: Exceeded job memory limit", "out_of_memory"),
        ("slurmstepd-n1: error: StepId=7.batch exceeded memory limit (480 > 300), being killed", "out_of_memory"),
        ("my solver: Exceeded job memory limit", "worker_died"),
    ):
        (batch.folder / "logs" / "3.txt").write_text(f"step 7\n{said}\nslurmstepd: error: *** JOB 7 ***\n")
        assert _without_result(batch, 3, REQUESTS[3], "FAILED").failure_kind == kind
        assert _without_result(batch, 3, REQUESTS[3], "TIMEOUT").failure_kind == "walltime"


@pytest.mark.stand_in
def test_a_run_at_the_end_of_its_walltime_keeps_what_it_said():
    request = SimpleNamespace(key="a", inputs={})
    found = _out_of_walltime(None, request, 3.0)
    assert (found.state, found.failure_kind, found.log) == ("timeout", "walltime", "")
    late = _out_of_walltime(RunRecord("a", {}, "timeout", log="step 7"), request, 3.0)
    assert (late.failure_kind, late.log) == ("walltime", "step 7")
    ok = RunRecord("a", {}, "ok")
    assert _out_of_walltime(ok, request, 3.0) is ok


@pytest.mark.stand_in
def test_an_executor_without_workers_stays_as_it_is():
    def executor(model, requests):
        return iter(())

    assert with_workers(executor, 3) is executor


def test_a_job_that_accounting_does_not_know_has_no_state(monkeypatch):
    for said, state in (("", None), ("COMPLETED\n", "COMPLETED")):
        monkeypatch.setattr(slurm_batch, "_said", lambda *words, said=said: said)
        assert slurm_batch.past_state("7", 1) == state
