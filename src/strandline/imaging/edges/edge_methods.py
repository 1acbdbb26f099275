"""Ways to find an edge by their names, and how a study names one."""

from collections.abc import Mapping
from typing import Any

from strandline.foundations import InvalidInput, lookup
from strandline.imaging.edges.erf_step import ErfStep
from strandline.imaging.edges.half_level import HalfLevel
from strandline.imaging.edges.located import EdgeMethod
from strandline.imaging.edges.markov_path import MarkovPath
from strandline.readers import keys_of, unfit

EDGES: dict[str, Any] = {"erf": ErfStep(), "path": MarkovPath(), "contour": HalfLevel()}
"""Ways to find an edge by their names: erf for cameras, path for speckle in linear intensity, contour for clean
pictures."""
EXAMPLE = "erf, or {method: my_package.edges:Steepest, options: {reach: 5.5}}"


def edge_method(given: object, place: str = "method to find an edge") -> EdgeMethod:
    """Return the way to find an edge that a study names.

    Args:
        given: Name of an entry of `EDGES` or ``module:name``; or `method`, such a name, with the `options` of its
            class; or an `EdgeMethod`.
        place: Place in the study file, for messages.

    Raises:
        InvalidInput: There is no such method, it takes no such options, or it lacks parts of an `EdgeMethod`.
    """
    name: Any = given
    options: Any = {}
    if isinstance(given, Mapping):
        keys_of(given, ("method", "options"), place, EXAMPLE)
        name, options = given.get("method"), given.get("options") or {}
        place = f"{place}.method"
    if not isinstance(options, Mapping):
        raise unfit(place, options, "options with values, e.g. {reach: 5}")
    if name is None or isinstance(name, bool | int | float | list | Mapping):
        raise unfit(place, name, f"the name of a method, e.g. {EXAMPLE}")
    found = lookup(EDGES, name, place) if isinstance(name, str) else name
    return _sound(_made(found, name, options, place), name, place)


def _made(found: Any, name: object, options: Mapping[str, Any], place: str) -> Any:
    """Return a method of a class, with its options."""
    if not isinstance(found, type):
        if options:
            raise unfit(place, f"{name} with options", "options for a class only", "Remove the options.")
        return found
    try:
        return found(**options)
    except InvalidInput:
        raise
    except Exception as error:
        raise unfit(
            place, f"{name} with options {dict(options)}", f"options it takes ({str(error).partition(chr(10))[0]})"
        ) from None


def _sound(found: Any, name: object, place: str) -> EdgeMethod:
    """Refuse what is no method: a part is missing, no offset is in doubt, or it never looks."""
    if not isinstance(found, EdgeMethod):
        missing = [part for part in ("bias", "passes", "locate") if not hasattr(found, part)]
        raise unfit(place, f"{name}, without {', '.join(missing)}", "an EdgeMethod: bias, passes and locate")
    if not (found.bias > 0 and found.passes >= 1):
        value = f"{name} with bias {found.bias} and passes {found.passes}"
        raise unfit(place, value, "a bias above 0, since no edge is free of an offset, and at least one pass")
    return found
