"""A simulator that is run as a command, with templates for its input and a file for its result."""

import contextlib
import copy
import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError, end_of, how_it_ended, require, unfit
from strandline.models.command import options
from strandline.models.protocol import ModelInput, Simulation
from strandline.readers import Reading

PYTHON = "python"
"""A variable that every template knows: the interpreter that runs strandline."""
LOG = "command.log"
LONGEST_SECONDS = 366 * 24 * 3600
SUPERVISOR = Path(__file__).with_name("supervisor.py")
LOG_LIMIT = 1_000_000
"""Bytes kept of the beginning, and of the end, of a command's output."""
KILLED_IN_A_SHELL = 128 + signal.SIGKILL
"""Exit code of a shell, or a launcher such as mpirun, whose own child was killed by SIGKILL."""
SHORT_OF_MEMORY = frozenset({errno.ENOMEM, errno.EAGAIN})
KINDS = (
    "exit_code", "simulator_killed", "command_not_found", "no_success", "result_missing", "result_old",
    "result_unreadable", "template", "file_changed", "processes_left", "supervisor_died",
)  # fmt: skip


@dataclass(frozen=True)
class ProcessEnd:
    """How a command ended: its exit code, minus the number of a signal; None if it never started, with the `problem`.

    `timed_out`: its time was up. `tail` is the end of its output. `out_of_memory`: the kernel killed a process for lack
    of it.
    """

    exit_code: int | None
    timed_out: bool
    tail: str
    problem: str = ""
    out_of_memory: bool = False


@dataclass(frozen=True)
class CommandModel:
    """A simulator that a command starts, in a new folder for each run.

    Templates are rendered into the folder and files copied there; the command and those of `post` run there without a
    shell, and the interface is read from the result file. A run succeeds if its result exists, is newer than the start,
    complete and finite; the exit code alone is not enough. No process that the command started outlives the run.

    A field E is rendered as ``{{ E_field }}``, the name of a file in the folder of the run with a line ``x y z value``
    for each point, lengths in mm; or as ``{{ E_values }}``, the values alone, one a line.

    Args:
        command: Program and arguments as a list; with `shell`, one text.
        result: File that holds the interface and how to read it, see `strandline.readers.Reading`.
        results: One such mapping for each condition, instead of `result`.
        templates: Files in the study folder → names in the folder of the run; values of inputs replace ``{{ NAME }}``.
        files: Names of files in the study folder, copied into the folder of the run.
        shell: Whether the command is a text for /bin/sh.
        post: A command, or a list of commands, to run afterwards.
        environment: Environment variables, added to those of strandline.
        timeout: Time limit for all commands of a run, seconds; None: no limit.
        grace: Seconds between SIGTERM and SIGKILL.
        exit_codes: Exit codes that count as success, or ``any``.
        success: ``{log: TEXT}``, a text that a good run prints, or writes to ``file``.
        errors: ``{KIND: TEXT}``: a failed run that prints the text fails with this kind, and that line says why.
        keep: Which run folders are kept in the study's folder `runs`: ``all``, ``failed`` or ``none``.
        version: Version of the simulator; runs of different versions are different runs.
        inputs: Declared inputs, ``{E: {unit: Pa, low: 0, high: 1000, meaning: …}}``; empty if units and ranges are
            unknown.
        folder: Folder of the study.

    Raises:
        InvalidInput: An invalid option, a file that is missing or outside the study folder, or a mistake in a template.
    """

    command: Any
    result: Reading | None = None
    results: Mapping[str, Reading] | None = None
    templates: Mapping[str, str] = field(default_factory=dict)
    files: Any = field(default_factory=list)
    shell: bool = False
    post: Any = field(default_factory=list)
    environment: Any = field(default_factory=dict)
    timeout: float | None = None
    grace: float = 5.0
    exit_codes: Any = field(default_factory=lambda: [0])
    success: options.LogText | None = None
    errors: Mapping[str, str] = field(default_factory=dict)
    keep: Literal["all", "failed", "none"] = "failed"
    version: str = ""
    inputs: tuple[ModelInput, ...] = field(default=(), metadata={"read": options.declared_by})
    folder: Path = Path()
    failure_kinds: ClassVar[tuple[str, ...]] = KINDS
    _parts: "_Parts" = field(init=False, repr=False, compare=False)
    _fields: Mapping[str, Float[np.ndarray, "point xyz"]] = field(
        init=False, default_factory=dict, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "folder", self.folder.resolve())
        object.__setattr__(self, "_parts", _Parts(self))
        object.__setattr__(self, "failure_kinds", (*KINDS, *self.errors))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the conditions that have a result; a single unnamed one by default."""
        return tuple(self._parts.readings)

    @property
    def fingerprint(self) -> str:
        """Text that changes with templates, files, commands, environment, the reading of results and `version`."""
        parts = self._parts
        text = json.dumps(
            [
                1,
                sorted([target, template.text] for target, template in parts.templates),
                sorted([file.name, file.digest] for file in parts.files),
                [[item.text for item in command] for command in parts.commands],
                self.shell,
                sorted((name, item.text) for name, item in parts.environment.items()),
                [[name, sorted(reading.given.items())] for name, reading in parts.readings.items()],
                None if parts.exit_codes is None else sorted(parts.exit_codes),
                None if self.success is None else [self.success.log, self.success.file or ""],
                self.version,
            ]
        )
        return "command:" + hashlib.sha256(text.encode()).hexdigest()[:16]

    def require_names(self, unknown: Iterable[str], fixed: Iterable[str]) -> None:
        """Refuse templates with variables that are not inputs, and unknown inputs that no template uses."""
        scalars, templates = [name for name in unknown if name not in self._fields], [*self._parts.every_template()]
        fields = (word for name in self._fields for word in options.words_of_field(name))
        known = {*scalars, *fields, *fixed, PYTHON}
        for template in templates:
            template.require_known(known)
        for name in scalars:
            if not any(name in template.names for template in templates):
                what = f"the input {name} is used in no template and no command"
                expected, remedy = f"{{{{ {name} }}}} somewhere", f"Put it there, or remove {name} from inputs."
                raise unfit(what, "an input without effect", expected, remedy)

    def with_field(self, name: str, points: Float[np.ndarray, "point xyz"]) -> "CommandModel":
        """Return the model that takes an input as a field; refuse one that no template uses as such."""
        words = options.words_of_field(name)
        used = any(word in template.names for word in words for template in self._parts.every_template())
        expected = " or ".join(f"{{{{ {word} }}}}" for word in words) + " in a template"
        require(used, f"the field {name}", "used in no template and no command", expected, "Put one of them there.")
        found = copy.copy(self)
        object.__setattr__(found, "_fields", {**self._fields, name: points})
        return found

    def __call__(self, inputs: Mapping[str, Any], workdir: Path) -> Simulation:
        """Run the command in `workdir`; return its interfaces; a failure has kind, state and the last lines printed."""
        values, parts = self.values_in(inputs, workdir), self._parts
        self._fill(workdir, values)
        own = {**os.environ, **{name: item.rendered(values) for name, item in parts.environment.items()}}
        started = _now(workdir)
        deadline = None if self.timeout is None else time.monotonic() + self.timeout
        log = ""
        try:
            for number, command in enumerate(parts.commands):
                arguments = [item.rendered(values) for item in command]
                run = ["/bin/sh", "-c", *arguments] if self.shell and number == 0 else arguments
                left = None if deadline is None else max(0.0, deadline - time.monotonic())
                output = workdir / (LOG if number == 0 else f"post-{number}.log")
                ended = supervised(run, folder=workdir, environment=own, timeout=left, grace=self.grace, log=output)
                log = ended.tail or log
                self._require_success(ended, arguments[0])
            if self.success is not None:
                self.success.require(workdir, workdir / LOG)
            found = {name: options.read_result(one, workdir, started) for name, one in parts.readings.items()}
            return Simulation(found)
        except ForwardModelError as error:
            error.log = error.log or log
            raise options.named_by(self.errors, workdir, error) from None

    def retain(self, workdir: Path, key: str, *, ok: bool) -> Path | None:
        """Keep the folder of the run `key` if `keep` asks for it and return its new path; else return None."""
        if self.keep == "none" or (self.keep == "failed" and ok):
            return None
        return options.kept_folder(workdir, self.folder, key)

    def values_in(self, inputs: Mapping[str, Any], workdir: Path) -> dict[str, Any]:
        """Return the values of the templates' variables; write the files of fields into the folder of a run."""
        values: dict[str, Any] = {PYTHON: sys.executable}
        for name, value in inputs.items():
            if name in self._fields:
                file, content, listed = options.rendered_field(name, value, self._fields[name])
                (workdir / file).write_text(content, encoding="utf-8")
                values |= zip(options.words_of_field(name), (file, listed), strict=True)
            else:
                values[name] = float(value)
        return values

    def _fill(self, workdir: Path, values: Mapping[str, Any]) -> None:
        for target, template in self._parts.templates:
            path = workdir / target
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(template.rendered(values), encoding="utf-8", newline="")
        for file in self._parts.files:
            file.require_unchanged()
            path = workdir / file.name
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(file.path, path)

    def _require_success(self, ended: ProcessEnd, program: str) -> None:
        if ended.problem:
            message = f"{program} cannot be started: {ended.problem}{self._way_to_start(program)}"
            raise ForwardModelError("command_not_found", message)
        if ended.timed_out:
            message = f"still running after {self.timeout:g} s, and ended with all its processes"
            raise ForwardModelError("timeout", message)
        codes, code = self._parts.exit_codes, ended.exit_code
        if code in (-signal.SIGKILL, KILLED_IN_A_SHELL) and code not in (codes or ()):
            kind, why = "simulator_killed", ": something killed it from outside"
            if ended.out_of_memory:
                kind, why = "out_of_memory", " while the machine was out of memory"
            message = f"{program} ended with {how_it_ended(code)}{why}"
            raise ForwardModelError(kind, message, {"exit_code": float(code or 0)}, state="killed")
        if code is None or (codes is not None and code not in codes):
            evidence = {} if code is None else {"exit_code": float(code)}
            raise ForwardModelError("exit_code", f"{program} ended with {how_it_ended(code)}", evidence)

    def _way_to_start(self, program: str) -> str:
        """Return what lets a program of the study folder start, as the end of a message; nothing for other programs."""
        name = PurePosixPath(program)
        if name.is_absolute() or not (self.folder / name).is_file():
            return ""
        copied = str(name) in [file.name for file in self._parts.files]
        steps = [] if copied else ["add it to `files`, which copies it into the folder of the run"]
        steps += [] if program.startswith("./") else [f"write ./{program} in the command"]
        steps += [] if os.access(self.folder / name, os.X_OK) else [f"make it executable: chmod +x {name}"]
        return f"; {name} lies in the study folder: {', '.join(steps)}" if steps else ""


class _Parts:
    """The checked options and the text of the templates, so that later changes of the folder affect no campaign."""

    def __init__(self, model: CommandModel) -> None:
        for name, value in (("timeout", model.timeout), ("grace", model.grace)):
            if value is not None and not 0 < value <= LONGEST_SECONDS:
                raise unfit(name, value, f"seconds above 0, at most {LONGEST_SECONDS} (a year)")
        if not all(text and kind.isidentifier() and kind not in KINDS for kind, text in model.errors.items()):
            expected = "a new word for each kind and a text, e.g. {diverged: no convergence}"
            raise unfit("errors", dict(model.errors), expected)
        if not isinstance(model.files, list | tuple):
            raise unfit("files", model.files, "a list of names", "Write `files: [mesh.msh]`.")
        targets = [options.relative_name(target, "templates") for target in model.templates.values()]
        files = [options.SourceFile(model.folder, name, "files") for name in model.files]
        _require_distinct([*targets, *(options.relative_name(file.name, "files") for file in files)])
        named = zip(targets, model.templates, strict=True)
        self.templates, self.files = [(target, _read(model.folder, name)) for target, name in named], files
        self.commands = options.commands_of(model.command, model.post, shell=model.shell)
        self.environment = options.environment_of(model.environment)
        self.readings = options.readings_of(model.result, model.results)
        self.exit_codes = options.exit_codes_of(model.exit_codes)

    def every_template(self) -> Iterator[options.InputTemplate]:
        yield from (template for _, template in self.templates)
        yield from (item for command in self.commands for item in command)
        yield from self.environment.values()


def _read(folder: Path, name: str) -> options.InputTemplate:
    path = options.file_in(folder, name, "templates")
    try:
        return options.InputTemplate(name, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise unfit(f"the template {name} cannot be read", str(error), "a text file in UTF-8") from None


def _require_distinct(targets: list[str]) -> None:
    reserved = {LOG} | {f"post-{number}.log" for number in range(1, 10)}
    for k, target in enumerate(targets):
        if target in targets[:k] or target in reserved:
            found = f"{target} {'for the second time' if target in targets[:k] else 'is written by strandline'}"
            expected = "each name in the folder of the run once"
            raise unfit("templates and files", found, expected, "Choose another name.")


def _now(workdir: Path) -> int:
    """Return the time by the clock of the folder's file system, nanoseconds."""
    stamp = workdir / ".started"
    stamp.touch()
    now = stamp.stat().st_mtime_ns
    stamp.unlink()
    return now


def supervised(
    arguments: Sequence[str],
    *,
    folder: Path,
    environment: Mapping[str, str],
    timeout: float | None,
    grace: float,
    log: Path,
) -> ProcessEnd:
    """Run a command in `folder`, without a shell, to its end; no process that it started remains afterwards.

    `environment` is complete. After `timeout` seconds (None: no limit) it is ended by SIGTERM and, `grace` seconds
    later, by SIGKILL. The file `log` gets its output, at most twice `LOG_LIMIT` bytes. Raises ForwardModelError:
    ``supervisor_died`` or ``out_of_memory``, both with the state ``killed``; ``processes_left``.
    """
    limits: dict[str, Any] = {"timeout": timeout, "grace": grace, "log": str(log), "log_limit": LOG_LIMIT}
    asked = {"arguments": list(arguments), "environment": dict(environment), **limits}
    process = _started(folder, environment)
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(asked).encode() + b"\n")
                process.stdin.flush()
            answer = process.stdout.read()
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
    return _ended(answer, process.returncode, log)


def _started(folder: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    command, pipe, own = [sys.executable, "-I", "-S", str(SUPERVISOR)], subprocess.PIPE, dict(environment)
    try:
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, cwd=folder, env=own, start_new_session=True)
    except OSError as error:
        if error.errno in SHORT_OF_MEMORY:
            raise _no_room(error.strerror or str(error)) from None
        raise


def _ended(answer: bytes, code: int, log: Path) -> ProcessEnd:
    try:
        told: dict[str, Any] = json.loads(answer)
    except ValueError:  # nothing, or the beginning of an answer
        how = how_it_ended(code)
        message = f"the process that watches over the simulator ended with {how}, and the simulator with it"
        raise ForwardModelError("supervisor_died", message, state="killed", log=end_of(log)) from None
    if told.get("errno") in SHORT_OF_MEMORY:
        raise _no_room(told["error"])
    if "error" in told:
        return ProcessEnd(None, False, "", told["error"])
    if told["left"]:
        message = f"{told['left']} process(es) of the simulator survive SIGKILL"
        raise ForwardModelError("processes_left", message, log=told["tail"])
    return ProcessEnd(told["exit_code"], told["timeout"], told["tail"], out_of_memory=told["out_of_memory"])


def _no_room(reason: str) -> ForwardModelError:
    message = f"the system had no room for the simulator's process: {reason}"
    return ForwardModelError("out_of_memory", message, state="killed")
