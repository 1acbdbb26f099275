"""Options of a command in study.yaml → checked values, and the templates with the inputs."""

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jinja2
from jinja2 import meta, nodes
from jinja2.sandbox import ImmutableSandboxedEnvironment

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models import refused
from strandline.models.protocol import ModelInput
from strandline.text import decimal

LONGEST = 20
"""Characters of a number: CalculiX 2.20 looks at no more, and so loses the exponent of 3.141592653589793e-05 in silence
(findings/calculix-twenty-characters.sh)."""
DECLARED = {"unit", "low", "high", "meaning"}


@dataclass(frozen=True)
class InputTemplate:
    """A text that contains inputs as ``{{ name }}``; numbers are written in at most 20 characters.

    `place` is the name of the text in messages, e.g. that of the file.
    """

    place: str
    text: str

    def __post_init__(self) -> None:
        try:
            _compiled(self.text)
        except jinja2.TemplateSyntaxError as error:
            remedy = "Correct the line; {% raw %}…{% endraw %} keeps braces as they are."
            raise refused(f"{self.place}, line {error.lineno}", error.message, "a Jinja2 template", remedy) from None
        except (RecursionError, SyntaxError, MemoryError, OverflowError, ValueError) as error:
            what, found = f"the template {self.place} cannot be compiled", f"{type(error).__name__}: {error}"
            remedy = "Simplify the expressions between braces."
            raise refused(what, found, "expressions of ordinary depth and size", remedy) from None

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
            expected, remedy = (
                f"one of {', '.join(sorted(known))}",
                f"Correct the name, or add {name} to inputs or fixed.",
            )
            raise refused(f"{self.place}, line {line}: unknown variable", name, expected, remedy)

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


def commands_of(command: object, post: object, *, shell: bool) -> tuple[tuple[InputTemplate, ...], ...]:
    """Return the commands of a run as templates of their arguments."""
    if shell:
        if not isinstance(command, str) or not command.strip():
            raise _unfit("command", command, "with `shell: true` one text for /bin/sh")
        first: tuple[InputTemplate, ...] = (InputTemplate("command", command),)
    else:
        first = _arguments(command, "command")
    if not isinstance(post, list | tuple):
        raise _unfit("post", post, 'a command such as ["python", "extract.py"], or a list of commands')
    several = [post] if post and not isinstance(post[0], list | tuple) else list(post)
    return (first, *(_arguments(one, "post") for one in several))


def _arguments(command: object, place: str) -> tuple[InputTemplate, ...]:
    if not (isinstance(command, list | tuple) and command and all(_is_word(item) for item in command)):
        raise _unfit(place, command, 'program and arguments as a list, e.g. ["ccx", "-i", "model"]')
    return tuple(InputTemplate(place, str(item)) for item in command)


def texts_of(given: object, place: str) -> dict[str, str]:
    """Return a mapping of texts; numbers become texts."""
    fits = isinstance(given, Mapping) and all(isinstance(k, str) and _is_word(v) for k, v in given.items())
    if not (fits and isinstance(given, Mapping)) or any(
        "\0" in f"{k}{v}" or "=" in k or not k for k, v in given.items()
    ):
        raise _unfit(place, given, "names with texts, e.g. {NAME: text}")
    return {name: str(value) for name, value in given.items()}


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
    return refused(what, value, expected, f"Correct `{what.partition('.')[0]}`.")
