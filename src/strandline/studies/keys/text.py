"""The text of study.yaml → plain data, with the line of each mistake; the same text with other values."""

import re
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any

import yaml

from strandline.foundations import InvalidStudy
from strandline.studies.keys.folder import STUDY

DEEPEST = 40  # largest depth of nested lists and mappings
LARGEST = 100_000  # largest number of values; those that an alias repeats count each time
DIGITS = 300  # most digits of a number; a float has no more before the point
CORE = {f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float", "str", "seq", "map", "merge")}
DATE = "tag:yaml.org,2002:timestamp"
FLOAT = "tag:yaml.org,2002:float"
NUMBERS = ("tag:yaml.org,2002:int", FLOAT)
WITH_EXPONENT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$")
UNUSABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that cannot be in a file name, a name or a command, and that a terminal may act upon."""


def load_yaml(text: str) -> Any:
    """Return the content of `text`; numbers with underscores are texts: YAML 1.1 would read ``1_0`` as 10."""
    try:
        _require_bearable(text)
        return yaml.load(text, Loader=_Loader)
    except InvalidStudy:
        raise
    except (yaml.YAMLError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or error
        raise _not_yaml(mark, f"a mistake in its syntax: {problem}") from None


def _require_bearable(text: str) -> None:
    """Refuse characters that cannot be used, and text that would take all memory: too deep, or too large.

    Depth and number of values are those with all aliases expanded; an anchor cannot contain an alias of itself.
    """
    known: dict[str | None, list[Any]] = {}
    begun: list[list[Any]] = [[None, 0, 0]]  # name, number of values and depth of what is being read
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        mark = event.start_mark
        found: list[Any] = [getattr(event, "anchor", None), 1, 1]
        if isinstance(event, yaml.AliasEvent):
            if any(event.anchor == one[0] for one in begun):
                name = event.anchor
                raise _not_yaml(mark, f"*{name} within &{name} itself", "an alias of something before it")
            found = known.get(event.anchor, found)
        if isinstance(event, yaml.ScalarEvent) and (bad := UNUSABLE.search(event.value)):
            raise _not_yaml(mark, repr(bad[0])[1:-1], "no control characters", "Remove the character.")
        if isinstance(event, yaml.NodeEvent) and len(begun) + found[2] > DEEPEST + 1:
            raise _not_yaml(mark, "lists or mappings within each other", f"at most {DEEPEST} of them")
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append(found)
        elif isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent):
            found = begun.pop() if isinstance(event, yaml.CollectionEndEvent) else found
            if found[1] > LARGEST:
                raise _not_yaml(mark, "aliases (*name) that repeat each other", f"at most {LARGEST} values in all")
            known[found[0]] = found
            begun[-1][1:] = begun[-1][1] + found[1], max(begun[-1][2], 1 + found[2])


class _Loader(yaml.SafeLoader):
    """Safe YAML that refuses repeated keys and custom tags."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Return a mapping whose keys are texts or numbers, each present once."""
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _not_yaml(key.start_mark, "a list or mapping as a key", "a word before the colon")
            if (key.tag, key.value) in seen:
                raise _not_yaml(key.start_mark, f"{key.value} again", "every key once", "Remove one of them.")
            seen.add((key.tag, key.value))
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Return the value of a node; refuse one that does not match its tag, with its line."""
        if node.tag not in CORE and not (node.tag == DATE and isinstance(node, yaml.ScalarNode)):
            raise _not_yaml(node.start_mark, f"the tag {node.tag}", "plain YAML without tags", "Remove the tag.")
        if node.tag in NUMBERS and len(node.value) > DIGITS:
            raise _not_yaml(node.start_mark, f"a number of {len(node.value)} digits", f"at most {DIGITS} digits")
        if node.tag in NUMBERS and "_" in node.value:
            raise _not_yaml(node.start_mark, node.value, "a number without underscores")
        try:
            value: Any = super().construct_object(node, deep=deep)
        except (KeyError, ValueError, AttributeError, TypeError, OverflowError, IndexError) as error:
            if isinstance(error, InvalidStudy):
                raise
            kind = node.tag.rpartition(":")[2]
            why = f": {error}" if type(error) is ValueError else ""
            raise _not_yaml(node.start_mark, f"{node.value!r}, which is no {kind}{why}") from None
        return value


def _not_yaml(
    mark: Any, value: str, expected: str = "YAML", remedy: str = "Correct the line, or the one before it."
) -> InvalidStudy:
    where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
    return InvalidStudy(f"{STUDY}{where} is not valid YAML", value=value, expected=expected, remedy=remedy)


def _rules() -> dict[Any, Any]:
    """Return YAML 1.1's rules for plain words, without numbers with underscores, and with 1e-3 as in YAML 1.2."""
    changed: dict[Any, Any] = {}
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items():
        changed[first] = [
            (tag, re.compile(f"(?!.*_)(?:{rule.pattern})", re.VERBOSE) if tag in NUMBERS else rule)
            for tag, rule in rules
        ]
    for first in "-+.0123456789":
        changed.setdefault(first, []).append((FLOAT, WITH_EXPONENT))
    return changed


_Loader.yaml_implicit_resolvers = _rules()


Changes = Mapping[tuple[str, ...], Any]  # keys from the top of the file down to a value → its new value
REMOVED: Any = object()  # new value of a key that is removed


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
            edited = _edited(edited, yaml.compose(edited, Loader=_Loader), keys, value)
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


def _edited(text: str, node: yaml.Node | None, keys: Sequence[str], value: Any) -> str:
    if not isinstance(node, yaml.MappingNode):
        raise _CannotEdit
    name, *rest = keys
    pair = next((one for one in node.value if one[0].value == name), None)
    old = None if pair is None else pair[1]
    if rest and old is not None and not old.tag.endswith(":null"):
        return _edited(text, old, rest, value)
    if value is REMOVED:
        return text if rest or pair is None else _without(text, node, *pair)
    for one in reversed(rest):
        value = {one: value}
    if old is not None:
        before = text[: old.start_mark.index]
        before = f"{before.rstrip()} " if before.rstrip().endswith(":") else before
        return f"{before}{flow(value)}{text[_end(text, old) :]}"
    entry = f"{flow(name)}: {flow(value)}"
    at = _end(text, node.value[-1][1]) if node.value else node.start_mark.index + 1
    if node.value and not node.flow_style:
        at, entry = _line_end(text, at), f"\n{' ' * node.start_mark.column}{entry}"
    elif node.value:
        entry = f", {entry}"
    return f"{text[:at]}{entry}{text[at:]}"


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
