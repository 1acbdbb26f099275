"""Sections of study.yaml whose keys are the options of a class of the library: one definition of name, type, default.

``refine: Annotated[Mapping[str, Any], Options(Refinement)]`` takes a mapping from the fields of `Refinement` to values
of their types and refuses other keys. The class itself checks which values make sense when it is made.
"""

import dataclasses
import re
import textwrap
import types
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, create_model
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from strandline.studies.keys.scalars import Number, Size, Text
from strandline.studies.keys.section import Section, Switch

__all__ = ["Options", "annotation_of", "keys_within", "meanings"]

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
