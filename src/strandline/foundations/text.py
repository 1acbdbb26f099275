"""Names, units and numbers: what a person writes, checked so that a mistake is one line, and as a reader expects them.

Files and options are checked too. ``mm^2/s`` is shown as mm² s⁻¹, ``V_in`` with a subscript.
"""

import html
import math
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

from strandline.foundations.errors import InvalidInput
from strandline.foundations.registry import suggestion

LONGEST = 64
"""Maximum number of characters in a name or a unit."""
NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
NOT_IN_NAMES = frozenset("/\\=$")


def is_label(text: object) -> bool:
    """Return whether `text` suits figures, tables and files: short, on one line, without the `$` of formulas."""
    return isinstance(text, str) and len(text) <= LONGEST and text.isprintable() and "$" not in text


def is_name(text: object) -> bool:
    """Return whether `text` can name an input: a label that works in netCDF files and in ``--set NAME=NUMBER``."""
    return (
        isinstance(text, str)
        and is_label(text)
        and text == text.strip()
        and text not in ("", ".", "..")
        and not NOT_IN_NAMES & set(text)
    )


def listed(words: Sequence[str], last: str = "and") -> str:
    """Return one or more words as a list in a sentence: ``a, b and c``; `last` is the word before the last one."""
    *others, end = words
    return f"{', '.join(others)} {last} {end}" if others else end


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


def decimal(text: str) -> float | None:
    """Return `text` as a number if it consists of the digits 0 to 9 with a point and an exponent, else None.

    ``float`` alone would read ``1_0`` as 10, and accept the digits of any script, ``nan`` and ``inf``.
    """
    return float(text) if NUMBER.fullmatch(text) else None


def with_sd(mean: float, sd: float) -> str:
    """Return mean ± sd; the mean has as many decimals as the standard deviation, which has two significant digits or,
    from 100, all those before the point."""
    if not 1e-4 <= sd < 1e6:
        return f"{mean:.4g} ± {sd:.2g}"
    width = f"{sd:.0f}" if sd >= 10 else f"{sd:.2g}"
    decimals = len(width.partition(".")[2])
    return f"{round(mean, decimals) + 0.0:.{decimals}f} ± {width}"  # a mean of zero has no sign


RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LEVEL = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_FACTOR = re.compile(r"([^\W\d_]+|%|°|1)(?:\^?(-?\d+))?")
_SPACE = "\u00a0"


def unit_text(unit: str, *, inverse: bool = False) -> str:
    """Return a unit with superscript exponents, negative ones for divisors; unchanged if it cannot be parsed.

    ``mm^2/s`` becomes ``mm² s⁻¹``, ``1/Pa`` becomes ``Pa⁻¹``; a pure number has none. Spaces in it are non-breaking.
    With `inverse`, return one over the unit, as for a density.
    """
    plain = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: "^" + found[0].translate(_LEVEL), unit.strip()).replace("**", "^")
    if plain in ("", "1"):
        return ""
    factors = _factors(plain)
    if factors is None:
        text = unit.strip().replace(" ", _SPACE)
        return f"1/({text})" if inverse else text
    powers = [(name, -power if inverse else power) for name, power in factors]
    return _SPACE.join(name if power == 1 else f"{name}{str(power).translate(RAISED)}" for name, power in powers)


def _factors(unit: str) -> list[tuple[str, int]] | None:
    """Return the factors of a unit and their powers; None if it is not a product of powers."""
    out: list[tuple[str, int]] = []
    for number, divided in enumerate(re.split(r"\s*/\s*", unit)):
        grouped = re.fullmatch(r"\((.*)\)", divided)
        if "(" in divided and (grouped is None or number == 0):
            return None
        for factor in re.split(r"[\s*·]+", (grouped[1] if grouped else divided).strip()):
            found = _FACTOR.fullmatch(factor)
            if found is None or (number > 0 and found[1] == "1"):
                return None
            power = int(found[2] or 1)
            if found[1] != "1" and power != 0:
                out.append((found[1], power if number == 0 else -power))
    return out or None


def figure_text(symbol: str) -> str:
    """Return a symbol for Matplotlib: the part after an underscore becomes a subscript, ``$`` stays a dollar sign."""
    base, _, index = symbol.partition("_")
    if not base or not index or not re.fullmatch(r"[\w,]+", index):
        return symbol.replace("$", r"\$")
    return base.replace("$", r"\$") + r"$_{\mathrm{" + index.replace("_", r"\_") + "}}$"


def html_text(symbol: str) -> str:
    """Return a symbol as escaped HTML: the part after an underscore becomes a subscript."""
    base, _, index = symbol.partition("_")
    if not base or not index:
        return html.escape(symbol)
    return f"{html.escape(base)}<sub>{html.escape(index)}</sub>"


def html_table(head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "") -> str:
    """Return a plain HTML table; cells are HTML, head and caption are text."""
    top = "".join(f"<th>{html.escape(cell)}</th>" if cell else "<td></td>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


LARGEST = 1 << 23
"""Bytes of a file with a path or with clicks that is read."""


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
