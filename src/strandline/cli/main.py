"""The command `strandline`: its subcommands, loaded when called, and how errors and signals end it."""

import contextlib
import importlib
import os
import re
import shlex
import signal
import sys
import threading
from pathlib import Path
from typing import Any

import click

from strandline.cli.questions import QUESTIONS
from strandline.foundations import InvalidInput, StrandlineError, __version__, suggestion

MOST_DEVICES = 8
"""Largest number of cores over which the sampler's particles are spread."""
ENDINGS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
COMMANDS = {
    "init": "Write a commented study folder that runs.",
    "noise": "Estimate the noise of an observation from its contours.",
    "image": "Find the edge in the picture of a study.",
    "check": "Validate a study and make one forward run.",
    "run": "Do the whole study; go on where it was stopped.",
    "retry": "Make failed runs again, then the rest of the study.",
    "view": "Show a study in the browser, while its runs are made and after.",
    "status": "Show how many runs are done, and how the others ended.",
    "runs": "List the runs of a study, show one in full, export them.",
    "doctor": "Look for damage, gaps and drift in a study folder.",
    "backup": "Copy a study's ledger, while it may be running.",
    "report": "Write posterior, figures and report again from finished runs.",
    **QUESTIONS,
    "forward": "Make one forward run at chosen inputs.",
    "serve": "Serve a study's model to other programs, by UM-Bridge.",
}
FILES = dict.fromkeys(QUESTIONS, "questions")
FILES |= {"retry": "run", "report": "run", "status": "runs", "doctor": "runs", "backup": "runs"}
FILES |= {"noise": "observation", "image": "observation", "view": "serve"}
"""Modules of the commands that are not called like them."""


def command_named(name: str) -> click.Command:
    """Return one of `COMMANDS`."""
    module = importlib.import_module(f"strandline.cli.{FILES.get(name, name)}")
    return next(one for one in vars(module).values() if isinstance(one, click.Command) and one.name == name)


class EndedBySignal(KeyboardInterrupt):
    """A signal that ends the command; `number` is the signal's number."""

    def __init__(self, number: int) -> None:
        self.number = signal.Signals(number)
        super().__init__(self.number.name)


def end_as_ctrl_c() -> None:
    """Make SIGTERM and SIGHUP raise `EndedBySignal` unless they are ignored, as under ``nohup``.

    Only the first signal counts: later ones, such as those when a terminal closes, do not disturb the cleanup.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in ENDINGS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end_once)


def _end_once(number: int, _frame: Any) -> None:
    for each in ENDINGS:
        with contextlib.suppress(ValueError):
            signal.signal(each, signal.SIG_IGN)
    raise EndedBySignal(number)


class _Interrupted(BaseException):
    """Ctrl-C or another signal, its cause, hidden from click, which would print an extra empty line."""


class _LazyGroup(click.Group):
    """A group that knows its commands by name and imports only the one that is called."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as cause:
            raise _Interrupted from cause

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return command_named(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """Return the command that is called; suggest the nearest one if there is none of this name."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            hint = suggestion(args[0], COMMANDS, "")
            raise click.UsageError(f"{error.message} {hint}".rstrip(), ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group("strandline", cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="strandline")
def _group() -> None:
    """Bayesian calibration of computational-mechanics models from the shape of an interface.

    A study is a folder with a file study.yaml. Start with `strandline init my-study`.
    """


def main(arguments: list[str] | None = None, *, command: click.Command | None = None) -> None:
    """Run the command line; exit codes: 0 done, 1 numerics failed, 2 bad input, 128 + n ended by signal n.

    Args:
        arguments: Words after the program's name; those of this process if omitted.
        command: Another click command to run in the same way; the group `strandline` by default.
    """
    end_as_ctrl_c()
    for name, value in environment().items():
        os.environ.setdefault(name, value)
    try:
        _call(command or _group, arguments)
    except StrandlineError as error:
        words = sys.argv[1:] if arguments is None else arguments
        study = next((word for word in words if _is_study(word)), "STUDY")
        told = re.sub(r"\bSTUDY\b", lambda _: shlex.quote(study), str(error))
        _end(told, 2 if isinstance(error, InvalidInput) else 1)
    except BrokenPipeError:
        sys.stderr.close()
        raise SystemExit(0) from None
    except (KeyboardInterrupt, _Interrupted) as ended:
        cause = ended.__cause__ if isinstance(ended, _Interrupted) else ended
        number = cause.number if isinstance(cause, EndedBySignal) else signal.SIGINT
        by = f" by {number.name}" if isinstance(cause, EndedBySignal) else ""
        _end(f"interrupted{by}; what is finished is kept; run the same command again to go on", 128 + number)


def _is_study(word: str) -> bool:
    with contextlib.suppress(OSError):  # a word too long for a file
        return Path(word, "study.yaml").is_file()
    return False


def environment() -> dict[str, str]:
    """Return defaults for the libraries' environment variables; JAX reads them when it is first imported.

    Compiled programs are cached, so that the second analysis of a study does not compile again.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return {
        "JAX_ENABLE_X64": "1",
        "JAX_PLATFORMS": "cpu",
        "JAX_NUM_CPU_DEVICES": str(min(os.cpu_count() or 1, MOST_DEVICES)),
        "JAX_COMPILATION_CACHE_DIR": str(home / "strandline" / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.02",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "MPLBACKEND": "Agg",
    }


def _call(command: click.Command, arguments: list[str] | None) -> Any:
    if "" in (sys.argv[1:] if arguments is None else arguments):
        _end("an argument is empty: got ''; expected a name or a value. Is a variable of the shell unset?", 2)
    try:
        return command.main(args=arguments, prog_name=command.name, standalone_mode=False)
    except click.exceptions.Exit as ended:
        raise SystemExit(ended.exit_code) from None
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        raise SystemExit(2) from None
    except click.Abort:
        raise KeyboardInterrupt from None
    except click.UsageError as error:
        where = error.ctx.command_path if error.ctx else "strandline"
        told = re.sub(r"\s*\n\s*", " ", error.format_message())
        _end(f"{told}{'' if told.endswith(('.', '?')) else '.'} See `{where} --help`.", 2)
    except click.ClickException as error:
        _end(error.format_message(), 2)


def _end(message: str, code: int) -> None:
    click.echo(f"strandline: {message}", err=True)
    raise SystemExit(code)
