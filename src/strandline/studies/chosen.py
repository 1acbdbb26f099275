"""One named choice of the study file with its options: an entry of a registry, called with them."""

import contextlib
import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, get_args

from strandline.errors import InvalidInput, InvalidStudy
from strandline.registry import lookup, suggestion
from strandline.text import decimal


@contextlib.contextmanager
def refused_at(place: str = "") -> Iterator[None]:
    """Raise an `InvalidInput` again as `InvalidStudy`, with its place in the study file before its subject."""
    try:
        yield
    except InvalidInput as error:
        within = "." if re.match(r"[a-z_.]+(:|$)", error.what) else ": "
        what = f"{place}{within}{error.what}" if place else error.what
        raise InvalidStudy(what, value=error.value, expected=error.expected, remedy=error.remedy) from None


PLAIN_TYPES = {float: "a number", int: "a whole number", str: "a text"}


def entry(registry: Mapping[str, Any], name: str, place: str) -> Any:
    """Return the entry `name` of one of our own registries; refuse an unknown name and suggest the nearest one."""
    if name not in registry:
        raise InvalidStudy(
            place,
            value=name,
            expected=f"one of {', '.join(registry)}",
            remedy=suggestion(name, registry, "Choose one of them."),
        )
    return registry[name]


def open_entry(registry: Mapping[str, Any], name: str, place: str, protocol: str) -> Any:
    """Return the entry `name` of a registry, or the class ``module:name``.

    Args:
        registry: Entries by name.
        name: Name in the study file.
        place: Place in the study file.
        protocol: What the class must be, with its article, for messages.
    """
    with refused_at():
        found = lookup(registry, name, place)
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        raise InvalidStudy(
            place,
            value=name,
            expected=f"a dataclass that is {protocol}: its fields are the options",
            remedy="Decorate the class with @dataclass(frozen=True).",
        )
    return found


def require_parts(entry: object, parts: Iterable[str], place: str) -> None:
    """Refuse an object that lacks some of these parts."""
    missing = [name for name in parts if not hasattr(entry, name)]
    if missing:
        raise InvalidStudy(
            place,
            value=f"a class without {', '.join(missing)}",
            expected=f"the parts {', '.join(parts)}",
            remedy="Add what is missing; the conformance suite in strandline.testing says what it must do.",
        )


def construct(factory: Any, options: Mapping[str, Any] | None, place: str, **given: Any) -> Any:
    """Call a frozen dataclass, or its `from_options`, with options from the study; wrong names are refused.

    Arguments in `given` are not options.
    """
    fields = {f.name: f for f in dataclasses.fields(factory) if f.init and f.name not in given}
    values = {}
    for name, value in dict(options or {}).items():
        if name not in fields:
            raise InvalidStudy(
                f"{place}: unknown option",
                value=name,
                expected=f"one of {', '.join(fields)}" if fields else "no options",
                remedy=suggestion(name, fields, f"Remove {name}."),
            )
        values[name] = _option(value, fields[name].type, f"{place}.{name}")
    for name, field in fields.items():
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if required and name not in values:
            raise InvalidStudy(
                f"{place}.{name}", value=None, expected="this option", remedy=f"Add `{name}: …` to {place}."
            )
    try:
        with refused_at(place):
            return getattr(factory, "from_options", factory)(**values, **given)
    except InvalidStudy:
        raise
    except (TypeError, ValueError) as error:
        raise InvalidStudy(
            place, value=options, expected=" ".join(str(error).split()), remedy=f"Correct the options of {place}."
        ) from None


def in_words(chosen: Any) -> str:
    """Return the options of an object in words: ``Uniform: low 100, high 800``."""
    if not dataclasses.is_dataclass(chosen):
        return repr(chosen)
    options = ((field.name, getattr(chosen, field.name)) for field in dataclasses.fields(chosen))
    shown = ", ".join(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in options)
    return f"{type(chosen).__name__}: {shown}" if shown else type(chosen).__name__


def _option(value: Any, annotation: Any, place: str) -> Any:
    """Return an option converted to its plain type; other types are left to the class."""
    kinds = [kind for kind in get_args(annotation) or (annotation,) if kind is not type(None)]
    if kinds == [float]:
        number = decimal(value) if isinstance(value, str) else value
        if isinstance(number, int | float) and not isinstance(number, bool):
            with contextlib.suppress(OverflowError):
                return float(number)
    elif kinds not in ([int], [str]) or (isinstance(value, kinds[0]) and not isinstance(value, bool)):
        return value
    raise InvalidStudy(place, value=value, expected=PLAIN_TYPES[kinds[0]], remedy=f"Correct {place}.")
