"""The executor that study.yaml names."""

import importlib
import sys
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput, InvalidStudy
from strandline.runs.executors import EXECUTORS, Executor
from strandline.studies.schema import ExecutorChoice

__all__ = ["SLURM", "build_executor"]

SLURM = "slurm"
"""Folder in the study where the batches of SLURM arrays lie."""


def build_executor(choice: ExecutorChoice, folder: Path) -> Executor:
    """Return the executor of the study in `folder`; worker processes on this machine where it names none.

    Raises:
        InvalidStudy: options that do not fit together.
    """
    named: dict[str, dict[str, Any]] = choice.model_dump(exclude_none=True)
    name, options = next(iter(named.items()), ("local", {}))
    if name == "slurm_array":
        options |= {
            "folder": folder.resolve() / SLURM,
            "command": (sys.executable, "-m", "strandline.studies.array_task", str(folder.resolve())),
            "extra": tuple(options["extra"]),
        }
    module, _, attribute = EXECUTORS[name].partition(":")
    factory: Any = getattr(importlib.import_module(module), attribute)
    try:
        executor: Executor = factory(**options)
    except InvalidInput as error:
        raise InvalidStudy(
            f"executor.{name}: {error.what}", value=error.value, expected=error.expected, remedy=error.remedy
        ) from None
    return executor
