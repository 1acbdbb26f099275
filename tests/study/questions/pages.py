"""What the reference pages say of a result's keys, and what a result has."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["described_in", "keys_of"]


def described_in(page: str) -> set[str]:
    """Return the keys in the tables of a page in docs/reference."""
    text = (Path(__file__).parents[3] / "docs" / "reference" / page).read_text("utf-8")
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {key for row in rows for key in re.findall(r"`([^`]+)`", row)}


def keys_of(tree: Any, named: Mapping[str, str], *, whole: tuple[str, ...] = (), place: str = "") -> set[str]:
    """Return the dotted keys of a result.

    Args:
        tree: The result.
        named: Placeholder of the names in a place, which may begin with a placeholder: {"inputs": "NAME"}.
        whole: Last parts of places whose content is one value.
        place: Where the tree is.
    """
    if place.endswith(whole):
        return {place}
    if isinstance(tree, list) and tree and isinstance(tree[0], dict):
        return {key for one in tree for key in keys_of(one, named, whole=whole, place=f"{place}[]")}
    if not isinstance(tree, dict):
        return {place}
    inner = [(f"{place}.{named.get(place, name)}" if place else name, value) for name, value in tree.items()]
    return {key for where, value in inner for key in keys_of(value, named, whole=whole, place=where)}
