"""Look-up of objects by their name in a registry, which is a dict, or by ``module:name`` for third parties."""

import importlib
import traceback
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any

from strandline.foundations.errors import InvalidInput

MISSING = "Correct the name, install the module, or put its folder on PYTHONPATH."


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
    expected, remedy = (
        f"one of {', '.join(registry)}, or module:name",
        suggestion(name, registry, "Choose one of them."),
    )
    raise InvalidInput(what, value=name, expected=expected, remedy=remedy)


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
        remedy = f'Install it: pip install "strandline[{extra}]"'
        raise InvalidInput(
            what, value=f"no module {error.name}", expected=f"the extra `{extra}`", remedy=remedy
        ) from None


def suggestion(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return a question that suggests the known name closest to `name`; `otherwise` if none is close.

    The case of letters does not count. Words of one or two letters are close to none but themselves.
    """
    words = {one.lower(): one for one in known if min(len(one), len(name)) > 2 or one.lower() == name.lower()}
    close = get_close_matches(name.lower(), words, n=1)
    return f"Did you mean {words[close[0]]}?" if close else otherwise
