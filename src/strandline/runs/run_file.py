"""One record in its own file, written on one machine and read on another, completely or not at all.

The file holds a line with the version and the sha256 of what follows, then an NPZ archive with the arrays, and the rest
as JSON. Nothing is pickled.
"""

import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from strandline.errors import InvalidInput, StrandlineError
from strandline.interface import Interface
from strandline.runs.record import RunRecord

__all__ = ["put_durably", "read_run", "write_run"]

HEADER = b"strandline run 1 "
PLAIN = ("key", "inputs", "state", "diagnostics", "seconds", "failure_kind", "message", "log")


def write_run(path: Path, record: RunRecord) -> None:
    """Write `record` to `path`, durably."""
    facts: dict[str, Any] = {name: getattr(record, name) for name in PLAIN}
    facts |= {"inputs": dict(record.inputs), "diagnostics": dict(record.diagnostics)}
    facts["interfaces"] = list(record.interfaces)
    facts["sensitivities"] = [[of, name] for of, by_input in record.sensitivities.items() for name in by_input]
    arrays = {"facts": np.frombuffer(json.dumps(facts).encode(), np.uint8)}
    for number, interface in enumerate(record.interfaces.values()):
        arrays |= {f"points{number}": interface.points, f"cells{number}": interface.cells}
    for number, (of, name) in enumerate(facts["sensitivities"]):
        arrays[f"sensitivity{number}"] = record.sensitivities[of][name]
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    content = stream.getvalue()
    put_durably(path, HEADER + hashlib.sha256(content).hexdigest().encode() + b"\n" + content)


def read_run(path: Path) -> RunRecord:
    """Return the record in `path`.

    Raises:
        InvalidInput: the content is not what was written.
    """
    header, _, content = path.read_bytes().partition(b"\n")
    if header != HEADER + hashlib.sha256(content).hexdigest().encode():
        raise _damaged(path, "a checksum that does not match")
    try:
        return _read(content)
    except (ValueError, KeyError, TypeError, BadZipFile, StrandlineError) as error:
        raise _damaged(path, str(error)) from error


def put_durably(path: Path, content: bytes) -> None:
    """Write a file completely or not at all; it is on the disk when this returns."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with partial.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _read(content: bytes) -> RunRecord:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        facts = json.loads(arrays["facts"].tobytes())
        interfaces = {
            name: Interface(arrays[f"points{number}"], arrays[f"cells{number}"])
            for number, name in enumerate(facts["interfaces"])
        }
        sensitivities: dict[str, dict[str, Any]] = {}
        for number, (of, name) in enumerate(facts["sensitivities"]):
            sensitivities.setdefault(of, {})[name] = arrays[f"sensitivity{number}"]
    return RunRecord(**{name: facts[name] for name in PLAIN}, interfaces=interfaces, sensitivities=sensitivities)


def _damaged(path: Path, how: str) -> InvalidInput:
    return InvalidInput(
        f"the result of a run in {path}", value=how, expected="what was written", remedy="The run is made again."
    )
