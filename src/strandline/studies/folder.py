"""The files of a study folder, whether they can be written, and whether they belong to its study.yaml."""

import hashlib
import json
import math
import os
import re
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
    """Turn the system's refusal to write a result into one clear line."""
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


QUESTIONS = frozenset({"next", "what_if", "specimens"})
"""Keys that no forward run and no posterior depends on."""
ASKED = re.compile(rf"^['\"]?({'|'.join(sorted(QUESTIONS))})\b", re.MULTILINE)


def digest_of(text: str) -> str:
    """Return the SHA-256 of study.yaml without its questions, to notice results of another version of it."""
    return hashlib.sha256(without_questions(text).encode()).hexdigest()


def without_questions(text: str) -> str:
    """Return the text of study.yaml without its questions, with the comment and the blank lines above each of them.

    Adding a question to a study and removing it again thus changes nothing.
    """
    if not ASKED.search(text):
        return text
    import yaml  # loaded only if needed: `strandline status` is quick

    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    if not isinstance(root, yaml.MappingNode) or root.flow_style:
        return text
    lines = text.splitlines(keepends=True)
    starts = [(str(key.value), key.start_mark.line) for key, _ in root.value]
    ends = [*(line for _, line in starts[1:]), len(lines)]
    cut = {
        number
        for (name, start), end in zip(starts, ends, strict=True)
        if name in QUESTIONS
        for number in _block(lines, start, end)
    }
    return "".join(line for number, line in enumerate(lines) if number not in cut)


def _block(lines: list[str], start: int, end: int) -> Iterator[int]:
    """Return the numbers of a key's lines and of those above it; what stands above the next key belongs to that one."""
    last = end if end == len(lines) else _content_end(lines, start, end)
    first = start
    while first > 0 and lines[first - 1].startswith("#"):
        first -= 1
    while first > 0 and not lines[first - 1].strip():
        first -= 1
    return iter(range(first, last))


def _content_end(lines: list[str], start: int, end: int) -> int:
    while end > start + 1 and (not lines[end - 1].strip() or lines[end - 1].startswith("#")):
        end -= 1
    return end
