"""study.yaml → `StudyFile`, with one clear line for any mistake in it."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from strandline.errors import InvalidStudy
from strandline.studies.folder import STUDY
from strandline.studies.keys import SCHEMA_VERSION, StudyFile, annotation_of, keys_within
from strandline.studies.keys.observation import KNOWN, ONE, RANGE, SEVERAL, UNKNOWN, ConditionFile
from strandline.studies.yaml_text import load_yaml

WORDS = {
    "missing": "this key",
    "dict_type": "keys with values, e.g. {key: value}",
    "model_type": "keys with values, e.g. {key: value}",
    "list_type": "a list, e.g. [0, 1]",
    "tuple_type": "a list of two numbers, [low, high]",
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "string_pattern_mismatch": "letters, digits and . _ - only, a letter or digit first",
    "string_too_long": "at most 100 characters",
    "too_long": "exactly one entry",
    "too_short": "at least one entry",
}
"""What was expected, in plain words, by pydantic's name of the mistake; pydantic's own words otherwise."""
INTERNAL = {ONE, SEVERAL, KNOWN, UNKNOWN, RANGE, "[key]", "float", "str", "Quantity", "dict"}
"""pydantic's own names in locations that are not keys of the file."""


def parse_study(folder: Path) -> tuple[StudyFile, str]:
    """Return the validated content of `folder`/study.yaml and its text.

    Raises:
        InvalidStudy: The folder or the file does not exist, or its content is not YAML or does not fit the schema.
    """
    text = _read(folder)
    return parsed(text), text


def parsed(text: str) -> StudyFile:
    """Return the validated content of the text of a study file.

    Raises:
        InvalidStudy: It is not YAML or does not fit the schema.
    """
    content = _load(text)
    version = content.get("version")
    if type(version) is not int or version != SCHEMA_VERSION:
        raise InvalidStudy(
            f"{STUDY}: version",
            value=repr(version) if isinstance(version, str) else version,
            expected=f"version: {SCHEMA_VERSION}",
            remedy=f"Put `version: {SCHEMA_VERSION}` on its first line, or use a matching strandline.",
        )
    try:
        return StudyFile.model_validate(content)
    except ValidationError as error:
        raise first_problem(error) from None


def _read(folder: Path) -> str:
    path = folder / STUDY
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        is_file = folder.is_file()
        raise InvalidStudy(
            "not a study folder",
            value=str(folder),
            expected=f"a folder with a file {STUDY}",
            remedy=f"Give the folder that it is in, `{folder.parent}`, not a file"
            if is_file
            else "Make one with `strandline init FOLDER`, or correct the path.",
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidStudy(
            f"{STUDY} cannot be read",
            value=str(error),
            expected="a readable text file in UTF-8",
            remedy="Check its permissions and encoding.",
        ) from None


def _load(text: str) -> dict[Any, Any]:
    content = load_yaml(text)
    if not isinstance(content, dict):
        raise InvalidStudy(
            f"{STUDY} holds no keys",
            value=content,
            expected="keys such as version, name, model, inputs",
            remedy="See `strandline init`, which writes a commented example.",
        )
    return content


def first_problem(error: ValidationError, schema: type[BaseModel] = StudyFile, within: str = "") -> InvalidStudy:
    """Translate pydantic's findings: an unknown key first, since it explains missing ones.

    Args:
        error: The findings.
        schema: What was validated.
        within: Place in the file of the keys that were validated.
    """
    findings = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = findings[0]
    refused = first.get("ctx", {}).get("error")
    if isinstance(refused, InvalidStudy):
        return refused
    before = f"{within}." if within else ""
    unknown = first["type"] == "extra_forbidden"
    same = [first] if unknown else _of_one_place(findings, first)
    first = same[0]
    place = before + _place(first["loc"])
    others = {before + _place(e["loc"]) for e in findings if not (unknown and e["type"] == "missing")} - {place}
    others = {other for other in others if not place.startswith(f"{other}.")}
    more = f" ({len(others)} more to correct: {', '.join(sorted(others))}.)" if others else ""
    if unknown:
        return _unknown_key(_known_keys(schema, first["loc"][:-1]), str(first["loc"][-1]), place, more)
    return InvalidStudy(
        f"{STUDY}: {place or 'study'}",
        value=None if first["type"] == "missing" else first["input"],
        expected=" or ".join(dict.fromkeys(_expectation(one) for one in same)),
        remedy=("Add it." if first["type"] == "missing" else f"Correct {place or 'it'}.") + more,
    )


def _of_one_place(findings: Sequence[Mapping[str, Any]], first: Mapping[str, Any]) -> list[Any]:
    """Return the findings at the place of the first one, or at the deepest place inside it.

    Where several forms are allowed, pydantic reports what is wrong with each; the deepest is the one that was meant.
    """
    place = _place(first["loc"])
    inside = [one for one in findings if f"{_place(one['loc'])}.".startswith(f"{place}.")]
    deepest = max(inside, key=lambda one: _place(one["loc"]).count("."))
    return [one for one in inside if _place(one["loc"]) == _place(deepest["loc"])]


def _place(location: tuple[int | str, ...]) -> str:
    return ".".join(str(part) for part in location if not _is_internal(part))


def _unknown_key(known: list[str], given: str, place: str, more: str) -> InvalidStudy:
    close = get_close_matches(given, known, n=1)
    return InvalidStudy(
        f"{STUDY}: unknown key",
        value=place,
        expected=f"one of {', '.join(known)}" if known else "no such key",
        remedy=(f"Did you mean {close[0]}?" if close else f"Remove {place}.") + more,
    )


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys allowed at `location` by following nested models by name."""
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
    return [name for name, field in current.model_fields.items() if not field.exclude] if current is not None else []


def _is_internal(part: int | str) -> bool:
    """Return whether `part` is one of pydantic's own names of union branches, not a key of the file."""
    return isinstance(part, str) and (
        part in INTERNAL or part.startswith(("function-", "dict[", "list[", "constrained"))
    )


def _expectation(finding: Mapping[str, Any]) -> str:
    kind, limits = finding["type"], finding.get("ctx", {})
    if limits.get("min_length", 1) > 1 or limits.get("max_length", 1) > 1:
        least, most = limits.get("min_length"), limits.get("max_length")
        return f"at least {least} entries" if kind == "too_short" else f"at most {most} entries"
    text = str(finding["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    said = WORDS.get(kind, text[:1].lower() + text[1:])
    return f"a number {said}" if kind.startswith(("greater_than", "less_than")) else said
