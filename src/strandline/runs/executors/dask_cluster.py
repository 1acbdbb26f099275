"""Starting, reaching and ending Dask clusters."""

import contextlib
import logging
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.foundations import InvalidInput, of_extra
from strandline.runs.worker import require_not_loading
from strandline.runs.worker_slot import interrupts_held_back

JOB_OPTIONS = ("cores", "memory", "walltime", "queue", "account", "interface", "extra", "prologue")
EXTRA = ("dask", "the executor dask")
REACH_SECONDS = 20.0
LOOPBACK = "127.0.0.1:0"
"""Where Dask serves the dashboard of a cluster, which shows what runs and needs no key: any free port, local only."""
LOST_WORKER = "distributed.deploy.lost-worker-timeout"
LOST_JOB_SECONDS = 2
"""A job that is gone does not come back: it is replaced at once, not after Dask's 15 s."""
LOST_PROCESS_SECONDS = 15
"""Seconds to wait for a process on this machine, which is restarted; on a busy machine that takes seconds."""


@dataclass
class Cluster:
    """A cluster ready for use: our client and, if we started the cluster, what makes its workers."""

    client: Any
    address: str
    maker: Any = None
    submissions: "Submissions | None" = None

    def shrink(self, jobs: int) -> None:
        """Keep only this many jobs; busy ones go last."""
        if self.submissions is not None:
            self.maker.adapt(minimum_jobs=jobs, maximum_jobs=max(jobs, 1))

    def replace_the_lost(self) -> None:
        """Restart workers on this machine that Dask has given up on, as it does if they come back too late."""
        if self.maker is None or self.submissions is not None:
            return
        wanted = self.maker.worker_spec
        if set(wanted) - set(self.maker.workers):
            self.maker.scale(len(wanted))

    @property
    def refused(self) -> str | None:
        """Why the queueing system refused the last job; None if it took the job, or was not asked."""
        return None if self.submissions is None else self.submissions.refused


@dataclass
class Submissions:
    """How the queueing system answered our jobs; Dask would wait forever for a worker whose job was refused."""

    refused: str | None = None

    def noted(self, job_type: Any) -> Any:
        """Return a type of job that reports here."""
        from distributed.core import Status

        submissions = self

        class NotedJob(job_type):  # type: ignore[misc]
            async def start(self) -> None:
                """Submit the job; if the queueing system refuses it, note why."""
                try:
                    await super().start()
                except RuntimeError as error:
                    submissions.refused = str(error)
                    self.status = Status.failed  # else the cluster could not be closed
                    raise
                submissions.refused = None

        return NotedJob


@contextlib.contextmanager
def opened(
    kind: str,
    address: str | None,
    workers: int,
    jobs: Mapping[str, Any],
    *,
    reach_seconds: float = REACH_SECONDS,
    lost_process_seconds: int = LOST_PROCESS_SECONDS,
) -> Iterator[Cluster]:
    """Yield a cluster with `workers` workers, or jobs with these options; a cluster that was started here is ended
    afterwards.

    With the address of an existing scheduler, none is started. The scheduler must answer within `reach_seconds`, and a
    worker on this machine come back within `lost_process_seconds`.

    Raises:
        InvalidInput: the cluster does not start, or does not answer.
    """
    import dask.config

    with contextlib.ExitStack() as stack:
        if address is not None:
            client = stack.enter_context(_client(address, address, reach_seconds))
            yield Cluster(client, address)
            return
        submissions = Submissions() if kind in ("slurm", "pbs") else None
        maker = _started(kind, workers, jobs, submissions)
        stack.callback(_end, maker)
        client = stack.enter_context(_client(maker, str(maker.scheduler_address), reach_seconds))
        patience = lost_process_seconds if submissions is None else LOST_JOB_SECONDS
        stack.enter_context(dask.config.set({LOST_WORKER: f"{patience}s"}))
        yield Cluster(client, str(maker.scheduler_address), maker, submissions)


def _end(maker: Any) -> None:
    with contextlib.suppress(TimeoutError, OSError):
        maker.close(timeout=10)
    for kept in vars(maker).values():
        if isinstance(kept, tempfile._TemporaryFileWrapper):  # a file of the key, which dask-jobqueue leaves open
            kept.close()


@contextlib.contextmanager
def _client(place: Any, address: str, reach_seconds: float) -> Iterator[Any]:
    """Yield a client of the scheduler at `place`, an address or one of our clusters."""
    from distributed import Client

    try:
        client: Any = Client(place, set_as_default=False, timeout=reach_seconds)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        raise InvalidInput(
            "Dask scheduler",
            value=f"{address}: {_first_line(error)}",
            expected="a scheduler that answers: tcp://host:port; or tls://host:port, with Dask's setting "
            "distributed.comm.tls naming the keys",
            remedy="Start it (`dask scheduler`), correct the address, or give Dask the keys that it accepts.",
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=5)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _started(kind: str, workers: int, jobs: Mapping[str, Any], submissions: Submissions | None) -> Any:
    """Return a cluster of our own with a new key, without which nobody can give or take runs.

    Its processes leave Ctrl-C to the driver.
    """
    from distributed.security import Security

    require_not_loading()
    of_extra("cryptography", *EXTRA)
    security: Any = Security.temporary()  # type: ignore[no-untyped-call]
    with interrupts_held_back():
        return _local(workers, security) if submissions is None else _queued(kind, workers, jobs, submissions, security)


def _local(workers: int, security: Any) -> Any:
    from distributed import LocalCluster

    try:
        return LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            host="127.0.0.1",
            security=security,
            dashboard_address=LOOPBACK,
            silence_logs=logging.CRITICAL,
        )
    except RuntimeError as error:
        raise InvalidInput(
            "the workers of the Dask cluster do not start",
            value=str(error),
            expected="runs started under `if __name__ == '__main__':` where they are started by a script",
            remedy="Put the code that starts the runs under that line.",
        ) from error


def _queued(kind: str, workers: int, jobs: Mapping[str, Any], submissions: Submissions, security: Any) -> Any:
    """Return a cluster whose workers are jobs, always adaptive: with plain scaling, a lost job is never replaced.

    Jobs find the key in a file that only this user can read, and that goes with the cluster.
    """
    import dask.config

    queues: Any = of_extra("dask_jobqueue", *EXTRA)
    options = {name: value for name, value in jobs.items() if name not in ("extra", "prologue")}
    cluster_type = {"slurm": queues.SLURMCluster, "pbs": queues.PBSCluster}[kind]
    arguments = dask.config.get(f"jobqueue.{kind}.worker-extra-args", None) or []
    maker = cluster_type(
        **options,
        job_cls=submissions.noted(cluster_type.job_cls),
        processes=1,
        job_extra_directives=list(jobs.get("extra", ())),
        job_script_prologue=list(jobs.get("prologue", ())),
        silence_logs=logging.CRITICAL,
        security=security,
        shared_temp_directory=_shared_folder(kind),
        protocol="tls://",
        scheduler_options=_listening(kind, jobs),
        worker_extra_args=[*arguments, "--no-dashboard", "--dashboard-address", LOOPBACK],
    )
    maker.adapt(minimum_jobs=workers, maximum_jobs=workers, interval="1s")
    return maker


def _listening(kind: str, jobs: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the scheduler listens: only at the address by which the workers reach it, not at all addresses."""
    import dask.config
    from distributed.utils import get_ip

    options: dict[str, Any] = {"dashboard": False, "dashboard_address": LOOPBACK}
    if not (jobs.get("interface") or dask.config.get(f"jobqueue.{kind}.interface", None)):
        options["host"] = get_ip()  # type: ignore[no-untyped-call]
    return options


def _shared_folder(kind: str) -> str:
    """Return the folder of the keys that jobs read: as in Dask's configuration, otherwise in the home folder.

    Raises:
        InvalidInput: No file can be written there.
    """
    import dask.config

    named = dask.config.get(f"jobqueue.{kind}.shared-temp-directory", None)
    folder = Path(os.path.expandvars(named)).expanduser() if named else Path.home() / ".cache" / "strandline"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InvalidInput(
            "folder for the keys of a Dask cluster",
            value=f"{folder}: {error.strerror or error}",
            expected="a folder that can be written here and read on the nodes",
            remedy=f"Name one in Dask's configuration: jobqueue.{kind}.shared-temp-directory.",
        ) from None
    return str(folder)
