"""The options of a class of the library as keys of study.yaml, and all keys in one list.

A class states name, type and default of each option once, as the fields of a dataclass; `Options` turns them into keys,
so that pydantic checks names, types and missing keys. Which values make sense the class checks when it is made. Types
of values come first: what could not be used later is refused, and so are unknown keys.
"""

import dataclasses
import json
import re
import textwrap
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, create_model
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticUseDefault, core_schema

from strandline.foundations import decimal, is_label, is_name

MOST = 1_000_000  # largest count of runs, particles and so on: more than anybody needs, and few enough for memory
MOST_RETRIES = 1000
MOST_VALUES = 10_000  # values of the nuisance inputs; the sampler runs once for each
VARIANCES = 1e-30, 1e30  # smallest and largest σ_N²; beyond them, likelihoods overflow


def _number(value: Any) -> Any:
    """Refuse true/false and text instead of a number; accept `1e-5`, which YAML 1.1 reads as text."""
    if isinstance(value, bool):
        raise ValueError("a number, not a truth value")
    if isinstance(value, str):
        number = decimal(value)
        if number is None:
            raise ValueError("a finite number" if value.strip(".+-").lower() in ("nan", "inf") else "a number")
        return number
    return value


def _whole(value: Any) -> Any:
    """Refuse true/false and text, even `"80"`, instead of a whole number."""
    if isinstance(value, bool):
        raise ValueError("a number, not a truth value")
    if isinstance(value, str):
        raise ValueError("a whole number, without quotes" if decimal(value) is not None else "a whole number")
    return value


def _name(value: str) -> str:
    if not is_name(value):
        raise ValueError("a short name on one line, without / \\ = $ and without blanks at its ends")
    return value


def _label(value: str) -> str:
    if not is_label(value):
        raise ValueError("a short text on one line without $, e.g. mm²/s")
    return value


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(_whole)]
Count = Annotated[Whole, Field(ge=1, le=MOST)]
Size = Annotated[Whole, Field(le=MOST)]  # a count whose smallest value is checked elsewhere
Seed = Annotated[Whole, Field(ge=0, lt=2**32)]
Name = Annotated[str, AfterValidator(_name)]
Unit = Annotated[str, AfterValidator(_label)]
Text = Annotated[str, Field(strict=True, min_length=1)]


Choice = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1, max_length=1)]
"""One named variant with its options: ``{currents: {width: 0.005}}``."""
Switch = Annotated[bool, Field(strict=True)]


class Section(BaseModel):
    """Keys with values."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


READ = "read"  # in the metadata of a field: function that turns a value of the study file into one of the field
PRESETS = "PRESETS"  # attribute of a class with objects that the study file may name
PLAIN: dict[Any, Any] = {float: Number, int: Whole, str: Annotated[str, Field(strict=True)], bool: Switch}
"""Types of fields → types of values in the study file."""
BOUNDED: dict[Any, Any] = {**PLAIN, int: Size, str: Text}
"""The same for our own keys: no number of anything beyond all memory, no empty text."""


@dataclass(frozen=True, eq=False)
class Options:
    """A mark for a value in the study file whose keys are the fields of the dataclass `of`, `without` some of them.

    Keys that are there `also`, or fields of another form in the study file, have type and default by name; `plain` has
    types of values by the types of fields. With `make`, a validated value is an object of the class, not its options.
    """

    of: type
    without: Collection[str] = ()
    also: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)
    plain: Mapping[Any, Any] = field(default_factory=lambda: BOUNDED)
    make: bool = False

    @cached_property
    def section(self) -> type[BaseModel]:
        """The model of pydantic that checks these keys and describes each."""
        meaning, hints = meanings(self.of), _hints(self.of)
        own = {f.name: f for f in dataclasses.fields(self.of) if f.init and f.name not in self.without}
        keys: dict[str, Any] = {
            name: self.also.get(name) or self._key(one, hints.get(name, Any)) for name, one in own.items()
        }
        keys |= self.also
        described: dict[str, Any] = {
            name: (Annotated[kind, Field(description=meaning[name])] if name in meaning else kind, default)
            for name, (kind, default) in keys.items()
        }
        made: type[BaseModel] = create_model(self.of.__name__, __base__=_Described, **described)
        return made

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        inner = handler.generate_schema(self.section)
        return core_schema.no_info_wrap_validator_function(self._read, inner)

    def _read(self, value: Any, checked: Callable[[Any], BaseModel]) -> Any:
        if self.make and isinstance(value, self.of):
            return value
        if isinstance(value, str) and value in getattr(self.of, PRESETS, {}):
            return getattr(self.of, PRESETS)[value]
        section = checked(value)
        return self.of(**stated(section)) if self.make else section.model_dump(exclude_none=True)

    def _key(self, one: "dataclasses.Field[Any]", hint: Any) -> tuple[Any, Any]:
        """Return type and default of a key; null stands for the default, unless the field may be None."""
        read = one.metadata.get(READ)
        kind = self._type(hint) if read is None else Annotated[Any, AfterValidator(read)]
        default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
        if default is dataclasses.MISSING:
            return kind, ...
        optional = read is None and (hint is Any or type(None) in get_args(hint))
        return kind | None if optional else Annotated[kind, BeforeValidator(_left_out)], default

    def _type(self, hint: Any) -> Any:
        """Return the type of a value in the study file for a field of this type; Any leaves it to the class."""
        origin, arguments = get_origin(hint), get_args(hint)
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            return Annotated[Any, Options(hint, plain=self.plain, make=True)]
        if origin in (Union, types.UnionType):
            kinds = [self._type(kind) for kind in arguments if kind is not type(None)]
            undecided = Any in kinds or {int, float} <= {*arguments}
            return Any if undecided else Union[tuple(kinds)]  # noqa: UP007
        if origin is tuple:
            return cast(Any, tuple)[tuple(one if one is ... else self._type(one) for one in arguments)]
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return cast(Any, dict)[str, self._type(arguments[1])]
        return hint if origin is Literal else self.plain.get(hint, Any)


class _Described(Section):
    """A section whose meanings do not stand in its source, where pydantic would look for them at length."""

    model_config = ConfigDict(use_attribute_docstrings=False)


def with_keys_of(base: type[Section], of: type, names: Collection[str]) -> type[Section]:
    """Return a section with further keys: fields of a dataclass, which checks their values itself."""
    said = meanings(of)
    keys: dict[str, Any] = {name: (Any, Field(None, description=said[name])) for name in names}
    return create_model(base.__name__, __base__=(base, _Described), **keys)


def _left_out(value: Any) -> Any:
    if value is None:
        raise PydanticUseDefault
    return value


def stated(section: BaseModel) -> dict[str, Any]:
    """Return the options that were given, by name."""
    return {name: value for name, value in section if name in section.model_fields_set}


def _hints(kind: type) -> dict[str, Any]:
    """Return the types of the fields; none if a class of somebody else names types that do not exist here."""
    try:
        return get_type_hints(kind)
    except NameError:
        return {}


def keys_within(annotation: Any) -> type[BaseModel] | None:
    """Return the section inside an annotation such as ``dict[str, Input]``, or None."""
    return next(_sections_in(annotation), None)


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
    """A key of study.yaml with its default, as YAML writes it, or ``required``, and its meaning in Markdown.

    The name has the sections around it, ``design.sobol.runs``; NAME stands for a name that the user chooses. The
    meaning is empty if a key before it explains this one too.
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
        annotation = annotation_of(key)
        found = list(_sections_in(annotation))
        inner = [one for one in found if one.model_fields and not issubclass(section, one)]
        named = bool(found) and _by_name(annotation)
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
    marks = [mark for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Options)]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif marks:
        yield marks[0].section
    else:
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
