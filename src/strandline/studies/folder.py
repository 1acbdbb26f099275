"""The files of a study folder, and whether they can be written."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from strandline.errors import InvalidStudy

__all__ = ["LEDGER", "POSTERIOR", "STUDY", "SUMMARY", "require_writable", "whole_file"]

STUDY = "study.yaml"
LEDGER = "ledger.sqlite"
POSTERIOR = "posterior.nc"
SUMMARY = "summary.json"


def require_writable(folder: Path) -> None:
    """Refuse a folder in which no file can be made; where the system can, the try leaves no trace.

    Raises:
        InvalidStudy: with the system's reason.
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidStudy(
            "the study folder cannot be written to",
            value=f"{folder}: {error.strerror}",
            expected="a folder with write permission, for the ledger and the results",
            remedy="Change its permissions, or copy the study elsewhere.",
        ) from None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name and move the finished file to `path`: it is there whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
