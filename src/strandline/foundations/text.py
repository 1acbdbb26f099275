"""Rules for names, units and numbers that a person writes, shared by all parts of the package."""

import re
from collections.abc import Collection, Sequence

from strandline.foundations.errors import InvalidInput

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
    """Return words as a list in a sentence: ``a, b and c``.

    Args:
        words: The words, one or more.
        last: Word before the last one.
    """
    *others, end = words
    return f"{', '.join(others)} {last} {end}" if others else end


def require_label(what: str, text: object) -> None:
    """Refuse a text that cannot be used in figures, tables and files.

    Raises:
        InvalidInput: the text is refused; the message begins with `what`.
    """
    if not is_label(text):
        raise InvalidInput(
            what,
            value=text,
            expected=f"at most {LONGEST} characters on one line, without $",
            remedy="Write it as plain text, e.g. mm²/s.",
        )


def require_name(what: str, text: object, *, reserved: Collection[str] = ()) -> None:
    """Refuse a text that cannot name an input, and the `reserved` names.

    Raises:
        InvalidInput: the text is refused; the message begins with `what`.
    """
    if text in reserved:
        raise InvalidInput(
            what,
            value=text,
            expected=f"none of the names that the results use themselves: {', '.join(reserved)}",
            remedy="Rename the input.",
        )
    if not is_name(text):
        raise InvalidInput(
            what,
            value=text or "an empty name",
            expected=f"at most {LONGEST} characters on one line, without blanks at the ends and without / \\ = $",
            remedy="Rename the input.",
        )


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
