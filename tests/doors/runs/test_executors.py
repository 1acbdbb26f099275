"""Executors: the conformance suite, and what only worker processes must do."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from tests.doors.runs.dying import KilledWhileLoading
from tests.doors.runs.processes import Unloadable, hanging_driver, pids, processes_of_group, wait_until
from tests.unit.models.test_fields import AT, FIELD, MODEL

from strandline.foundations import InvalidInput
from strandline.models import PythonModel, WithFields, with_sensitivities
from strandline.runs import InProcess, LocalProcesses, RunRequest
from strandline.runs.worker import WorkerSlot, packed_model
from strandline.testing.executors import CHECKS, CRASH_CHECKS, TIMEOUT_CHECKS, WAITING_CHECKS, requests_for
from strandline.testing.models import Cantilever, Counted, Faulty

ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
ALONE = ["answers_each_request_once", "yields_in_order_of_completion", "returns_all_conditions_and_sensitivities"]
ALONE += ["gives_each_run_an_empty_folder", "unpicklable_exception", "system_exit", "nan", "exit", "huge_output"]
BESIDE = ["yields_in_order_of_completion", "pulls_when_a_worker_is_free", "stops_when_closed", "sigkill", "segfault"]


@pytest.mark.parametrize(("workers", "names"), [(1, ALONE), (2, BESIDE)], ids=["alone", "beside"])
def test_local_processes_conform(workers, names):
    for name in names:
        (CHECKS | CRASH_CHECKS)[name](LocalProcesses(workers), workers=workers)


def test_derivatives_by_a_vjp_come_back_from_a_process():
    model = WithFields(PythonModel("tests.unit.models.strips:pulled", sensitivities=True), (FIELD,))
    (found,) = LocalProcesses(1)(model, iter([RunRequest("key", AT)]))
    for name, slopes in with_sensitivities(MODEL)(AT, Path()).sensitivities[""].items():
        np.testing.assert_allclose(found.sensitivities[""][name], slopes, atol=1e-12)


def test_local_processes_stop_hanging_runs():
    for check in TIMEOUT_CHECKS.values():
        check(LocalProcesses(1, timeout=0.6), workers=1)


def test_local_processes_wait_for_requests():
    WAITING_CHECKS["waits_for_what_follows"](LocalProcesses(2), workers=2)
    WAITING_CHECKS["asks_beside_a_run"](LocalProcesses(2), workers=2, pause=0.2)
    for name in ("waits_for_what_follows", "hands_over_before_it_asks_again"):
        WAITING_CHECKS[name](LocalProcesses(1), workers=1)


def one_slot(model, requests):
    """Give requests one by one to a worker process that is kept."""
    with contextlib.closing(WorkerSlot(packed_model(model))) as slot:
        for request in requests:
            yield slot.run(request, None, wanted=lambda: True)


@pytest.mark.parametrize("executor", [LocalProcesses(2), one_slot], ids=["local", "one slot"])
def test_workers_killed_while_they_load_are_replaced_and_not_for_ever(tmp_path, executor):
    thrice = KilledWhileLoading(str(tmp_path), times=3)
    assert [record.state for record in executor(thrice, requests_for(thrice))] == ["ok"] * 6
    assert len(list(tmp_path.iterdir())) == 3
    for_ever = KilledWhileLoading(str(tmp_path), times=100)
    with pytest.raises(InvalidInput, match="killed before they have loaded the model: got 11 times"):
        list(executor(for_ever, requests_for(for_ever)))


def test_a_model_that_no_worker_can_load_is_one_clear_error():
    with pytest.raises(InvalidInput, match=r"could not load the model(.|\n)*UnpicklingError"):
        list(LocalProcesses(2)(Unloadable(), requests_for(Cantilever())))


def run_script(folder, body, *, guard="if __name__ == '__main__':"):
    """Run a script that defines a model with `body`, which then fails, and prints the message of its record."""
    text = textwrap.dedent(f"""
        import os
        from strandline.runs import LocalProcesses, RunRequest
        def model(inputs, workdir):
            {body}
            raise RuntimeError("enough")
        {guard}
            for record in LocalProcesses(1)(model, [RunRequest("a", {{"E": 1.0}})]):
                print(record.message)
        """)
    (folder / "script.py").write_text(text)
    return subprocess.run([sys.executable, folder / "script.py"], capture_output=True, text=True, timeout=60)


def test_a_model_of_a_guarded_script_is_run_on_one_thread(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    shown = "print(__name__, *(os.environ[name + '_NUM_THREADS'] for name in ('OMP', 'OPENBLAS', 'MKL')))"
    done = run_script(tmp_path, shown)
    assert done.returncode == 0, done.stderr
    assert "RuntimeError: enough" in done.stdout
    assert "__mp_main__ 1 1 1" in done.stdout


def test_a_script_that_no_worker_can_load_gets_the_remedy(tmp_path):
    done = run_script(tmp_path, "pass", guard="if True:")
    assert done.returncode != 0
    assert "start the runs under `if __name__ == '__main__':`" in done.stderr


@ON_LINUX
@pytest.mark.parametrize("fault", ["hang_in_c", pytest.param("child", marks=pytest.mark.smoke)])
def test_workers_and_their_children_vanish_when_the_driver_is_killed(tmp_path, fault):
    number = 2 if fault == "child" else 1
    with hanging_driver(tmp_path, "LocalProcesses(2)", fault):
        workers = pids(tmp_path)
        assert wait_until(lambda: all(len(processes_of_group(pid)) == number for pid in workers), 5)
    assert wait_until(lambda: not any(processes_of_group(pid) for pid in workers), 3)


@ON_LINUX
def test_ctrl_c_stops_the_workers_and_removes_their_folders(tmp_path):
    with hanging_driver(tmp_path, "LocalProcesses(2)") as driver:
        os.killpg(driver.pid, signal.SIGINT)
        _, stderr = driver.communicate(timeout=60)
    assert driver.returncode != 0
    assert stderr.decode().count("KeyboardInterrupt") == 1
    assert not any(processes_of_group(pid) for pid in pids(tmp_path))
    assert not list(tmp_path.glob("strandline-*"))


@ON_LINUX
def test_closing_early_kills_busy_workers_and_children(tmp_path):
    model = Counted(str(tmp_path), Faulty(fault="child", above=500.0))
    records = LocalProcesses(1)(model, requests_for(model, [400.0, 600.0]))
    next(records)
    assert wait_until(lambda: len(pids(tmp_path)) == 2 and len(processes_of_group(pids(tmp_path)[1])) == 2, 10)
    records.close()
    assert wait_until(lambda: not any(processes_of_group(pid) for pid in pids(tmp_path)), 5)


@pytest.mark.smoke
def test_folders_are_removed_and_the_driver_stays_where_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    before, model = (os.getcwd(), dict(os.environ)), Faulty(fault="dirty", above=0.0)  # noqa: PTH109
    for executor in (LocalProcesses(1), InProcess()):
        assert all(record.ok for record in executor(model, requests_for(model)))
    assert not list(tmp_path.iterdir())
    assert (os.getcwd(), dict(os.environ)) == before  # noqa: PTH109
