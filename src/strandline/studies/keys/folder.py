"""The files of a study folder, whether they can be written, and whether they belong to its study.yaml."""

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from strandline.foundations import InvalidStudy, read_json

STUDY = "study.yaml"
LEDGER = "ledger.sqlite"
POSTERIOR = "posterior.nc"
SUMMARY = "summary.json"
REFINEMENT = "refinement.json"
REPORT = "report.html"
CHECK = "check.json"
CHECK_LEDGER = "check.sqlite"
REPLICATES = "coverage.jsonl"
NEXT_LEDGER = "next.sqlite"
SPECIMENS_LINES = "specimens.jsonl"
SPECIMENS_TABLE = "specimens.csv"
SPECIMENS_LEDGER = "specimens.sqlite"
RESULTS = {value for key, value in globals().copy().items() if key.isupper() and isinstance(value, str)}
"""Names of result files, and that of the study file."""
RESULT_FOLDERS = frozenset({"figures", "runs", "slurm", "comparison", "__pycache__"})
RESULT_SUFFIXES = (".lock", "-wal", "-shm", ".html", ".log", ".sqlite")
OF_STUDY = "study_sha256"  # key by which each answer to a question, a JSON file, says of which study.yaml it is


Results = Literal["none", "current", "outdated"]


def results_in(folder: Path, study_sha256: str) -> Results:
    """Return whether there are results, and whether they belong to the study.yaml with this digest."""
    summary = read_json(folder / SUMMARY)
    if not summary:
        return "none"
    return "current" if summary.get(OF_STUDY) == study_sha256 else "outdated"


def is_result(path: Path) -> bool:
    """Return whether a file or folder in a study folder holds results, which a copy leaves out."""
    name = path.name
    named = name in RESULTS or name in RESULT_FOLDERS or name.endswith(RESULT_SUFFIXES)
    return name != STUDY and (named or (path.suffix == ".json" and OF_STUDY in read_json(path)))


def require_writable(folder: Path) -> None:
    """Refuse a folder in which no file can be created, and missing temporary folders; where possible leave no trace."""
    require_temporary()
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        what = "the study folder cannot be written to"
        expected = "a folder with write permission, for the ledger and the results"
        remedy = "Change its permissions, or copy the study elsewhere."
        raise InvalidStudy(what, value=f"{folder}: {error.strerror}", expected=expected, remedy=remedy) from None


def require_temporary() -> None:
    """Refuse a wrong TMPDIR, which Python would skip to fill another disk, and a machine without temporary folders."""
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
def told_if_unwritable(folder: Path) -> Iterator[None]:
    """Turn the system's refusal to write a result into one clear line."""
    try:
        yield
    except OSError as error:
        value = f"{error.filename or folder}: {error.strerror or error}"
        expected = "a folder with write permission and room on the disk"
        remedy = "Fix that and run again: finished forward runs are kept."
        raise InvalidStudy("the results cannot be written", value=value, expected=expected, remedy=remedy) from error


QUESTIONS = frozenset({"next", "what_if", "specimens"})  # keys of study.yaml that no run and no posterior depends on
QUESTION = re.compile(
    rf"""(?:^[^\S\n]*\n)*(?:^\#.*\n)*                                     # blank lines and comments above its key
    ^['"]?(?:{"|".join(sorted(QUESTIONS))})['"]?\s*:.*(?:\n|\Z)
    (?:(?:^(?:\#.*|[^\S\n]*)\n)*^(?:[^\S\n]+\S|[-\]}}]).*(?:\n|\Z))*     # the other lines of its value
    (?:(?:^(?:\#.*|[^\S\n]*)(?:\n|\Z))*\Z)?                            # after the last key: all that is left""",
    re.MULTILINE | re.VERBOSE,
)


def digest_of(text: str) -> str:
    """Return the SHA-256 of study.yaml without its questions, to notice results of another version of it.

    The comment and the blank lines above a question belong to it: adding one and removing it again changes nothing.
    """
    return hashlib.sha256(QUESTION.sub("", text).encode()).hexdigest()


def study_name(folder: Path) -> str:
    """Return the name of a new study in `folder`."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", folder.resolve().name).strip("-._") or "study"
