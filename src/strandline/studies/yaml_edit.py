"""Change values in the text of a study file in place, so that its comments stay."""

from collections.abc import Mapping
from math import inf
from typing import Any

import yaml

from strandline.errors import InvalidStudy
from strandline.studies.yaml_text import compose_yaml, load_yaml

Changes = Mapping[tuple[str, ...], Any]
"""Keys from the top of the file down to a value → its new value."""
REMOVED: Any = object()
"""New value of a key that is removed."""


class _CannotEdit(Exception):
    """The text is written in a way that only a new text of the whole file can follow."""


def changed_text(text: str, changes: Changes) -> str:
    """Return the text of a study file with other values.

    Comments and layout stay, except inside a value that is replaced. If the text cannot be edited in place, for example
    because of aliases, the result is a new text without comments.
    """
    wanted = changed_content(load_yaml(text), changes)
    edited = text
    try:
        for keys, value in changes.items():
            edited = _edited(edited, keys, value)
        if load_yaml(edited) == wanted:
            return edited
    except (_CannotEdit, InvalidStudy):
        pass
    return yaml.safe_dump(wanted, sort_keys=False, allow_unicode=True)


def changed_content(content: Any, changes: Changes) -> dict[Any, Any]:
    """Return the content of a study file with other values; mappings on the way that are missing are made."""
    result: dict[Any, Any] = dict(content)
    for (first, *rest), value in changes.items():
        if rest:
            result[first] = changed_content(result.get(first) or {}, {tuple(rest): value})
        elif value is REMOVED:
            result.pop(first, None)
        else:
            result[first] = value
    return result


def flow(value: Any) -> str:
    """Return a value on one line of YAML, as it may stand inside brackets."""
    text = yaml.safe_dump([value], default_flow_style=True, allow_unicode=True, width=inf, sort_keys=False)
    return text.strip()[1:-1]


def _edited(text: str, keys: tuple[str, ...], value: Any) -> str:
    """Return the text with one change."""
    node = compose_yaml(text)
    for depth, name in enumerate(keys):
        if not isinstance(node, yaml.MappingNode):
            raise _CannotEdit
        below = _nested(keys[depth + 1 :], value)
        found = next((pair for pair in node.value if pair[0].value == name), None)
        if found is None:
            return text if value is REMOVED else _with_key(text, node, name, below)
        key, node_below = found
        if value is REMOVED and depth == len(keys) - 1:
            return _without(text, node, key, node_below)
        if depth == len(keys) - 1 or _is_null(node_below):
            return _with_value(text, node_below, below)
        node = node_below
    raise _CannotEdit


def _nested(keys: tuple[str, ...], value: Any) -> Any:
    """Return ``{a: {b: value}}`` for the keys a, b."""
    for key in reversed(keys):
        value = {key: value}
    return value


def _is_null(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.tag.endswith(":null")


def _with_value(text: str, node: yaml.Node, value: Any) -> str:
    start, end = node.start_mark.index, _end(text, node)
    before = text[:start].rstrip()
    before = f"{before} " if before.endswith(":") else text[:start]
    return f"{before}{flow(value)}{text[end:]}"


def _with_key(text: str, node: yaml.MappingNode, name: str, value: Any) -> str:
    entry = f"{flow(name)}: {flow(value)}"
    if not node.value:
        at = node.start_mark.index + 1
        return f"{text[:at]}{entry}{text[at:]}"
    last = _end(text, node.value[-1][1])
    if node.flow_style:
        return f"{text[:last]}, {entry}{text[last:]}"
    at = _line_end(text, last)
    return f"{text[:at]}\n{' ' * node.start_mark.column}{entry}{text[at:]}"


def _without(text: str, node: yaml.MappingNode, key: yaml.Node, value: yaml.Node) -> str:
    begin = text.rfind("\n", 0, key.start_mark.index) + 1
    if node.flow_style or text[begin : key.start_mark.index].strip():
        raise _CannotEdit
    return text[:begin] + text[_line_end(text, _end(text, value)) + 1 :]


def _end(text: str, node: yaml.Node) -> int:
    """Return where a value ends in the text, without the blank lines and comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        return _end(text, node.value[-1][1] if isinstance(node, yaml.MappingNode) else node.value[-1])
    return max(node.start_mark.index, len(text[: node.end_mark.index].rstrip()))


def _line_end(text: str, at: int) -> int:
    found = text.find("\n", at)
    return len(text) if found < 0 else found
