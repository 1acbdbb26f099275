"""The executor that study.yaml names."""

import sys
from pathlib import Path
from typing import Any

from strandline.registry import lookup
from strandline.runs.executors import EXECUTORS, Executor
from strandline.studies.chosen import construct, open_entry, refused_at, require_parts
from strandline.studies.keys.executor import ExecutorChoice

__all__ = ["SLURM", "build_executor"]

SLURM = "slurm"
"""Folder in the study that holds the batches of SLURM arrays."""


def build_executor(choice: ExecutorChoice, folder: Path) -> Executor:
    """Return the executor of the study in `folder`; worker processes on this machine if it names none.

    Raises:
        InvalidStudy: The options do not fit together.
    """
    if choice.other is not None:
        ((name, options),) = choice.other.items()
        own: Executor = construct(open_entry(EXECUTORS, name, "executor", "an executor"), options, f"executor.{name}")
        require_parts(own, ("__call__",), f"executor.{name}")
        return own
    named: dict[str, dict[str, Any]] = {name: dict(options) for name, options in choice if options is not None}
    name, given = next(iter(named.items()), ("local", {}))
    if name == "slurm_array":
        given |= {
            "folder": folder.resolve() / SLURM,
            "command": (sys.executable, "-m", "strandline.studies.array_task", str(folder.resolve())),
            "extra": tuple(given["extra"]),
        }
    with refused_at(f"executor.{name}"):
        executor: Executor = lookup(EXECUTORS, name, "executor")(**given)
    return executor
