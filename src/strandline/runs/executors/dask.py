"""Runs on a Dask cluster: on this machine, in jobs of SLURM or PBS, or wherever a scheduler has its workers.

Each run is submitted to one chosen thread of one worker only when that thread is free. So a worker that vanishes takes
down exactly the runs that it was making. Dask itself would also give up on the runs queued on that worker, or repeat
forever a run that outlives the walltime of its job.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from operator import length_hint
from typing import Any, ClassVar

from strandline.errors import InvalidInput
from strandline.models.protocol import ForwardModel
from strandline.runs.executors.dask_cluster import JOB_OPTIONS, imported, opened
from strandline.runs.executors.dask_driver import Driver
from strandline.runs.executors.local import usable_cores
from strandline.runs.executors.shared import (
    require_count,
    require_room_in_walltime,
    require_timeout,
    walltime_seconds,
)
from strandline.runs.record import RunRecord, RunRequest
from strandline.runs.worker import packed_model, require_posix

__all__ = ["DaskCluster"]

KINDS = ("local", "slurm", "pbs")


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
        require_timeout(self.timeout)
        for name, least in {"workers": 1, "minimum": 0, "maximum": 1}.items():
            require_count(name, getattr(self, name), remedy="Correct the number.", least=least)
        _require_one_place(self)
        _require_plain_counts(self)
        _require_jobs(self)

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
        imported("distributed")
        return self._run(packed_model(model), requests)

    def _run(self, setup: bytes, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        most = self.maximum or self.workers or (usable_cores() if self.kind == "local" else 1)
        slots = int(self.jobs.get("cores", 1))
        needed = min(most, -(-length_hint(requests, most * slots) // slots))
        if needed == 0:
            return
        least = min(needed, most if self.minimum is None else self.minimum)
        with opened(self.kind, self.address, needed, self.jobs) as cluster:
            life = walltime_seconds(self.jobs["walltime"]) if "walltime" in self.jobs else None
            driver = Driver(
                cluster,
                setup,
                iter(requests),
                timeout=self.timeout,
                life=life,
                least=least,
                most=length_hint(requests, sys.maxsize),
            )
            try:
                yield from driver.records()
            finally:
                driver.close()


def _require_one_place(options: DaskCluster) -> None:
    if options.cluster is not None and options.cluster not in KINDS:
        raise InvalidInput(
            "cluster",
            value=options.cluster,
            expected=f"one of {', '.join(KINDS)}",
            remedy="Choose one, or give the address of a scheduler.",
        )
    if options.address is not None and options.cluster is not None:
        raise InvalidInput(
            "cluster and address",
            value=f"{options.cluster} and {options.address}",
            expected="one of the two",
            remedy="Leave the cluster out if there is a scheduler already.",
        )


def _require_plain_counts(options: DaskCluster) -> None:
    """Refuse numbers that contradict each other, or that somebody else decides."""
    bounds = [value for value in (options.minimum, options.maximum) if value is not None]
    if options.workers is not None and bounds:
        raise InvalidInput(
            "workers together with minimum or maximum",
            value=options.workers,
            expected="workers alone, or minimum and maximum",
            remedy="Leave workers out.",
        )
    if options.kind in ("local", "address") and bounds:
        raise InvalidInput(
            "minimum and maximum",
            value=bounds,
            expected="cluster: slurm or pbs, whose jobs come and go",
            remedy="Give workers instead.",
        )
    if options.kind == "address" and options.workers is not None:
        raise InvalidInput(
            "workers together with the address of a scheduler",
            value=options.workers,
            expected="the workers that the scheduler has",
            remedy="Leave workers out.",
        )
    if options.minimum is not None and (options.maximum is None or options.minimum > options.maximum):
        raise InvalidInput(
            "minimum",
            value=options.minimum,
            expected="a maximum that is at least as large",
            remedy="Give one.",
        )


def _require_jobs(options: DaskCluster) -> None:
    if options.kind not in ("slurm", "pbs"):
        if options.jobs:
            raise InvalidInput(
                "jobs",
                value=dict(options.jobs),
                expected="none, because this cluster has no jobs",
                remedy="Choose cluster: slurm or pbs, or remove jobs.",
            )
        return
    for name in options.jobs:
        if name not in JOB_OPTIONS:
            raise InvalidInput(
                "jobs: unknown option",
                value=name,
                expected=f"one of {', '.join(JOB_OPTIONS)}",
                remedy=f"Remove {name}; directives of the queueing system go under extra.",
            )
    for name in ("cores", "memory", "walltime"):
        if name not in options.jobs:
            raise InvalidInput(
                f"jobs.{name}",
                value=None,
                expected="cores, memory and walltime of a job",
                remedy=f"Add {name}.",
            )
    require_count("jobs.cores", options.jobs["cores"], remedy="Correct the number.")
    walltime_seconds(options.jobs["walltime"])
    require_room_in_walltime(options.timeout, options.jobs["walltime"])
