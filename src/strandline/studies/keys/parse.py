"""study.yaml → `StudyFile`, with one clear line for any mistake in it."""

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from strandline.foundations import InvalidInput, InvalidStudy, lookup, names_text, suggestion
from strandline.studies.keys.folder import STUDY
from strandline.studies.keys.observation import ONE, SEVERAL, ConditionFile
from strandline.studies.keys.schema import PLAIN, Options, annotation_of, keys_within, stated
from strandline.studies.keys.study_file import SCHEMA_VERSION, StudyFile
from strandline.studies.keys.text import load_yaml

T = TypeVar("T")
WORDS = {
    "missing": "this key",
    **dict.fromkeys(("dict_type", "model_type"), "keys with values, e.g. {key: value}"),
    "list_type": "a list, e.g. [0, 1]",
    "tuple_type": "a list of two numbers, [low, high]",
    **dict.fromkeys(("float_parsing", "float_type"), "a number"),
    "finite_number": "a finite number",
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float"), "a whole number"),
    "bool_type": "true or false",
    "string_type": "a text",
    "string_pattern_mismatch": "letters, digits and . _ - only, a letter or digit first",
    "string_too_long": "at most 100 characters",
    "too_long": "exactly one entry",
    "too_short": "at least one entry",
}
"""What was expected, in plain words, by pydantic's name of the mistake; pydantic's own words otherwise."""
INTERNAL = {ONE, SEVERAL, "[key]", "float", "int", "str", "Quantity", "Stop", "dict", "FieldPoints"}
"""pydantic's own names in locations that are not keys of the file."""


def parse_study(folder: Path) -> tuple[StudyFile, str]:
    """Return the validated content of `folder`/study.yaml and its text."""
    try:
        text = (folder / STUDY).read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        expected = f"a folder with a file {STUDY}"
        remedy = "Make one with `strandline init FOLDER`, or correct the path."
        if folder.is_file():
            remedy = f"Give the folder that it is in, `{folder.parent}`, not a file."
        raise InvalidStudy("not a study folder", value=str(folder), expected=expected, remedy=remedy) from None
    except (OSError, UnicodeDecodeError) as error:
        expected, remedy = "a readable text file in UTF-8", "Check its permissions and encoding."
        raise InvalidStudy(f"{STUDY} cannot be read", value=str(error), expected=expected, remedy=remedy) from None
    return parsed(text), text


def parsed(text: str) -> StudyFile:
    """Return the validated content of the text of a study file."""
    content = load_yaml(text)
    version = content.get("version") if isinstance(content, dict) else SCHEMA_VERSION
    if type(version) is not int or version != SCHEMA_VERSION:
        value, expected = repr(version) if isinstance(version, str) else version, f"version: {SCHEMA_VERSION}"
        remedy = f"Put `{expected}` on its first line, or use a matching strandline."
        raise InvalidStudy(f"{STUDY}: version", value=value, expected=expected, remedy=remedy)
    return checked(StudyFile, content)


def first_problem(error: ValidationError, schema: Any = StudyFile, within: str = "") -> InvalidStudy:
    """Translate pydantic's findings: an unknown key first, since it explains missing ones."""
    findings = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = findings[0]
    before, file = (f"{within}.", "") if within else ("", f"{STUDY}: ")
    refused = first.get("ctx", {}).get("error")
    if isinstance(refused, InvalidInput):
        return _refused(refused, "" if isinstance(refused, InvalidStudy) else before + _place(first["loc"]))
    unknown = first["type"] == "extra_forbidden"
    same = [first] if unknown else _of_one_place(findings, first)
    first = same[0]
    place = before + _place(first["loc"])
    others = {before + _place(e["loc"]) for e in findings if not (unknown and e["type"] == "missing")} - {place}
    others = {other for other in others if not place.startswith(f"{other}.")}
    more = f" ({len(others)} more to correct: {', '.join(sorted(others))}.)" if others else ""
    if unknown:
        known, name = _known_keys(schema, first["loc"][:-1]), str(first["loc"][-1])
        return InvalidStudy(
            f"{place.rpartition('.')[0]}: unknown option" if within else f"{STUDY}: unknown key",
            value=name if within else place,
            expected=f"one of {', '.join(known)}" if known else "no such key",
            remedy=suggestion(name, known, f"Remove {place}.") + more,
        )
    forms = list(dict.fromkeys(_expectation(one) for one in same))
    place, expected = place.removesuffix(".") or "study", (" or " if len(forms) < 3 else ", or ").join(forms)
    if first["type"] == "missing":
        return InvalidStudy(f"{file}{place}", value=None, expected=expected, remedy=f"Add it.{more}")
    remedy = suggestion(str(first["input"]), _words(first), f"Correct {place}.")
    return InvalidStudy(f"{file}{place}", value=first["input"], expected=expected, remedy=remedy + more)


def _of_one_place(findings: Sequence[Mapping[str, Any]], first: Mapping[str, Any]) -> list[Any]:
    """Return the findings at the deepest place within that of the first: of several forms, the one that was meant."""
    place = _place(first["loc"])
    inside = [one for one in findings if f"{_place(one['loc'])}.".startswith(f"{place}.")]
    deepest = max(inside, key=lambda one: _place(one["loc"]).count("."))
    return [one for one in inside if _place(one["loc"]) == _place(deepest["loc"])]


def _place(location: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in location if not _is_internal(part))


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    current: Any = model
    for part in location:
        if part == SEVERAL:
            current = ConditionFile
            continue
        if not (isinstance(current, type) and issubclass(current, BaseModel)):
            return []
        if part not in current.model_fields:
            continue
        current = keys_within(annotation_of(current.model_fields[str(part)]))
    return [] if current is None else [*current.model_fields]


def _is_internal(part: int | str) -> bool:
    """Return whether `part` is one of pydantic's own names of union branches, not a key of the file."""
    return isinstance(part, str) and (
        part in INTERNAL or part.startswith(("function-", "dict[", "list[", "literal[", "tuple[", "constrained"))
    )


def _expectation(finding: Mapping[str, Any]) -> str:
    kind, limits = finding["type"], finding.get("ctx", {})
    if limits.get("min_length", 1) > 1 or limits.get("max_length", 1) > 1:
        least, most = limits.get("min_length"), limits.get("max_length")
        return f"at least {least} entries" if kind == "too_short" else f"at most {most} entries"
    text = str(finding["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    if words := _words(finding):
        return f"one of {', '.join(words)}" if len(words) > 1 else words[0]
    said = WORDS.get(kind, text[:1].lower() + text[1:])
    return f"a number {said}" if kind.startswith(("greater_than", "less_than")) else said


def _words(finding: Mapping[str, Any]) -> list[str]:
    """Return the words that a key may have; none if it may have others."""
    return re.findall("'([^']+)'", finding["ctx"]["expected"]) if finding["type"] == "literal_error" else []


def checked(schema: type[T], value: Any, within: str = "") -> T:
    """Return a value at the place `within` the study file, after the check of its names, types and missing keys."""
    try:
        return TypeAdapter(schema).validate_python(value)
    except ValidationError as error:
        raise first_problem(error, schema, within) from None


def made(kind: type[T], options: Mapping[str, Any] | None, place: str, **others: Any) -> T:
    """Return an object of a dataclass, the library's own or one of ``module:name``, made from its options in the file.

    `place` is their place in the study file; `others` are further arguments, which are no options.
    """
    section = Options(kind, without=others, plain=PLAIN).section
    values = stated(checked(section, {} if options is None else options, place))
    try:
        with refused_at(place):
            return kind(**values, **others)
    except InvalidStudy:
        raise
    except (TypeError, ValueError) as error:
        expected, remedy = " ".join(str(error).split()), f"Correct the options of {place}."
        raise InvalidStudy(place, value=options, expected=expected, remedy=remedy) from None


@contextmanager
def refused_at(place: str = "") -> Iterator[None]:
    """Raise an `InvalidInput` again as `InvalidStudy`, with its place in the study file before its subject."""
    try:
        yield
    except InvalidInput as error:
        raise _refused(error, place) from None


def _refused(error: InvalidInput, place: str) -> InvalidStudy:
    within = "." if re.match(r"[a-z_.]+(:|$)", error.what) else ": "
    what = f"{place}{within}{error.what}" if place and error.what else place or error.what
    return InvalidStudy(what, value=error.value, expected=error.expected, remedy=error.remedy)


def entry(registry: Mapping[str, Any], name: str, place: str) -> Any:
    """Return the entry `name` of one of our own registries; refuse an unknown name and suggest the nearest one."""
    if name not in registry:
        remedy = suggestion(name, registry, "Choose one of them.")
        raise InvalidStudy(place, value=name, expected=f"one of {names_text(registry)}", remedy=remedy)
    return registry[name]


def open_entry(registry: Mapping[str, Any], name: str, place: str, protocol: str) -> Any:
    """Return the entry `name` of a registry, or the class ``module:name``, which must be `protocol`."""
    with refused_at():
        found = lookup(registry, name, place)
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        expected = f"a dataclass that is {protocol}: its fields are the options"
        remedy = "Decorate the class with @dataclass(frozen=True)."
        raise InvalidStudy(place, value=name, expected=expected, remedy=remedy)
    return found


def require_parts(entry: object, parts: Iterable[str], place: str) -> None:
    """Refuse an object that lacks some of these parts."""
    missing = [name for name in parts if not hasattr(entry, name)]
    if missing:
        expected = f"the parts {', '.join(parts)}"
        remedy = "Add what is missing; the conformance suite in strandline.testing says what it must do."
        raise InvalidStudy(place, value=f"a class without {', '.join(missing)}", expected=expected, remedy=remedy)


def in_words(chosen: Any) -> str:
    """Return the options of an object in words: ``Uniform: low 100, high 800``."""
    if not dataclasses.is_dataclass(chosen):
        return repr(chosen)
    options = ((field.name, getattr(chosen, field.name)) for field in dataclasses.fields(chosen))
    shown = ", ".join(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in options)
    return f"{type(chosen).__name__}: {shown}" if shown else type(chosen).__name__
