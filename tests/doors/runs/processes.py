"""Processes that the tests start, look at and wait for."""

import contextlib
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path


def wait_until(condition, seconds):
    """Return whether the condition holds, or comes to hold in time."""
    deadline = time.monotonic() + seconds
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return holds


def _fields(pid):
    """Return what the system says of a process after its name; nothing if there is none."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def alive(pid):
    return _fields(pid)[:1] not in ([], ["Z"])


def processes_of_group(group):
    """Return the living processes of a process group."""
    pids = [int(path.name) for path in Path("/proc").glob("[0-9]*")]
    return [pid for pid in pids if _fields(pid)[2:3] == [str(group)] and alive(pid)]


def pids(folder, file="calls"):
    """Return the processes in the lines that a model has left, one for each of its runs."""
    path = folder / file
    return [int(line.split()[0]) for line in path.read_text().splitlines()] if path.exists() else []


HANGING = """
import sys
from strandline.runs import LocalProcesses
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import requests_for
from strandline.testing.models import Counted, Faulty
if __name__ == "__main__":
    {before}
    model = Counted(sys.argv[1], Faulty(fault=sys.argv[2], above=0.0))
    list({executor}(model, requests_for(model)))
"""


@contextlib.contextmanager
def hanging_driver(folder, executor, fault="hang_in_c", before="pass"):
    """Start a driver; give it when two of its runs hang in the given way."""
    command = [sys.executable, "-c", HANGING.format(executor=executor, before=before), str(folder), fault]
    options = {"env": {**os.environ, "TMPDIR": str(folder)}, "stderr": subprocess.PIPE, "start_new_session": True}
    with subprocess.Popen(command, **options) as driver:
        try:
            assert wait_until(lambda: len(pids(folder)) == 2, 60)
            yield driver
        finally:
            driver.kill()


def driven_by(place, **limits):
    """Return a Dask executor that opens the cluster `place()` and whose driver has other limits than the product's."""
    from strandline.runs.executors.dask_driver import DaskDispatcher
    from strandline.runs.worker import packed_model

    limits = {"timeout": None, "life": None, "least": 1, "most": 1, **limits}

    def execute(model, requests):
        with place() as cluster:
            runs = DaskDispatcher(cluster, packed_model(model), iter(requests), **limits)
            try:
                yield from runs.records()
            finally:
                runs.close()

    return execute


class Unloadable:
    """A model that no worker process can load."""

    fingerprint = "test:unloadable"

    def __reduce__(self):
        return pickle.loads, (b"not a pickle",)

    def __call__(self, inputs, workdir):
        raise AssertionError
