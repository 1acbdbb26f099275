"""The files of a study folder, and whether they can be written."""

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from strandline.errors import InvalidStudy

STUDY = "study.yaml"
LEDGER = "ledger.sqlite"
POSTERIOR = "posterior.nc"
SUMMARY = "summary.json"
REFINEMENT = "refinement.json"
REPORT = "report.html"
CHECK = "check.json"
CHECK_LEDGER = "check.sqlite"
COVERAGE = "coverage.json"
COMPARISON = "compare.json"
REPLICATES = "coverage.jsonl"
NEXT = "next.json"
NEXT_LEDGER = "next.sqlite"
WHAT_IF = "what-if.json"
SPECIMENS = "specimens.json"
SPECIMENS_LINES = "specimens.jsonl"
SPECIMENS_TABLE = "specimens.csv"
SPECIMENS_LEDGER = "specimens.sqlite"
RESULTS = frozenset(value for key, value in globals().copy().items() if key.isupper() and isinstance(value, str))
"""Names of result files, and that of the study file."""
RESULT_FOLDERS = frozenset({"figures", "runs", "slurm", "comparison", "__pycache__"})
RESULT_SUFFIXES = (".lock", "-wal", "-shm", ".html", ".log", ".sqlite")


def is_result(name: str) -> bool:
    """Return whether a file or folder of this name in a study folder holds results, which a copy leaves out."""
    return name != STUDY and (name in RESULTS or name in RESULT_FOLDERS or name.endswith(RESULT_SUFFIXES))


def require_writable(folder: Path) -> None:
    """Refuse a folder in which no file can be created; if the system allows it, the trial leaves no trace.

    Temporary folders are tried as well, because runs are made in them.

    Raises:
        InvalidStudy: No file can be created; the message has the system's reason.
    """
    require_temporary()
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


def require_temporary() -> None:
    """Refuse an environment without temporary folders for the runs: TMPDIR is wrong, or no folder can be used.

    Python itself would skip a wrong TMPDIR and fill another disk.

    Raises:
        InvalidStudy: No temporary folder can be made; the message names the folder.
    """
    named = next((name for name in ("TMPDIR", "TEMP", "TMP") if os.environ.get(name)), None)
    place = os.environ[named] if named else None
    try:
        with tempfile.TemporaryDirectory(dir=place):
            return
    except OSError as error:
        raise InvalidStudy(
            "forward runs can have no temporary folders",
            value=f"{named} = {place}: {error.strerror}" if named else str(error),
            expected="a folder that exists, with write permission and room",
            remedy=f"Make the folder, or correct {named}." if named else "Set TMPDIR to such a folder.",
        ) from None


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path and move the finished file to `path`, which is written whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def told_if_unwritable(folder: Path) -> Iterator[None]:
    """Turn the system's refusal to write a result into one clear line.

    Raises:
        InvalidStudy: A result cannot be written; the message has the file and the system's reason.
    """
    try:
        yield
    except OSError as error:
        raise InvalidStudy(
            "the results cannot be written",
            value=f"{error.filename or folder}: {error.strerror or error}",
            expected="a folder with write permission and room on the disk",
            remedy="Fix that and run again: finished forward runs are kept.",
        ) from error


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write `content`, whole or not at all, with null for each number that is not finite."""
    text = json.dumps(_finite(content), indent=2, ensure_ascii=False, allow_nan=False)
    with whole_file(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a file with JSON; nothing if there is none, or no mapping in it that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _finite(value: Any) -> Any:
    """Return `value` with None for each number that is not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
