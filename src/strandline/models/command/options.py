"""Options of a command in study.yaml → checked values: templates with the inputs, files, results that it must leave."""

import contextlib
import functools
import hashlib
import itertools
import math
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import jinja2
import numpy as np
from jaxtyping import Float
from jinja2 import meta, nodes
from jinja2.sandbox import ImmutableSandboxedEnvironment

from strandline.foundations import ForwardModelError, InvalidInput, decimal, unfit
from strandline.interface import Interface
from strandline.models.protocol import ModelInput
from strandline.readers import Reading, Unreadable, read_interface

RUNS = "runs"
LONGEST = 20
"""Characters of a number: CalculiX 2.20 looks at no more, and so loses the exponent of 3.141592653589793e-05 in silence
(findings/calculix-twenty-characters.sh)."""
DECLARED = {"unit", "low", "high", "meaning"}


@dataclass(frozen=True)
class InputTemplate:
    """A text with inputs as ``{{ name }}``, numbers in at most 20 characters; `place` is its name in messages."""

    place: str
    text: str

    def __post_init__(self) -> None:
        try:
            _compiled(self.text)
        except jinja2.TemplateSyntaxError as error:
            remedy = "Correct the line; {% raw %}…{% endraw %} keeps braces as they are."
            raise unfit(f"{self.place}, line {error.lineno}", error.message, "a Jinja2 template", remedy) from None
        except (RecursionError, SyntaxError, MemoryError, OverflowError, ValueError) as error:
            what, found = f"the template {self.place} cannot be compiled", f"{type(error).__name__}: {error}"
            remedy = "Simplify the expressions between braces."
            raise unfit(what, found, "expressions of ordinary depth and size", remedy) from None

    @property
    def names(self) -> frozenset[str]:
        """The variables that must be given."""
        return frozenset(meta.find_undeclared_variables(_environment().parse(self.text)) - set(_environment().globals))

    def require_known(self, names: Iterable[str]) -> None:
        """Refuse variables other than `names`."""
        known = set(names)
        for name in sorted(self.names - known):
            found = _environment().parse(self.text).find_all(nodes.Name)
            line = min((node.lineno for node in found if node.name == name), default=1)
            expected = f"one of {', '.join(sorted(known))}"
            remedy = f"Correct the name, or add {name} to inputs or fixed."
            raise unfit(f"{self.place}, line {line}: unknown variable", name, expected, remedy)

    def rendered(self, values: Mapping[str, Any]) -> str:
        """Return the text with `values` filled in; a run in which that fails ends with the kind ``template``."""
        try:
            return _compiled(self.text).render(values)
        except Exception as error:
            raise ForwardModelError("template", f"{self.place}: {type(error).__name__}: {error}") from None


@functools.cache
def _environment() -> ImmutableSandboxedEnvironment:
    return ImmutableSandboxedEnvironment(
        undefined=jinja2.StrictUndefined, keep_trailing_newline=True, autoescape=False, finalize=_written
    )


@functools.lru_cache(maxsize=256)
def _compiled(text: str) -> jinja2.Template:
    return _environment().from_string(text)


def _written(value: Any) -> Any:
    """Return a number with all the digits for which there is room, at least twelve."""
    if not isinstance(value, float):
        return value
    text, digits = repr(float(value)), 14
    while len(text) > LONGEST:
        text, digits = f"{value:.{digits}e}", digits - 1
    return text


def words_of_field(name: str) -> tuple[str, str]:
    """Return the variables of a field in a template: the file with its points and values, and the values alone."""
    return f"{name}_field", f"{name}_values"


def rendered_field(
    name: str, values: Float[np.ndarray, " value"], points: Float[np.ndarray, "point xyz"]
) -> tuple[str, str, str]:
    """Return the name and the content of a field's file, a line ``x y z value`` for each point, and the values alone.

    Raises ForwardModelError, ``template``, if there are not as many values as points.
    """
    if len(values) != len(points):
        message = f"the field {name} has {len(values)} values for {len(points)} points: its mesh has changed"
        raise ForwardModelError("template", message)
    texts = [_written(value) for value in values.tolist()]
    places = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))).tolist()
    rows = (" ".join([*map(_written, place), text]) for place, text in zip(places, texts, strict=True))
    return f"{name}_field.txt", "\n".join(rows) + "\n", "\n".join(texts)


def commands_of(command: object, post: object, *, shell: bool) -> tuple[tuple[InputTemplate, ...], ...]:
    """Return the commands of a run as templates of their arguments."""
    if shell and not (isinstance(command, str) and command.strip()):
        raise _unfit("command", command, "with `shell: true` one text for /bin/sh")
    if not isinstance(post, list | tuple):
        raise _unfit("post", post, 'a command such as ["python", "extract.py"], or a list of commands')
    several = [post] if post and not isinstance(post[0], list | tuple) else list(post)
    return (_arguments([command] if shell else command, "command"), *(_arguments(one, "post") for one in several))


def _arguments(command: object, place: str) -> tuple[InputTemplate, ...]:
    if not (isinstance(command, list | tuple) and command and all(_is_word(item) for item in command)):
        raise _unfit(place, command, 'program and arguments as a list, e.g. ["ccx", "-i", "model"]')
    return tuple(InputTemplate(place, str(item)) for item in command)


def environment_of(given: object) -> dict[str, InputTemplate]:
    """Return the templates of environment variables; numbers become texts."""
    pairs = given.items() if isinstance(given, Mapping) else [("", "")]
    if not all(isinstance(name, str) and name and not {*name} & {*"\0="} and _is_word(value) for name, value in pairs):
        raise _unfit("environment", given, "names with texts, e.g. {NAME: text}")
    return {name: InputTemplate(f"environment.{name}", str(value)) for name, value in pairs}


def exit_codes_of(given: object) -> frozenset[int] | None:
    """Return the exit codes that count as success; None for all."""
    if given == "any":
        return None
    if isinstance(given, list | tuple) and given and all(type(code) is int for code in given):
        return frozenset(given)
    raise _unfit("exit_codes", given, "a list such as [0, 1], or any")


def declared_by(given: object) -> tuple[ModelInput, ...]:
    """Return the inputs that a study file declares."""
    if not isinstance(given, Mapping):
        raise _unfit("inputs", given, "declarations by name, e.g. {E: {unit: Pa, low: 0}}")
    return tuple(_declared(str(name), options) for name, options in given.items())


def _declared(name: str, options: object) -> ModelInput:
    place = f"inputs.{name}"
    if not (isinstance(options, Mapping) and set(options) <= DECLARED):
        raise _unfit(place, options, f"some of {', '.join(sorted(DECLARED))}")
    bounds = []
    for key, otherwise in (("low", -math.inf), ("high", math.inf)):
        value: Any = options.get(key, otherwise)
        if isinstance(value, str):  # 1e-5, which YAML 1.1 reads as text
            value = value if (number := decimal(value)) is None else number
        if not isinstance(value, int | float) or isinstance(value, bool) or math.isnan(value):
            raise _unfit(f"{place}.{key}", value, "a number")
        bounds.append(float(value))
    low, high = bounds
    if not low < high:
        raise _unfit(place, bounds, "low below high")
    return ModelInput(name, str(options.get("unit", "1")), low, high, meaning=str(options.get("meaning", "")))


def _is_word(value: object) -> bool:
    return isinstance(value, str | int | float) and not isinstance(value, bool) and "\0" not in str(value)


def _unfit(what: str, value: object, expected: str) -> InvalidInput:
    return unfit(what, value, expected, f"Correct `{what.partition('.')[0]}`.")


class SourceFile:
    """A file in the study folder that is copied for each run; the digest is that when the study was loaded."""

    def __init__(self, folder: Path, name: object, place: str) -> None:
        self.name, self.path = str(name), file_in(folder, name, place)
        self.digest = _digest(self.path)

    def require_unchanged(self) -> None:
        """Refuse (``file_changed``) a file that has changed since then: its runs would belong to another model."""
        try:
            now = _digest(self.path)
        except OSError as error:
            raise ForwardModelError("file_changed", f"{self.name} cannot be read any more: {error}") from None
        if now != self.digest:
            raise ForwardModelError("file_changed", f"{self.name} has changed since the study was loaded")


def relative_name(name: object, place: str) -> str:
    """Return `name` as a relative path that stays inside its folder."""
    fits = isinstance(name, str) and name.isprintable() and "\\" not in name and name.strip() == name
    parts = PurePosixPath(name).parts if fits and isinstance(name, str) else ()
    if not parts or parts[0] == "/" or ".." in parts or str(name).endswith("/"):
        expected = "the name of a file in the folder or below it: not absolute, without `..`"
        raise unfit(place, name, expected, "Put the file there and give its name relative to the folder.")
    return str(PurePosixPath(*parts))


def file_in(folder: Path, name: object, place: str) -> Path:
    """Return the path of a file in the study folder."""
    path = folder / relative_name(name, place)
    if not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for a name that is too long
        raise unfit(f"{place}: no such file", str(path), "a file in the study folder", "Correct the name.")
    if not path.resolve().is_relative_to(folder.resolve()):
        what, expected = f"{place}: a link that leads out of the study folder", "a file of the study folder itself"
        raise unfit(what, f"{name} -> {path.resolve()}", expected, "Copy the file into the folder.")
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def kept_folder(workdir: Path, study: Path, key: str) -> Path:
    """Move the contents of a run's folder into a new folder runs/KEY-ATTEMPT of the study, and return its path."""
    parent = study / RUNS
    parent.mkdir(exist_ok=True)
    for attempt in itertools.count(1):
        with contextlib.suppress(FileExistsError):
            target = parent / f"{key[:12] or 'trial'}-{attempt}"
            target.mkdir()
            break
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
            raise unfit("log", self.log, "a text that every good run prints")
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
        raise unfit("result", found, expected, "Name the file that holds the interface.")
    if results is not None and (not results or "" in results):
        raise unfit("results", results, "{CONDITION: {file: …, unit: …}, …}")
    readings = dict(results or {}) if result is None else {"": result}
    for condition, reading in readings.items():
        relative_name(reading.file, f"results.{condition}.file" if condition else "result.file")
    return readings


def read_result(reading: Reading, folder: Path, started: int) -> Interface:
    """Return the interface in a result file of a run that started at a time by the folder's file system, nanoseconds.

    Raises ForwardModelError, ``invalid``, if the result cannot be used; the kind says why.
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
