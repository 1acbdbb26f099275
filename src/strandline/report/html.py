"""Pages from templates, with scripts and data inside: nothing is loaded, and no other script can run."""

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from strandline.foundations import RAISED, html_text, listed, unit_text, with_sd

PANELS = Path(__file__).parent / "panels"
"""Scripts and style of the panels that the report and the page of `strandline view` share."""
PLOTLY = PANELS / "vendor" / "plotly-cartesian.min.js"
MODULES = ("shared", "panels", "explore")
"""Those of a report; each comes after those that it imports from, and no two declare the same name."""
MODULE_WORDS = re.compile(r'^import .* from "\./\w+\.js";\n|^export ', re.MULTILINE)
NUMBER = re.compile(r"(?<![^\s(])[-+]?\d[\d.]*(e[-+]\d+)?(?![^\s,;)])")
MOST_LISTED = 12
"""Numbers up to which a list is shown in full."""
PLAIN_DIGITS = 6
"""Digits up to which a number is written without a power of ten."""


def template(name: str, *, package: str = "strandline.report") -> Any:
    """Return a template of a package; it may include those of reports, such as their style."""
    return _environment(package).get_template(name)


def said(name: str, /, page: str = "captions.txt.j2", **facts: Any) -> str:
    """Return the text that a macro of a template makes of facts, as one paragraph."""
    return one_line(str(getattr(template(page).module, name)(**facts)))


def one_line(text: str) -> str:
    """Return a text of a template as one paragraph; spaces that no line break splits stay."""
    return re.sub("[ \n]+", " ", text).strip()


def save_page(path: Path, page: str) -> Path:
    """Write a page whole or not at all, and return its path."""
    unfinished = path.with_name(f".{path.name}.partial")
    unfinished.write_text(page, encoding="utf-8")
    return unfinished.replace(path)


@lru_cache(maxsize=4)
def _environment(package: str) -> Environment:
    loader = ChoiceLoader([PackageLoader(package), PackageLoader("strandline.report")])
    escape = select_autoescape(disabled_extensions=["txt.j2"], default=True, default_for_string=True)
    options: Any = {"trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined, "finalize": numbers}
    environment = Environment(loader=loader, autoescape=escape, **options)
    environment.filters |= {
        "g": number,
        "fixed": fixed,
        "unit": lambda unit: unit_text(unit) or "–",
        "with_sd": lambda item: with_sd(item["mean"], item["sd"]),
        "symbol": lambda symbol: Markup(html_text(symbol)),
        "percent": lambda value: f"{value:.1%}",
        "small_share": small_share,
        "listed": listed,
        "counted": lambda number, word: f"{number} {word}{'s' * (number != 1)}",
    }
    return environment


def number(value: float | list[float] | None, digits: int = 4) -> str:
    """Return a number, or several, with this many digits, a proper minus, and powers of ten that no line break splits.

    Numbers with up to six digits before the point have no power of ten: 290, not 2.9 · 10².
    """
    if value is None:
        return "–"
    if isinstance(value, list):
        if len(value) > MOST_LISTED:
            return f"from {number(min(value), digits)} to {number(max(value), digits)}"
        return ", ".join(number(item, digits) for item in value)
    rounded = float(f"{value:.{digits}g}") + 0.0  # without the sign of a zero
    return str(numbers(f"{rounded:.{max(digits, PLAIN_DIGITS)}g}"))


def numbers(text: Any) -> Any:
    """Return a text with proper minuses, and powers of ten that no line break splits; HTML and what is no text stay."""
    return NUMBER.sub(_typeset, text) if isinstance(text, str) and not hasattr(text, "__html__") else text


def _typeset(found: re.Match[str]) -> str:
    mantissa, _, power = found[0].partition("e")
    raised = f"\u00a0·\u00a010{str(int(power)).translate(RAISED)}" if power else ""
    return mantissa.replace("-", "−") + raised


def fixed(value: float, decimals: int = 2, sign: str = "") -> str:
    """Return a number with this many decimals and a proper minus, which a zero has not; `sign` is ``+`` for both."""
    return f"{round(value, decimals) + 0.0:{sign}.{decimals}f}".replace("-", "−")


def small_share(share: float) -> str:
    """Return a share above zero, even a very small one, as text."""
    return f"{share:.2%}" if share >= 0.0001 else "less than 0.01%"


def script_hash(script: str) -> str:
    """Return the script's entry in the page's security policy, so that no other script can run."""
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode('utf-8')).digest()).decode('ascii')}"


def embedded(data: Mapping[str, Any]) -> Markup:
    """Return JSON that cannot end the element that it is in."""
    return Markup(json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


@lru_cache
def bundled() -> str:
    """Return the modules of a report's panels as one script."""
    texts = "\n".join((PANELS / f"{name}.js").read_text(encoding="utf-8") for name in MODULES)
    return f'\n"use strict";\n{{\n{MODULE_WORDS.sub("", texts)}}}\n'
