"""The executor that study.yaml names."""

import sys
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput, InvalidStudy
from strandline.registry import lookup
from strandline.runs.executors import EXECUTORS, Executor
from strandline.studies.chosen import construct, open_entry
from strandline.studies.study_file import ExecutorChoice

__all__ = ["SLURM", "build_executor"]

SLURM = "slurm"
"""Folder in the study where the batches of SLURM arrays lie."""


def build_executor(choice: ExecutorChoice, folder: Path) -> Executor:
    """Return the executor of the study in `folder`; worker processes on this machine where it names none.

    Raises:
        InvalidStudy: options that do not fit together.
    """
    if choice.other is not None:
        ((name, options),) = choice.other.items()
        own: Executor = construct(open_entry(EXECUTORS, name, "executor", "executor"), options, f"executor.{name}")
        return own
    named: dict[str, dict[str, Any]] = choice.model_dump(exclude_none=True)
    name, given = next(iter(named.items()), ("local", {}))
    if name == "slurm_array":
        given |= {
            "folder": folder.resolve() / SLURM,
            "command": (sys.executable, "-m", "strandline.studies.array_task", str(folder.resolve())),
            "extra": tuple(given["extra"]),
        }
    try:
        executor: Executor = lookup(EXECUTORS, name, "executor")(**given)
    except InvalidInput as error:
        raise InvalidStudy(
            f"executor.{name}: {error.what}", value=error.value, expected=error.expected, remedy=error.remedy
        ) from None
    return executor
