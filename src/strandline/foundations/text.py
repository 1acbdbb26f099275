"""Names, units and numbers as a person writes them and as a reader expects them.

``mm^2/s`` is shown as mm² s⁻¹, ``V_in`` with a subscript.
"""

import html
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeGuard

LONGEST = 64
"""Maximum number of characters in a name or a unit."""
NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
NOT_IN_NAMES = frozenset("/\\=$")
MOST_NUMBERED = 12
"""Inputs of one name with a number, as E_7, up to which a text lists each."""


def is_label(text: object) -> TypeGuard[str]:
    """Return whether `text` suits figures, tables and files: short, on one line, without the `$` of formulas."""
    return isinstance(text, str) and len(text) <= LONGEST and text.isprintable() and "$" not in text


def is_name(text: object) -> bool:
    """Return whether `text` can name an input: a label that works in netCDF files and in ``--set NAME=NUMBER``."""
    return is_label(text) and text == text.strip() and text not in ("", ".", "..") and not NOT_IN_NAMES & set(text)


def listed(words: Sequence[str], last: str = "and") -> str:
    """Return one or more words as a list in a sentence: ``a, b and c``; `last` is the word before the last one."""
    *others, end = words
    return f"{', '.join(others)} {last} {end}" if others else end


def inputs_text(inputs: Mapping[str, float], digits: int = 6) -> str:
    """Return inputs in words: ``nu = 0.3, load = 1``; of many with one name and a number, only how many: the
    coefficients of a field."""
    stems = {name: found[1] for name in inputs if (found := re.fullmatch(r"(.+)_\d+", name))}
    many = {stem: count for stem, count in Counter(stems.values()).items() if count > MOST_NUMBERED}
    shown = (f"{name} = {value:.{digits}g}" for name, value in inputs.items() if stems.get(name) not in many)
    return ", ".join([*shown, *(f"{count} coefficients of {stem}" for stem, count in many.items())])


def names_text(names: Iterable[str]) -> str:
    """Return names in words: ``E_1 … E_80, nu``; of many with one name and a number, the first and the last."""
    groups: dict[str, list[str]] = {}
    for name in names:
        found = re.fullmatch(r"(.+)_\d+", name)
        groups.setdefault(found[1] + "_" if found else name, []).append(name)
    return ", ".join(f"{one[0]} … {one[-1]}" if len(one) > MOST_NUMBERED else ", ".join(one) for one in groups.values())


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
    return f"{html.escape(base)}<sub>{html.escape(index)}</sub>" if base and index else html.escape(symbol)


def html_table(head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "") -> str:
    """Return a plain HTML table; cells are HTML, head and caption are text."""
    top = "".join(f"<th>{html.escape(cell)}</th>" if cell else "<td></td>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f"<table>{above}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
