"""Files that are written whole or not at all, files with JSON, and what a process leaves behind."""

import json
import math
import os
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path and move the finished file to `path`, which is written whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


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


def end_of(log: Path, size: int = 8192) -> str:
    """Return the last `size` bytes of a log as text; nothing if it cannot be read."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - size))
            return stream.read().decode("utf-8", "replace")
    except OSError:
        return ""


def how_it_ended(code: int | None) -> str:
    """Return the exit code of a process, minus the number of a signal that ended it, in words."""
    try:
        return f"exit code {code}" if code is None or code >= 0 else f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-(code or 0)}"


def _finite(value: Any) -> Any:
    """Return `value` with None for each number that is not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
