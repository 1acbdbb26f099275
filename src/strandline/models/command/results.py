"""The results that a run must leave, checked closely before they are used."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface
from strandline.models.command.names import relative_name
from strandline.readers import Reading, Unreadable, read_interface

__all__ = ["LogText", "named_by", "read_results", "readings_of"]


@dataclass(frozen=True)
class LogText:
    """A text that every successful run writes.

    Args:
        text: Text that must appear.
        file: File that must contain it; "" for the output of the command.
    """

    text: str
    file: str = ""

    @classmethod
    def of(cls, options: object) -> "LogText":
        """Return the check that the option `success` describes.

        Raises:
            InvalidInput: anything else.
        """
        fits = isinstance(options, Mapping) and set(options) <= {"log", "file"} and "log" in options
        if not (fits and isinstance(options, Mapping) and isinstance(options["log"], str) and options["log"]):
            raise InvalidInput(
                "success",
                value=options,
                expected="{log: TEXT}, or {log: TEXT, file: NAME} for a log that the simulator writes itself",
                remedy="Correct `success`.",
            )
        return cls(options["log"], relative_name(options["file"], "success.file") if "file" in options else "")

    def require(self, folder: Path, log: Path) -> None:
        """Refuse a run whose log lacks the text.

        Raises:
            ForwardModelError: ``no_success``.
        """
        path = folder / self.file if self.file else log
        try:
            found = self.text.encode() in path.read_bytes()
        except OSError as error:
            raise ForwardModelError("no_success", f"{path.name} cannot be read: {error.strerror}") from None
        if not found:
            raise ForwardModelError("no_success", f"{path.name} does not say {self.text!r}")


def named_by(errors: Mapping[str, str], folder: Path, error: ForwardModelError) -> ForwardModelError:
    """Return the error of a run with the kind whose text the run has printed, and that line as its message.

    Args:
        errors: Text of each kind; the first that is found counts.
        folder: Folder of the run, with its logs.
        error: The error so far; it stays if something killed the run from outside.
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


def readings_of(result: object, results: object) -> dict[str, Reading]:
    """Return how to read the result of each condition; "" names a single unnamed condition.

    Raises:
        InvalidInput: Both options or neither are given, or one is invalid.
    """
    if (result is None) == (results is None):
        raise InvalidInput(
            "result",
            value="`result` and `results`" if result is not None else None,
            expected="either result: {file: …, unit: …}, or results: {CONDITION: {file: …, unit: …}, …}",
            remedy="Name the file that holds the interface.",
        )
    if results is None:
        given: Mapping[object, object] = {"": result}
    elif isinstance(results, Mapping) and results and all(isinstance(name, str) and name for name in results):
        given = results
    else:
        raise InvalidInput(
            "results", value=results, expected="{CONDITION: {file: …, unit: …}, …}", remedy="Correct it."
        )
    readings = {}
    for condition, options in given.items():
        place = f"results.{condition}" if condition else "result"
        reading = Reading.from_options(options, place)
        relative_name(reading.file, f"{place}.file")
        readings[str(condition)] = reading
    return readings


def read_results(readings: Mapping[str, Reading], folder: Path, started: int) -> dict[str, Interface]:
    """Return the interfaces by condition.

    Args:
        readings: How to read the result file of each condition.
        folder: Folder of the run.
        started: Start of the command, in nanoseconds by the clock of the folder's file system.

    Raises:
        ForwardModelError: A result cannot be used; the state is ``invalid``, the kind says why.
    """
    return {condition: _read(reading, folder, started) for condition, reading in readings.items()}


def _read(reading: Reading, folder: Path, started: int) -> Interface:
    path = folder / reading.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ForwardModelError(
            "result_unreadable", f"{reading.file} is a link that leads out of the run's folder", state="invalid"
        )
    if path.exists() and path.stat().st_mtime_ns < started:
        raise ForwardModelError("result_old", f"{reading.file} is older than the run", state="invalid")
    try:
        return read_interface(path, reading, name=reading.file, ended=True)
    except Unreadable as error:
        raise ForwardModelError(error.kind, _told(error, folder), state="invalid") from None


def _told(error: InvalidInput, folder: Path) -> str:
    """Return the message without the path of the run's folder, which will be gone."""
    return str(error).replace(f"{folder}/", "")
