"""What is wrong with a value, a name, options or a file, refused in one way: what, found, expected, what to do.

And objects by their name in a registry, which is a dict, or by ``module:name`` for third parties.
"""

import dataclasses
import importlib
import math
import sys
import traceback
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeGuard, get_args, get_origin, get_type_hints

from strandline.foundations.errors import InvalidInput
from strandline.foundations.text import LONGEST, is_label, is_name

LARGEST = 1 << 23
"""Bytes of a file with a path or with clicks that is read."""
OTHER = "Choose another one."
MISSING = "Correct the name, install the module, or put its folder on PYTHONPATH."


def require(
    good: object, what: str, value: object, expected: str, remedy: str = OTHER, error: type[InvalidInput] = InvalidInput
) -> None:
    """Refuse what is not good."""
    if not good:
        raise error(what, value=value, expected=expected, remedy=remedy)


def require_types(record: Any) -> None:
    """Refuse a dataclass if a field holds another type than it states; numpy's numbers are numbers."""
    hints = get_type_hints(type(record))
    for one in dataclasses.fields(record):
        value, hint = getattr(record, one.name), hints[one.name]
        kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        if not any(_is_a(value, kind) for kind in kinds):
            raise unfit(one.name, repr(value) if isinstance(value, str) else value, " or ".join(map(_in_words, kinds)))


def _is_a(value: object, kind: Any) -> bool:
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    kind = get_origin(kind) or kind
    truth = isinstance(value, bool)
    return truth if kind is bool else not truth and isinstance(value, {int: Integral, float: Real}.get(kind, kind))


def _in_words(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return " or ".join(map(str, get_args(kind)))
    words = {int: "a whole number", float: "a number", str: "a text", bool: "True or False", NoneType: "None"}
    kind = get_origin(kind) or kind
    return words.get(kind, str(kind.__name__))


def unfit(what: str, value: object, expected: str, remedy: str = "") -> InvalidInput:
    """Return the error for something that cannot be used."""
    return InvalidInput(what, value=value, expected=expected, remedy=remedy or f"Correct {what.partition(':')[0]}.")


@contextmanager
def named(name: str, remedy: str = "") -> Iterator[None]:
    """Begin the message of an `InvalidInput` with a name; give it another remedy if there is one."""
    try:
        yield
    except InvalidInput as error:
        raise unfit(f"{name}: {error.what}", error.value, error.expected, remedy or error.remedy) from None


def content_of(path: Path, expected: str) -> bytes:
    """Return the contents of a small file, or refuse it; `expected` says what would be correct."""
    remedy = "Correct the file, or its name."
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise unfit("cannot be read", error.strerror or str(error), expected, remedy) from None
    if len(content) > LARGEST:
        raise unfit("size of the file", f"more than {LARGEST} bytes", expected, remedy)
    return content


def keys_of(options: object, known: Collection[str], place: str, example: str) -> Mapping[str, Any]:
    """Return `options` if they are keys with values and all keys are known.

    `options`: options as a study file gives them; `known`: names of the options that exist; `place`: place of the
    options in the study file; `example`: example of correct options, for the message.
    """
    if not isinstance(options, Mapping):
        raise unfit(place, options, f"keys with values, e.g. {example}")
    for name in options:
        if name not in known:
            remedy = suggestion(str(name), known, f"Remove {name}.")
            raise unfit(f"{place}: unknown option", name, f"one of {', '.join(known)}", remedy)
    return options


def is_finite(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a finite number; integers of hundreds of digits count as infinite."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def number(value: object, place: str, expected: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number from `low` to `high`; of another value `expected` says what would be correct."""
    if is_finite(value) and low <= value <= high:
        return float(value)
    raise unfit(place, value, expected)


def numbers(value: object, count: int, place: str, expected: str, limit: float = math.inf) -> tuple[float, ...]:
    """Return `count` finite numbers, at most `limit` in size."""
    if not (isinstance(value, list | tuple) and len(value) == count):
        raise unfit(place, value, expected)
    return tuple(number(one, place, expected, -limit, limit) for one in value)


def require_label(what: str, text: object) -> None:
    """Refuse a text that cannot be used in figures, tables and files; the message begins with `what`."""
    if not is_label(text):
        remedy = "Write it as plain text, e.g. mm²/s."
        raise unfit(what, text, f"at most {LONGEST} characters on one line, without $", remedy)


def require_name(what: str, text: object, *, reserved: Collection[str] = ()) -> None:
    """Refuse a text that cannot name an input, and the `reserved` names; the message begins with `what`."""
    if text in reserved:
        remedy = "Rename the input."
        raise unfit(what, text, f"none of the names that the results use themselves: {', '.join(reserved)}", remedy)
    if not is_name(text):
        expected = f"at most {LONGEST} characters on one line, without blanks at the ends and without / \\ = $"
        raise unfit(what, text or "an empty name", expected, "Rename the input.")


def lookup(registry: Mapping[str, Any], name: str, what: str) -> Any:
    """Return an entry of `registry`, or the object that ``module:name`` names.

    Args:
        registry: Entries by name: objects, or ``module:name`` of objects that are imported only when used.
        name: Name of an entry, or ``module:name``.
        what: What the entries are, for messages.

    Raises:
        InvalidInput: There is no such entry; the message suggests the closest one.
    """
    if name in registry:
        found = registry[name]
        return imported(found, what) if isinstance(found, str) else found
    if ":" in name:
        return imported(name, what)
    remedy = suggestion(name, registry, "Choose one of them.")
    raise InvalidInput(what, value=name, expected=f"one of {', '.join(registry)}, or module:name", remedy=remedy)


def imported(target: str, what: str, missing: str = MISSING) -> Any:
    """Return the object ``module:name``; `missing` is the remedy if there is none.

    Raises:
        InvalidInput: The module does not exist, or does not define the name.
    """
    refused = partial(InvalidInput, what, value=target)
    module, _, name = target.partition(":")
    if not (module and name):
        raise refused(expected="module:name, e.g. my_package.measures:Hausdorff", remedy=missing)
    try:
        found: Any = importlib.import_module(module)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        absent = error.name if isinstance(error, ModuleNotFoundError) else None
        if absent and f"{module}.".startswith(f"{absent}."):
            raise refused(expected=f"a module that can be imported ({why})", remedy=missing) from None
        place = traceback.extract_tb(error.__traceback__)[-1]
        at = "" if isinstance(error, SyntaxError) else f", in {Path(place.filename).name}, line {place.lineno}"
        remedy = f"Correct the module {module}{', or install what it imports' if absent else ''}."
        raise refused(expected=f"a module without mistakes ({why}{at})", remedy=remedy) from None
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is None:
        raise refused(expected=f"a name defined in {module}", remedy=f"Correct {name}.")
    return found


def of_extra(module: str, extra: str, what: str) -> Any:
    """Return a module that comes with an extra of the package.

    Raises:
        InvalidInput: It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        found, remedy = f"no module {error.name}", f'Install it: pip install "strandline[{extra}]"'
        raise InvalidInput(what, value=found, expected=f"the extra `{extra}`", remedy=remedy) from None


def suggestion(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return a question that suggests the known name closest to `name`; `otherwise` if none is close.

    The case of letters does not count. Words of one or two letters are close to none but themselves.
    """
    words = {one.lower(): one for one in known if min(len(one), len(name)) > 2 or one.lower() == name.lower()}
    close = get_close_matches(name.lower(), words, n=1)
    return f"Did you mean {words[close[0]]}?" if close else otherwise
