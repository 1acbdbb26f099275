"""The key `executor` of study.yaml."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from strandline.runs.executors import InProcess
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.local import LocalProcesses
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.studies.keys.options import Options
from strandline.studies.keys.scalars import Count, Seconds, Text
from strandline.studies.keys.section import Choice, Section

__all__ = ["ExecutorChoice"]


def _quoted(value: Any) -> Any:
    """Refuse a number: YAML 1.1 reads 4:00:00 without quotes as one, in base 60."""
    if value is not None and not isinstance(value, str):
        raise ValueError('a time in quotes, "04:00:00"')
    return value


Walltime = Annotated[Text, BeforeValidator(_quoted)]


class DaskJobs(Section):
    """The jobs that are the workers of a Dask cluster."""

    cores: Count = 1
    """simultaneous runs per job"""
    memory: Text
    """per job, `16GB`"""
    walltime: Walltime
    """per job, `"HH:MM:SS"` or `"D-HH:MM:SS"`, in quotes"""
    queue: Text | None = None
    """queue or partition"""
    account: Text | None = None
    """account to charge"""
    interface: Text | None = None
    """network interface between nodes and driver"""
    extra: list[Text] = []
    """further job directives, `["--qos=long"]`"""
    prologue: list[Text] = []
    """shell lines before the worker starts, `["module load gcc"]`"""


DASK = Options(
    DaskCluster, also={"cluster": (Literal["local", "slurm", "pbs"] | None, None), "jobs": (DaskJobs | None, None)}
)
SLURM_ARRAY = Options(
    SlurmArray,
    without=("folder", "command", "detach"),
    also={"walltime": (Walltime | None, None), "poll": (Seconds, 5.0)},
)


def _others_apart(value: Any) -> Any:
    """Return a mapping with its keys ``module:name`` moved under `other`."""
    if not isinstance(value, dict):
        return value
    others = {name: options for name, options in value.items() if isinstance(name, str) and ":" in name}
    rest = {name: options for name, options in value.items() if name not in others}
    return rest | ({"other": others} if others else {})


class ExecutorChoice(Section):
    """Where forward runs are made: one place."""

    in_process: Annotated[Mapping[str, Any], Options(InProcess)] | None = None
    local: Annotated[Mapping[str, Any], Options(LocalProcesses)] | None = None
    dask: Annotated[Mapping[str, Any], DASK] | None = None
    slurm_array: Annotated[Mapping[str, Any], SLURM_ARRAY] | None = None
    other: Annotated[Choice | None, Field(exclude=True)] = None
    """An executor that the study names by ``module:name``; no key of its own."""

    @model_validator(mode="before")
    @classmethod
    def _by_module(cls, value: Any) -> Any:
        return _others_apart(value)

    @model_validator(mode="after")
    def _one_place(self) -> "ExecutorChoice":
        if len(self.model_fields_set) > 1:
            known = [name for name, field in type(self).model_fields.items() if not field.exclude]
            raise ValueError(f"one of {', '.join(known)}")
        return self
