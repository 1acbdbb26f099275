"""Ledgers of Python models from the time when a fingerprint covered the named function alone."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from strandline.errors import LedgerError
from strandline.models.protocol import ForwardModel, fingerprint
from strandline.models.python import PythonModel
from strandline.runs.overview import Overview

__all__ = ["as_in_ledgers"]


def as_in_ledgers(model: ForwardModel, ledgers: Sequence[Path]) -> ForwardModel:
    """Return `model`, identified by its function alone if the first existing ledger identifies it that way.

    The function must not have changed since; a change of what it calls goes unnoticed, as before.
    """
    if not isinstance(model, PythonModel):
        return model
    path = next((path for path in ledgers if path.is_file()), None)
    if path is None:
        return model
    try:
        with Overview(path) as ledger:
            kept = ledger.model()
        earlier = replace(model, function_alone=True)
        return earlier if kept not in (None, fingerprint(model)) and kept == fingerprint(earlier) else model
    except LedgerError:  # damaged: reported when it is opened for use
        return model
