"""Sections whose keys are the options of a class of the library, and all keys in one list."""

import dataclasses
import json
import re
import textwrap
import types
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, create_model
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from strandline.studies.keys.scalars import Number, Section, Size, Switch, Text

PLAIN = {float: Number, int: Size, str: Text, bool: Switch}
"""Types of fields → types of values in the study file."""


@dataclass(frozen=True, eq=False)
class Options:
    """A mark for a mapping in the study file whose keys are the fields of a dataclass.

    Args:
        of: The dataclass.
        without: Fields that are not keys.
        also: Further keys, or fields with another form in the study file: type and default by name.
    """

    of: type
    without: Collection[str] = ()
    also: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)

    @cached_property
    def section(self) -> type[BaseModel]:
        """The keys with their types, defaults and meanings."""
        meaning = meanings(self.of)
        own = {f.name: f for f in dataclasses.fields(self.of) if f.init and f.name not in self.without}
        keys: dict[str, Any] = {
            name: self.also.get(name) or (_type(one.type) | None, _default(one)) for name, one in own.items()
        }
        keys |= self.also
        described: dict[str, Any] = {
            name: (Annotated[kind, Field(description=meaning[name])] if name in meaning else kind, default)
            for name, (kind, default) in keys.items()
        }
        made: type[BaseModel] = create_model(self.of.__name__, __base__=_Described, **described)
        return made

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the section; a validated value is a dict."""
        return core_schema.no_info_after_validator_function(_chosen, handler.generate_schema(self.section))


class _Described(Section):
    """A section whose meanings do not stand in its source, where pydantic would look for them at length."""

    model_config = ConfigDict(use_attribute_docstrings=False)


def _chosen(section: BaseModel) -> dict[str, Any]:
    """Return the options by name, except those left to the class."""
    return section.model_dump(exclude_none=True)


def _default(one: "dataclasses.Field[Any]") -> Any:
    if one.default_factory is not dataclasses.MISSING:
        return one.default_factory()
    if one.default is dataclasses.MISSING:
        return ...
    return list(one.default) if isinstance(one.default, tuple) else one.default


def _type(annotation: Any) -> Any:
    """Return the type of a value in the study file that becomes a field of this type."""
    if get_origin(annotation) in (Union, types.UnionType):
        (kind,) = (kind for kind in get_args(annotation) if kind is not type(None))
        return _type(kind)
    if get_origin(annotation) is tuple:
        return cast(Any, list)[_type(get_args(annotation)[0])]
    return annotation if get_origin(annotation) is Literal else PLAIN[annotation]


def keys_within(annotation: Any) -> type[BaseModel] | None:
    """Return the section inside an annotation such as ``dict[str, Input]``, or None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for mark in getattr(annotation, "__metadata__", ()):
        if isinstance(mark, Options):
            return mark.section
    found = (keys_within(argument) for argument in get_args(annotation))
    return next((section for section in found if section is not None), None)


def annotation_of(key: FieldInfo) -> Any:
    """Return the annotation of a key as written; pydantic keeps its outermost metadata separately."""
    return cast(Any, Annotated)[(key.annotation, *key.metadata)] if key.metadata else key.annotation


def meanings(kind: type) -> dict[str, str]:
    """Return the descriptions under ``Args:`` in the docstring of a class, by name."""
    found: dict[str, list[str]] = {}
    indent, name = None, ""
    for line in textwrap.dedent((kind.__doc__ or "").partition("Args:\n")[2]).splitlines():
        if not line.strip():
            break
        depth = len(line) - len(line.lstrip())
        indent = depth if indent is None else indent
        entry = re.match(r"(\w+): (.*)", line.strip()) if depth == indent else None
        if entry:
            name, line = entry[1], entry[2]
            found[name] = []
        found[name].append(line.strip())
    return {name: " ".join(lines) for name, lines in found.items()}


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
    for name, key in section.model_fields.items():
        if key.exclude:
            continue
        annotation = annotation_of(key)
        inner = list(_sections_in(annotation))
        named = bool(inner) and _by_name(annotation)
        prefix = f"{before}{name}.NAME." if named else f"{before}{name}."
        if not inner or (named and key.description):
            default = "required" if key.is_required() else _written(key.get_default())
            yield Key(prefix.removesuffix(".") if named else f"{before}{name}", default, _shown(key.description))
        for one in inner:
            yield from _keys(one, prefix)


def _shown(meaning: str | None) -> str:
    """Return a meaning for a cell of a table: one line, with a capital, without a full stop, code in Markdown."""
    text = " ".join((meaning or "").replace("``", "`").split()).removesuffix(".")
    return text[:1].upper() + text[1:] if text[:1].isascii() else text


def _sections_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the sections inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        return
    marks = [mark for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Options)]
    if marks:
        yield marks[0].section
        return
    for argument in get_args(annotation):
        yield from _sections_in(argument)


def _by_name(annotation: Any) -> bool:
    """Return whether the user chooses the names of the keys in a section."""
    if get_origin(annotation) is dict:
        return True
    return any(_by_name(one) for one in get_args(annotation) if get_origin(annotation) is not list)


def _written(default: Any) -> str:
    if isinstance(default, str):
        return default
    return json.dumps(list(default) if isinstance(default, tuple) else default)
