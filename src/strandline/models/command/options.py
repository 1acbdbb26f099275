"""Options of a command in study.yaml → checked values, with one clear line for each mistake."""

import math
from collections.abc import Collection, Mapping
from typing import Any

from strandline.errors import InvalidInput
from strandline.models.command.templates import Template
from strandline.models.protocol import ModelInput
from strandline.text import decimal

__all__ = ["commands_of", "declared_by", "errors_of", "exit_codes_of", "seconds", "texts_of"]

LONGEST_SECONDS = 366 * 24 * 3600
DECLARED = {"unit", "low", "high", "meaning"}


def commands_of(command: object, post: object, *, shell: bool) -> tuple[tuple[Template, ...], ...]:
    """Return the commands of a run as templates of their arguments.

    Raises:
        InvalidInput: not a list of texts; a text without `shell`, or a list with it.
    """
    if shell:
        if not isinstance(command, str) or not command.strip():
            raise _unfit("command", command, "with `shell: true` one text for /bin/sh")
        first: tuple[Template, ...] = (Template("command", command),)
    else:
        first = _arguments(command, "command")
    if not isinstance(post, list | tuple):
        raise _unfit("post", post, 'a command such as ["python", "extract.py"], or a list of commands')
    several = [post] if post and not isinstance(post[0], list | tuple) else list(post)
    return (first, *(_arguments(one, "post") for one in several))


def _arguments(command: object, place: str) -> tuple[Template, ...]:
    if not (isinstance(command, list | tuple) and command and all(_is_word(item) for item in command)):
        raise _unfit(place, command, 'program and arguments as a list, e.g. ["ccx", "-i", "model"]')
    return tuple(Template(place, str(item)) for item in command)


def texts_of(given: object, place: str) -> dict[str, str]:
    """Return a mapping of texts; numbers become texts.

    Raises:
        InvalidInput: anything else.
    """
    fits = isinstance(given, Mapping) and all(isinstance(k, str) and _is_word(v) for k, v in given.items())
    if not (fits and isinstance(given, Mapping)) or any(
        "\0" in f"{k}{v}" or "=" in k or not k for k, v in given.items()
    ):
        raise _unfit(place, given, "names with texts, e.g. {NAME: text}")
    return {name: str(value) for name, value in given.items()}


def errors_of(given: object, known: Collection[str]) -> dict[str, str]:
    """Return the text that names each further kind of failure.

    Raises:
        InvalidInput: anything else, or a kind of this name exists already.
    """
    found = texts_of(given, "errors")
    if not all(text and kind.isidentifier() and kind not in known for kind, text in found.items()):
        raise _unfit("errors", given, "a new word for each kind and a text, e.g. {diverged: no convergence}")
    return found


def exit_codes_of(given: object) -> frozenset[int] | None:
    """Return the exit codes that count as success; None for all.

    Raises:
        InvalidInput: anything else.
    """
    if given == "any":
        return None
    if isinstance(given, list | tuple) and given and all(type(code) is int for code in given):
        return frozenset(given)
    raise _unfit("exit_codes", given, "a list such as [0, 1], or any")


def seconds(name: str, value: object) -> None:
    """Refuse anything but a number of seconds above 0, or None.

    Raises:
        InvalidInput: It is something else; the message shows the value.
    """
    if value is not None and not (isinstance(value, int | float) and 0 < value <= LONGEST_SECONDS):
        raise _unfit(name, value, f"seconds above 0, at most {LONGEST_SECONDS} (a year)")


def declared_by(given: object) -> tuple[ModelInput, ...]:
    """Return the inputs that a study file declares.

    Raises:
        InvalidInput: a declaration that cannot be understood.
    """
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
            value = _number_in(value, place)
        if not isinstance(value, int | float) or isinstance(value, bool) or math.isnan(value):
            raise _unfit(f"{place}.{key}", value, "a number")
        bounds.append(float(value))
    low, high = bounds
    if not low < high:
        raise _unfit(place, bounds, "low below high")
    return ModelInput(name, str(options.get("unit", "1")), low, high, meaning=str(options.get("meaning", "")))


def _number_in(text: str, place: str) -> float:
    number = decimal(text)
    if number is None:
        raise _unfit(place, text, "a number")
    return number


def _is_word(value: object) -> bool:
    return isinstance(value, str | int | float) and not isinstance(value, bool) and "\0" not in str(value)


def _unfit(what: str, value: object, expected: str) -> InvalidInput:
    return InvalidInput(what, value=value, expected=expected, remedy=f"Correct `{what.partition('.')[0]}`.")
