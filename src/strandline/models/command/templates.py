"""Texts that contain inputs: sandboxed Jinja2, with every variable checked before the first run."""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import jinja2
from jinja2 import meta, nodes
from jinja2.sandbox import ImmutableSandboxedEnvironment

from strandline.errors import ForwardModelError, InvalidInput

__all__ = ["Template"]

LONGEST = 20
"""Characters of a number: CalculiX 2.20 looks at no more, and so loses the exponent of 3.141592653589793e-05 in silence
(findings/calculix-twenty-characters.sh)."""


@dataclass(frozen=True)
class Template:
    """A text that contains inputs as ``{{ name }}``; numbers are written in at most 20 characters.

    Args:
        place: Name of the text in messages, e.g. the name of the file.
        text: Text of the template.

    Raises:
        InvalidInput: a mistake in the text; the message names the line.
    """

    place: str
    text: str

    def __post_init__(self) -> None:
        try:
            _compiled(self.text)
        except jinja2.TemplateSyntaxError as error:
            raise InvalidInput(
                f"{self.place}, line {error.lineno}",
                value=error.message,
                expected="a Jinja2 template",
                remedy="Correct the line; {% raw %}…{% endraw %} keeps braces as they are.",
            ) from None
        except (RecursionError, SyntaxError, MemoryError, OverflowError, ValueError) as error:
            raise InvalidInput(
                f"the template {self.place} cannot be compiled",
                value=f"{type(error).__name__}: {error}",
                expected="expressions of ordinary depth and size",
                remedy="Simplify the expressions between braces.",
            ) from None

    @property
    def names(self) -> frozenset[str]:
        """The variables that must be given."""
        return frozenset(meta.find_undeclared_variables(_environment().parse(self.text)) - set(_environment().globals))

    def require_known(self, names: Iterable[str]) -> None:
        """Refuse variables other than `names`.

        Raises:
            InvalidInput: There is one; the message names the first and its line.
        """
        known = set(names)
        for name in sorted(self.names - known):
            found = _environment().parse(self.text).find_all(nodes.Name)
            line = min((node.lineno for node in found if node.name == name), default=1)
            raise InvalidInput(
                f"{self.place}, line {line}: unknown variable",
                value=name,
                expected=f"one of {', '.join(sorted(known))}",
                remedy=f"Correct the name, or add {name} to inputs or fixed.",
            )

    def rendered(self, values: Mapping[str, Any]) -> str:
        """Return the text with `values` filled in.

        Raises:
            ForwardModelError: ``template``.
        """
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
