"""Starting, reaching and ending Dask clusters."""

import contextlib
import importlib
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from strandline.errors import InvalidInput
from strandline.runs.executors.packing import require_not_loading
from strandline.runs.workers import interrupts_held_back

__all__ = ["JOB_OPTIONS", "Cluster", "imported", "opened"]

JOB_OPTIONS = ("cores", "memory", "walltime", "queue", "account", "interface", "extra", "prologue")
REACH_SECONDS = 20.0
SETTINGS = {"distributed.deploy.lost-worker-timeout": "2s"}
"""A worker that is gone does not come back: its job is gone too, and is replaced at once, not after 15 s."""


@dataclass
class Cluster:
    """A cluster that can be worked with: our client, and what makes its workers where we have started it."""

    client: Any
    address: str
    maker: Any = None
    submissions: "Submissions | None" = None

    def shrink(self, jobs: int) -> None:
        """Keep this many jobs only; those that are busy come last."""
        if self.submissions is not None:
            self.maker.adapt(minimum_jobs=jobs, maximum_jobs=max(jobs, 1))

    @property
    def refused(self) -> str | None:
        """Why the queueing system took no job the last time; None where it did, or was not asked."""
        return None if self.submissions is None else self.submissions.refused


@dataclass
class Submissions:
    """What the queueing system said to our jobs; Dask would wait for ever for a worker that it refused."""

    refused: str | None = None

    def noted(self, job_type: Any) -> Any:
        """Return a type of job that leaves word here."""
        from distributed.core import Status

        submissions = self

        class NotedJob(job_type):  # type: ignore[misc]
            async def start(self) -> None:
                try:
                    await super().start()
                except RuntimeError as error:
                    submissions.refused = str(error)
                    self.status = Status.failed  # else the cluster could not be closed
                    raise
                submissions.refused = None

        return NotedJob


def imported(module: str) -> Any:
    """Return a module of the extra ``dask``.

    Raises:
        InvalidInput: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise InvalidInput(
            "the executor dask",
            value=f"no module {error.name}",
            expected="the extra `dask`",
            remedy='Install it: pip install "strandline[dask]"',
        ) from None


@contextlib.contextmanager
def opened(kind: str, address: str | None, workers: int, jobs: Mapping[str, Any]) -> Iterator[Cluster]:
    """Give a cluster with `workers` workers, or jobs; one that was started here is ended afterwards."""
    import dask.config

    submissions = Submissions() if kind in ("slurm", "pbs") else None
    maker: Any = None if address is not None else _started(kind, workers, jobs, submissions)
    try:
        with _reached(maker, address) as client, dask.config.set(SETTINGS):
            yield Cluster(client, address or str(maker.scheduler_address), maker, submissions)
    finally:
        if maker is not None:
            with contextlib.suppress(TimeoutError, OSError):
                maker.close(timeout=10)


@contextlib.contextmanager
def _reached(maker: Any, address: str | None) -> Iterator[Any]:
    from distributed import Client

    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            address if maker is None else maker, set_as_default=False, timeout=REACH_SECONDS
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise InvalidInput(
            "Dask scheduler",
            value=f"{address}: {error}",
            expected="a scheduler that answers, tcp://host:port",
            remedy="Start it (`dask scheduler`), or correct the address.",
        ) from None
    try:
        yield client
    finally:
        client.close(timeout=5)


def _started(kind: str, workers: int, jobs: Mapping[str, Any], submissions: Submissions | None) -> Any:
    """Return a cluster of our own; its processes leave Ctrl-C to the driver."""
    require_not_loading()
    with interrupts_held_back():
        return _local(workers) if submissions is None else _queued(kind, workers, jobs, submissions)


def _local(workers: int) -> Any:
    from distributed import LocalCluster

    try:
        return LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    except RuntimeError as error:
        raise InvalidInput(
            "the workers of the Dask cluster do not start",
            value=str(error),
            expected="runs started under `if __name__ == '__main__':` where they are started by a script",
            remedy="Put the code that starts the runs under that line.",
        ) from error


def _queued(kind: str, workers: int, jobs: Mapping[str, Any], submissions: Submissions) -> Any:
    """Return a cluster whose workers are jobs, always adaptive: a job that is merely scaled for is never replaced."""
    queues: Any = imported("dask_jobqueue")
    options = {name: value for name, value in jobs.items() if name not in ("extra", "prologue")}
    cluster_type = {"slurm": queues.SLURMCluster, "pbs": queues.PBSCluster}[kind]
    maker = cluster_type(
        **options,
        job_cls=submissions.noted(cluster_type.job_cls),
        processes=1,
        job_extra_directives=list(jobs.get("extra", ())),
        job_script_prologue=list(jobs.get("prologue", ())),
        silence_logs=logging.CRITICAL,
        scheduler_options={"dashboard_address": ":0"},
    )
    maker.adapt(minimum_jobs=workers, maximum_jobs=workers, interval="1s")
    return maker
