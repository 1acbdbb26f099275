"""Scripts and data inside of a page: nothing is loaded, and no other script can run."""

import base64
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from markupsafe import Markup

__all__ = ["PANELS", "PLOTLY", "bundled", "embedded", "script_hash"]

PANELS = Path(__file__).parent / "panels"
"""Scripts and style of the panels that the report and the page of `strandline view` share."""
PLOTLY = PANELS / "vendor" / "plotly-cartesian.min.js"
IMPORT = re.compile(r'^import \{ (\w+(?:, \w+)*) \} from "\./([\w-]+)\.js";$', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?function (\w+)|const (\w+))", re.MULTILINE)
LEFT = re.compile(r"^\s*(?:import|export)\b.*", re.MULTILINE)


def script_hash(script: str) -> str:
    """Return the script's entry in the page's security policy, so that no other script can run."""
    return f"sha256-{base64.b64encode(hashlib.sha256(script.encode('utf-8')).digest()).decode('ascii')}"


def embedded(data: Mapping[str, Any]) -> Markup:
    """Return JSON that cannot end the element that it is in."""
    return Markup(json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"))


@lru_cache(maxsize=2)
def bundled(entry: str, folder: Path = PANELS) -> str:
    """Return modules as one script: each in a function of its own that returns what it exports.

    Args:
        entry: Name of the module to start with.
        folder: Folder of the modules; they import from it alone, and not in a circle.

    Raises:
        ValueError: An import or export of another form, or a script that would end its element.
    """
    order: dict[str, str] = {}
    for name in _in_order(entry, folder, ()):
        order.setdefault(name, _as_function(name, (folder / f"{name}.js").read_text(encoding="utf-8")))
    script = '\n"use strict";\n' + "\n".join(order.values())
    if "</script" in script.lower() or "<!--" in script:
        raise ValueError(f"the scripts of {entry} would end their element")
    return script


def _in_order(name: str, folder: Path, above: tuple[str, ...]) -> Iterator[str]:
    """Yield the modules that one needs, each after those that it imports, and then itself."""
    if name in above:
        raise ValueError(f"modules import each other: {' → '.join((*above, name))}")
    for _, needed in IMPORT.findall((folder / f"{name}.js").read_text(encoding="utf-8")):
        yield from _in_order(needed, folder, (*above, name))
    yield name


def _as_function(name: str, text: str) -> str:
    exported = [function or constant for function, constant in EXPORT.findall(text)]
    text = EXPORT.sub("", IMPORT.sub(lambda found: f"const {{ {found[1]} }} = {_variable(found[2])};", text))
    if left := LEFT.search(text):
        raise ValueError(f"{name}.js has an import or export of another form: {left[0]}")
    return f"const {_variable(name)} = (() => {{\n{text}return {{ {', '.join(exported)} }};\n}})();"


def _variable(name: str) -> str:
    return f"module_{name.replace('-', '_')}"
