"""Checks of the options that a study gives for a picture; a mistake is one line."""

import math
from collections.abc import Collection, Mapping
from typing import Any

from strandline.errors import InvalidInput
from strandline.registry import suggestion

__all__ = ["keys_of", "number", "pair", "unfit", "word"]


def unfit(what: str, value: object, expected: str, remedy: str = "") -> InvalidInput:
    """Return the error for an option that cannot be used."""
    return InvalidInput(what, value=value, expected=expected, remedy=remedy or f"Correct {what.partition(':')[0]}.")


def keys_of(options: object, known: Collection[str], place: str, example: str) -> Mapping[str, Any]:
    """Return `options` if they are keys with values and all keys are known.

    Args:
        options: Options as a study file gives them.
        known: Names of the options that exist.
        place: Place of the options in the study file.
        example: Example of correct options, for the message.

    Raises:
        InvalidInput: They are not; the message suggests the closest key.
    """
    if not isinstance(options, Mapping):
        raise unfit(place, options, f"keys with values, e.g. {example}")
    for name in options:
        if name not in known:
            remedy = suggestion(str(name), known, f"Remove {name}.")
            raise unfit(f"{place}: unknown option", name, f"one of {', '.join(known)}", remedy)
    return options


def number(value: object, place: str, expected: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number from `low` to `high`.

    Raises:
        InvalidInput: It is another value; `expected` says what would be correct.
    """
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and low <= value <= high:
        return float(value)
    raise unfit(place, value, expected)


def pair(value: object, place: str, expected: str) -> tuple[float, float]:
    """Return two finite numbers.

    Raises:
        InvalidInput: It is another value.
    """
    if not (isinstance(value, list | tuple) and len(value) == 2):
        raise unfit(place, value, expected)
    first, second = (number(one, place, expected) for one in value)
    return first, second


def word(value: object, known: Collection[str], place: str) -> str:
    """Return one of the known words.

    Raises:
        InvalidInput: It is another value; the message suggests the closest word.
    """
    if isinstance(value, str) and value in known:
        return value
    text = next((name for name in known if name.lower() == str(value).lower()), str(value))
    raise unfit(place, value, f"one of {', '.join(known)}", suggestion(text, known, f"Correct {place}."))
