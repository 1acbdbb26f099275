"""Ledgers of Python models that were begun when a fingerprint covered the named function alone."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from strandline.errors import LedgerError
from strandline.models.protocol import ForwardModel, fingerprint
from strandline.models.python import PythonModel
from strandline.runs.overview import Overview

__all__ = ["as_in_ledgers"]


def as_in_ledgers(model: ForwardModel, ledgers: Sequence[Path]) -> ForwardModel:
    """Return `model`, known by its function alone where the first of the ledgers there is knows it so.

    The function must be unchanged since; what it calls may have changed unseen, as before.
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
    except LedgerError:  # damaged: said when it is opened for use
        return model
