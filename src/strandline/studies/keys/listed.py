"""All keys of study.yaml in one list, with defaults and meanings, for the reference page."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from strandline.studies.keys.options import Options, annotation_of

__all__ = ["Key", "listed"]


@dataclass(frozen=True)
class Key:
    """A key of study.yaml that takes a value.

    Args:
        name: Name with the sections around it: ``design.sobol.runs``; NAME stands for a name that the user chooses.
        default: Default as YAML writes it, or ``required``.
        meaning: Meaning in Markdown; empty if a key before it explains this one too.
    """

    name: str
    default: str
    meaning: str


def listed(section: type[BaseModel]) -> tuple[Key, ...]:
    """Return the keys of a section and of those inside it, in their order, each once."""
    found: dict[str, Key] = {}
    for key in _keys(section, ""):
        found.setdefault(key.name, key)
    return tuple(found.values())


def _keys(section: type[BaseModel], before: str) -> Iterator[Key]:
    for name, field in section.model_fields.items():
        if field.exclude:
            continue
        annotation = annotation_of(field)
        inner = list(_sections(annotation))
        named = bool(inner) and _by_name(annotation)
        prefix = f"{before}{name}.NAME." if named else f"{before}{name}."
        if not inner or (named and field.description):
            default = "required" if field.is_required() else _written(field.get_default())
            yield Key(prefix.removesuffix(".") if named else f"{before}{name}", default, _shown(field.description))
        for one in inner:
            yield from _keys(one, prefix)


def _shown(meaning: str | None) -> str:
    """Return a meaning for a cell of a table: one line, with a capital, without a full stop, code in Markdown."""
    text = " ".join((meaning or "").replace("``", "`").split()).removesuffix(".")
    return text[:1].upper() + text[1:] if text[:1].isascii() else text


def _sections(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the sections inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        return
    marks = [mark for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Options)]
    if marks:
        yield marks[0].section
        return
    for argument in get_args(annotation):
        yield from _sections(argument)


def _by_name(annotation: Any) -> bool:
    """Return whether the user chooses the names of the keys in a section."""
    if get_origin(annotation) is dict:
        return True
    return any(_by_name(one) for one in get_args(annotation) if get_origin(annotation) is not list)


def _written(default: Any) -> str:
    if isinstance(default, str):
        return default
    return json.dumps(list(default) if isinstance(default, tuple) else default)
