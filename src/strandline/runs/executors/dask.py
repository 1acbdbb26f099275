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

from strandline.foundations import InvalidInput, of_extra
from strandline.models import ForwardModel
from strandline.runs.executors import shared
from strandline.runs.executors.dask_cluster import EXTRA, JOB_OPTIONS, opened
from strandline.runs.executors.dask_driver import DaskDispatcher
from strandline.runs.executors.local import usable_cores
from strandline.runs.ledger.record import RunRecord, RunRequest
from strandline.runs.worker import packed_model, require_posix

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
        for wrong, what, value, expected, remedy in (*_contradictions(self), *_job_faults(self)):
            if wrong:
                raise InvalidInput(what, value=value, expected=expected, remedy=remedy)
        if self.kind in QUEUES:
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
            runs = DaskDispatcher(
                cluster,
                setup,
                iter(requests),
                timeout=self.timeout,
                life=life,
                least=least,
                most=length_hint(requests, sys.maxsize),
            )
            try:
                yield from runs.records()
            finally:
                runs.close()


def _contradictions(options: DaskCluster) -> list[tuple[bool, str, object, str, str]]:
    """Return options that contradict each other or that somebody else decides: whether they do, and the refusal."""
    place, workers, least, most = options.cluster, options.workers, options.minimum, options.maximum
    bounds = [value for value in (least, most) if value is not None]
    both = place is not None and options.address is not None
    alone, theirs = "workers alone, or minimum and maximum", "the workers that the scheduler has"
    coming = "cluster: slurm or pbs, whose jobs come and go"
    kinds, either = f"one of {', '.join(KINDS)}", "Leave the cluster out if there is a scheduler already."
    larger = least is not None and (most is None or least > most)
    return [
        (place not in (None, *KINDS), "cluster", place, kinds, "Choose one, or give the address of a scheduler."),
        (both, "cluster and address", f"{place} and {options.address}", "one of the two", either),
        (workers is not None and bool(bounds), "workers and minimum or maximum", workers, alone, "Leave workers out."),
        (options.kind not in QUEUES and bool(bounds), "minimum and maximum", bounds, coming, "Give workers instead."),
        (options.kind == "address" and workers is not None, "workers", workers, theirs, "Leave workers out."),
        (larger, "minimum", least, "a maximum that is at least as large", "Give one."),
    ]


def _job_faults(options: DaskCluster) -> list[tuple[bool, str, object, str, str]]:
    """Return what may be wrong with the options of jobs: whether it is, and the refusal."""
    jobs = options.jobs
    if options.kind not in QUEUES:
        remedy = "Choose cluster: slurm or pbs, or remove jobs."
        return [(bool(jobs), "jobs", dict(jobs), "none, because this cluster has no jobs", remedy)]
    known, needed = f"one of {', '.join(JOB_OPTIONS)}", ("cores", "memory", "walltime")
    rest = "directives of the queueing system go under extra."
    return [
        *((name not in JOB_OPTIONS, "jobs: unknown option", name, known, f"Remove {name}; {rest}") for name in jobs),
        *((name not in jobs, f"jobs.{name}", None, ", ".join(needed), f"Add {name}.") for name in needed),
    ]
