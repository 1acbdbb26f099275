"""What a worker process needs to load the model, and what keeps it from doing so."""

import importlib
import os
import pickle
from multiprocessing import spawn
from typing import Any

from strandline.errors import InvalidInput
from strandline.models.protocol import ForwardModel
from strandline.runs.worker import loads_main_module

__all__ = ["imported", "packed_model", "require_not_loading", "require_posix"]


def packed_model(model: ForwardModel) -> bytes:
    """Return what a worker needs to load `model`; refuse a model that cannot be sent."""
    require_not_loading()
    try:
        packed = pickle.dumps(model)
    except Exception as error:
        raise InvalidInput(
            "the model cannot be sent to worker processes",
            value=f"{type(error).__name__}: {error}",
            expected="a function or dataclass defined at the top level of a module, with fields that can be pickled",
            remedy="Move the model to the top level of a module (no lambda, no inner function), or use InProcess().",
        ) from error
    preparation = None
    if b"__main__" in packed:
        preparation = spawn.get_preparation_data("strandline-worker")
        preparation.pop("authkey", None)
    return pickle.dumps((preparation, packed))


def require_not_loading() -> None:
    """Refuse to start workers from a worker that is only looking for the model in the user's script."""
    if loads_main_module():
        raise InvalidInput(
            "worker processes were asked for while a worker was loading the script that defines the model",
            value="a script without a guard",
            expected="runs started under `if __name__ == '__main__':`",
            remedy="Put the code that starts the runs under that line, or the model into a module of its own.",
        )


def require_posix() -> None:
    """Refuse worker processes on a system that has no process groups."""
    if os.name != "posix":
        raise InvalidInput(
            "worker processes", value=os.name, expected="Linux or macOS", remedy="Use InProcess(), or run under WSL."
        )


def imported(module: str) -> Any:
    """Return a module of the extra ``dask``.

    Raises:
        InvalidInput: the module is not installed.
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
