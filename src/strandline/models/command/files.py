"""Files of a command: those that it gets, the results that it must leave, and the run folders that are kept."""

import contextlib
import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from strandline.errors import ForwardModelError
from strandline.interface import Interface
from strandline.models import refused
from strandline.readers import Reading, Unreadable, read_interface

RUNS = "runs"


@dataclass(frozen=True)
class SourceFile:
    """A file in the study folder that is copied for each run; digest and stamp are those when the study was loaded."""

    name: str
    path: Path
    digest: str
    stamp: tuple[int, int]

    @classmethod
    def of(cls, folder: Path, name: object, place: str) -> "SourceFile":
        path = file_in(folder, name, place)
        return cls(str(name), path, _digest(path), _stamp(path))

    def require_unchanged(self) -> None:
        """Refuse (``file_changed``) a file that has changed since then: its runs would belong to another model."""
        try:
            same = _stamp(self.path) == self.stamp or _digest(self.path) == self.digest
        except OSError as error:
            raise ForwardModelError("file_changed", f"{self.name} cannot be read any more: {error}") from None
        if not same:
            raise ForwardModelError("file_changed", f"{self.name} has changed since the study was loaded")


def relative_name(name: object, place: str) -> str:
    """Return `name` as a relative path that stays inside its folder."""
    fits = isinstance(name, str) and name.isprintable() and "\\" not in name and name.strip() == name
    parts = PurePosixPath(name).parts if fits and isinstance(name, str) else ()
    if not parts or parts[0] == "/" or ".." in parts or str(name).endswith("/"):
        expected = "the name of a file in the folder or below it: not absolute, without `..`"
        raise refused(place, name, expected, "Put the file there and give its name relative to the folder.")
    return str(PurePosixPath(*parts))


def file_in(folder: Path, name: object, place: str) -> Path:
    """Return the path of a file in the study folder."""
    path = folder / relative_name(name, place)
    if not path.is_file():
        raise refused(f"{place}: no such file", str(path), "a file in the study folder", "Correct the name.")
    if not path.resolve().is_relative_to(folder.resolve()):
        what, expected = f"{place}: a link that leads out of the study folder", "a file of the study folder itself"
        raise refused(what, f"{name} -> {path.resolve()}", expected, "Copy the file into the folder.")
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _stamp(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_size, found.st_mtime_ns


def kept_folder(workdir: Path, study: Path, key: str) -> Path:
    """Move the contents of a run's folder into a new folder runs/KEY-ATTEMPT of the study, and return its path."""
    parent = study / RUNS
    parent.mkdir(exist_ok=True)
    attempt = 1
    while True:
        target = parent / f"{key[:12] or 'trial'}-{attempt}"
        try:
            target.mkdir()
        except FileExistsError:
            attempt += 1
            continue
        for item in workdir.iterdir():
            with contextlib.suppress(shutil.SpecialFileError):  # a pipe or a socket, useless without its process
                shutil.move(item, target / item.name)
        return target


@dataclass(frozen=True)
class LogText:
    """A text that every successful run writes to a file; by default, to the output of the command."""

    log: str
    file: str | None = None

    def __post_init__(self) -> None:
        if not self.log:
            raise refused("log", self.log, "a text that every good run prints")
        if self.file is not None:
            object.__setattr__(self, "file", relative_name(self.file, "file"))

    def require(self, folder: Path, log: Path) -> None:
        """Refuse (``no_success``) a run whose log lacks the text."""
        path = folder / self.file if self.file else log
        try:
            found = self.log.encode() in path.read_bytes()
        except OSError as error:
            raise ForwardModelError("no_success", f"{path.name} cannot be read: {error.strerror}") from None
        if not found:
            raise ForwardModelError("no_success", f"{path.name} does not say {self.log!r}")


def named_by(errors: Mapping[str, str], folder: Path, error: ForwardModelError) -> ForwardModelError:
    """Return the error of a run with the kind whose text the run has printed, and that line as its message.

    The first of the kinds in `errors` that is found counts. The error stays if something killed the run from outside.
    """
    if not errors or error.state == "killed":
        return error
    lines = [line for log in sorted(folder.glob("*.log")) for line in log.read_text("utf-8", "replace").splitlines()]
    for kind, text in errors.items():
        for line in lines:
            if text in line:
                message = f"{line.strip()} ({error.message})"
                return ForwardModelError(kind, message, error.evidence, state=error.state, log=error.log)
    return error


def readings_of(result: Reading | None, results: Mapping[str, Reading] | None) -> dict[str, Reading]:
    """Return how to read the result of each condition; "" names a single unnamed condition."""
    if (result is None) == (results is None):
        found = "`result` and `results`" if result is not None else None
        expected = "either result: {file: …, unit: …}, or results: {CONDITION: {file: …, unit: …}, …}"
        raise refused("result", found, expected, "Name the file that holds the interface.")
    if results is not None and (not results or "" in results):
        raise refused("results", results, "{CONDITION: {file: …, unit: …}, …}")
    readings = dict(results or {}) if result is None else {"": result}
    for condition, reading in readings.items():
        relative_name(reading.file, f"results.{condition}.file" if condition else "result.file")
    return readings


def read_result(reading: Reading, folder: Path, started: int) -> Interface:
    """Return the interface in a result file of a run that started at a time by the folder's file system, nanoseconds.

    Raises:
        ForwardModelError: The result cannot be used; the state is ``invalid``, the kind says why.
    """
    path = folder / reading.file
    if not path.resolve().is_relative_to(folder.resolve()):
        message = f"{reading.file} is a link that leads out of the run's folder"
        raise ForwardModelError("result_unreadable", message, state="invalid")
    if path.exists() and path.stat().st_mtime_ns < started:
        raise ForwardModelError("result_old", f"{reading.file} is older than the run", state="invalid")
    try:
        return read_interface(path, reading, name=reading.file, ended=True)
    except Unreadable as error:
        message = str(error).replace(f"{folder}/", "")  # a folder that will be gone
        raise ForwardModelError(error.kind, message, state="invalid") from None
