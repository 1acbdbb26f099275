"""Runs on a Dask cluster: on this machine, in jobs of SLURM or PBS, or wherever a scheduler has its workers.

Each run is submitted to one chosen thread of one worker only when that thread is free. So a worker that vanishes takes
down exactly the runs that it was making. Dask itself would also give up on the runs queued on that worker, or repeat
forever a run that outlives the walltime of its job. Below: how clusters start and end.
"""

import contextlib
import logging
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import length_hint
from pathlib import Path
from typing import Any, ClassVar

from strandline.foundations import of_extra, require, unfit
from strandline.models import ForwardModel
from strandline.runs.executors import shared
from strandline.runs.executors.dask_driver import Cluster, DaskDispatcher, Submissions
from strandline.runs.executors.local import usable_cores
from strandline.runs.ledger.record import RunRecord, RunRequest
from strandline.runs.worker import interrupts_held_back, packed_model, require_not_loading, require_posix

__all__ = ["DaskCluster"]

QUEUES = ("slurm", "pbs")
KINDS = ("local", *QUEUES)


@dataclass(frozen=True)
class DaskCluster:
    """Runs on a Dask cluster, each in a worker process of its own, started by its Dask worker.

    Args:
        cluster: ``local`` (default), worker processes on this machine; ``slurm`` or ``pbs``, one worker per job.
        address: Instead of a cluster: an existing scheduler, ``tcp://host:port`` or ``tls://host:port``.
        workers: Workers or jobs; default: one per core for ``local``, else one job.
        minimum: Jobs to keep when fewer runs are left; default: all.
        maximum: Instead of `workers`: maximum number of jobs. A job that vanishes is replaced.
        timeout: Seconds after which a run is killed; default: never.
        jobs: Options of jobs of ``slurm`` and ``pbs``: `cores` (runs at a time in a job), `memory`, `walltime`,
            `queue`, `account`, `interface`, and lists `extra` (directives of the job) and `prologue` (lines before the
            worker starts).

    A cluster that is started here uses TLS with its own key, and its workers stay alive while there is no run for them
    yet (`NOT_NOW`). At an `address`, Dask's own configuration determines the keys.

    Raises:
        InvalidInput: options that do not fit together; a timeout that the walltime does not leave room for.
    """

    cluster: str | None = None
    address: str | None = None
    workers: int | None = None
    minimum: int | None = None
    maximum: int | None = None
    timeout: float | None = None
    jobs: Mapping[str, Any] = field(default_factory=dict)

    asks_again: ClassVar[bool] = True

    def __post_init__(self) -> None:
        shared.require_seconds("timeout", self.timeout)
        for name, least in {"workers": 1, "minimum": 0, "maximum": 1}.items():
            shared.require_count(name, getattr(self, name), remedy="Correct the number.", least=least)
        _require_consistent(self)
        if self.kind not in QUEUES:
            what, remedy = "none, because this cluster has no jobs", "Choose cluster: slurm or pbs, or remove jobs."
            require(not self.jobs, "jobs", dict(self.jobs), what, remedy)
            return
        _require_known(self.jobs)
        shared.require_count("jobs.cores", self.jobs["cores"], remedy="Correct the number.")
        shared.walltime_seconds(self.jobs["walltime"])
        shared.require_room_in_walltime(self.timeout, self.jobs["walltime"])

    @property
    def kind(self) -> str:
        """Kind of cluster: one of `KINDS`, or ``address``."""
        return "address" if self.address is not None else self.cluster or "local"

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request as runs end.

        Raises:
            InvalidInput: the model cannot be sent to, or loaded by, the workers; the cluster cannot be started or
                reached; the extra ``dask`` is not installed.
        """
        require_posix()
        of_extra("distributed", *EXTRA)
        return self._run(packed_model(model), requests)

    def _run(self, setup: bytes, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        most = self.maximum or self.workers or (usable_cores() if self.kind == "local" else 1)
        slots = int(self.jobs.get("cores", 1))
        needed = min(most, -(-length_hint(requests, most * slots) // slots))
        if needed == 0:
            return
        least = min(needed, most if self.minimum is None else self.minimum)
        with opened(self.kind, self.address, needed, self.jobs) as cluster:
            life = shared.walltime_seconds(self.jobs["walltime"]) if "walltime" in self.jobs else None
            limits = {"least": least, "most": length_hint(requests, sys.maxsize)}
            runs = DaskDispatcher(cluster, setup, iter(requests), timeout=self.timeout, life=life, **limits)
            with contextlib.closing(runs):
                yield from runs.records()


def _require_consistent(options: DaskCluster) -> None:
    """Refuse options that contradict each other or that somebody else decides."""
    place, workers, least, most = options.cluster, options.workers, options.minimum, options.maximum
    bounds = [value for value in (least, most) if value is not None]
    kinds, remedy = f"one of {', '.join(KINDS)}", "Choose one, or give the address of a scheduler."
    require(place in (None, *KINDS), "cluster", place, kinds, remedy)
    one, found = place is None or options.address is None, f"{place} and {options.address}"
    remedy = "Leave the cluster out if there is a scheduler already."
    require(one, "cluster and address", found, "one of the two", remedy)
    alone, coming = "workers alone, or minimum and maximum", "cluster: slurm or pbs, whose jobs come and go"
    require(workers is None or not bounds, "workers and minimum or maximum", workers, alone, "Leave workers out.")
    require(options.kind in QUEUES or not bounds, "minimum and maximum", bounds, coming, "Give workers instead.")
    ours, theirs = options.kind != "address" or workers is None, "the workers that the scheduler has"
    require(ours, "workers", workers, theirs, "Leave workers out.")
    fits = least is None or (most is not None and least <= most)
    require(fits, "minimum", least, "a maximum that is at least as large", "Give one.")


def _require_known(jobs: Mapping[str, Any]) -> None:
    """Refuse unknown options of jobs, and missing ones."""
    known, needed = f"one of {', '.join(JOB_OPTIONS)}", ("cores", "memory", "walltime")
    for name in jobs:
        remedy = f"Remove {name}; directives of the queueing system go under extra."
        require(name in JOB_OPTIONS, "jobs: unknown option", name, known, remedy)
    for name in needed:
        require(name in jobs, f"jobs.{name}", None, ", ".join(needed), f"Add {name}.")


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
    """Yield a cluster with `workers` workers, or jobs with these options; end it afterwards if it was started here.

    With the address of an existing scheduler, none is started. A cluster that does not start, or whose scheduler does
    not answer within `reach_seconds`, is refused. A worker on this machine must come back within
    `lost_process_seconds`.
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
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        expected = "a scheduler that answers: tcp://host:port; or tls://host:port, with Dask's setting "
        expected += "distributed.comm.tls naming the keys"
        remedy = "Start it (`dask scheduler`), correct the address, or give Dask the keys that it accepts."
        raise unfit("Dask scheduler", f"{address}: {reason}", expected, remedy) from None
    try:
        yield client
    finally:
        client.close(timeout=5)


def _started(kind: str, workers: int, jobs: Mapping[str, Any], submissions: Submissions | None) -> Any:
    """Return our own cluster, with a key that giving or taking runs needs; its processes leave Ctrl-C to the driver."""
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
            memory_limit=0,
            host="127.0.0.1",
            security=security,
            dashboard_address=LOOPBACK,
            silence_logs=logging.CRITICAL,
        )
    except RuntimeError as error:
        what = "the workers of the Dask cluster do not start"
        expected = "runs started under `if __name__ == '__main__':` where they are started by a script"
        remedy = "Put the code that starts the runs under that line."
        raise unfit(what, str(error), expected, remedy) from error


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
    """Return the folder of the keys that jobs read, in the home folder unless Dask's configuration names another."""
    import dask.config

    named = dask.config.get(f"jobqueue.{kind}.shared-temp-directory", None)
    folder = Path(os.path.expandvars(named)).expanduser() if named else Path.home() / ".cache" / "strandline"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        what, found = "folder for the keys of a Dask cluster", f"{folder}: {error.strerror or error}"
        remedy = f"Name one in Dask's configuration: jobqueue.{kind}.shared-temp-directory."
        raise unfit(what, found, "a folder that can be written here and read on the nodes", remedy) from None
    return str(folder)
