"""A study with other values, in a folder of its own that takes over the runs of the original."""

import filecmp
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from strandline.foundations import InvalidInput, InvalidStudy, require
from strandline.studies.keys.folder import STUDY, is_result, study_name, told_if_unwritable
from strandline.studies.keys.parse import parse_study, parsed
from strandline.studies.keys.text import Changes, changed_text, flow, load_yaml
from strandline.studies.load.load import load_study, study_of

LONGEST = 63  # most characters in the name of a folder that is made up from settings


def changed_study(folder: Path, settings: Sequence[str], into: Path | None = None) -> Path:
    """Return the folder of the study in `folder` with other values; it is written unless it is there already.

    The values are ``KEY=VALUE``, with dotted keys and values in YAML. By default, the copy lies beside `folder`.
    """
    content, text = parse_study(folder)
    present, raw = folder.resolve(), load_yaml(text)
    changes = _changes(settings, raw)
    target = (present.parent / _named(present.name, changes) if into is None else into).resolve()
    apart = present != target and present not in target.parents and target not in present.parents
    require(apart, "--into", str(into), "a folder apart from the study's", error=InvalidStudy)
    if _same_model(present, changes, text):
        reuse = reuse_from(present, target, changes.get(("reuse",), raw.get("reuse")))
    else:
        reuse = reuse_from(present, target, changes.get(("reuse",)))[1:]
    changed: Changes = {("name",): study_name(target), **changes, ("reuse",): reuse}
    shown = ", ".join(f"{'.'.join(keys)}={flow(value)}" for keys, value in changes.items())
    new = f"# {content.name} with {shown}\n{changed_text(text, changed)}"
    with _told_as_setting():
        parsed(new)
    if target.exists():
        _require_same(present, target, new)
        return target
    with _told_as_setting():
        write_copy(present, target, new)
    return target


def _same_model(present: Path, changes: Changes, text: str) -> bool:
    """Return whether runs of the study fit its copy: one with another model can take none over."""
    if all(keys[0] not in ("model", "inputs") for keys in changes):  # of these, the prior of a field
        return True
    try:
        other = changed_text(text, changes)
        return study_of(present, parsed(other), other).runs.identity == load_study(present).runs.identity
    except InvalidInput:  # of the copy: told when it is written
        return False


def write_copy(present: Path, target: Path, text: str) -> None:
    """Copy the files of a study, but not its results, into a new folder with another study.yaml.

    Raises InvalidInput, and writes nothing, if the copy is no sound study; InvalidStudy if it cannot write there.
    """
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    with told_if_unwritable(target.parent):
        try:
            shutil.copytree(present, partial, ignore=lambda at, names: {n for n in names if is_result(Path(at, n))})
            (partial / STUDY).write_text(text, encoding="utf-8")
            load_study(partial)
            partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def reuse_from(present: Path, target: Path, others: Sequence[str] | None) -> list[str]:
    """Return the key `reuse` of a copy at `target`: the original, `present`, and the `others` that it reuses itself."""
    folders = [present, *(present / str(other) for other in others or [])]
    return list(dict.fromkeys(Path(os.path.relpath(one, target)).as_posix() for one in folders))


@contextmanager
def _told_as_setting() -> Iterator[None]:
    """Name the option `--set` in the error about a study file that is sound without it."""
    try:
        yield
    except InvalidInput as error:
        what = f"--set: {error.what}"
        raise InvalidStudy(what, value=error.value, expected=error.expected, remedy=error.remedy) from None


def _changes(settings: Sequence[str], content: dict[Any, Any]) -> dict[tuple[str, ...], Any]:
    found: dict[tuple[str, ...], Any] = {}
    for setting in settings:
        name, sign, value = setting.partition("=")
        name = name.strip()
        if not (sign and value.strip()) or not all(name.split(".")):
            expected = "KEY=VALUE, e.g. noise.sd=3 or inputs.E.prior.uniform=[100,800]"
            remedy = "Write the keys of study.yaml with dots between them, = and the value."
            raise InvalidStudy("--set", value=setting, expected=expected, remedy=remedy)
        keys = _keys(name, content)
        require(keys not in found, "--set", name, "each key once", "Remove one of them.", InvalidStudy)
        found[keys] = _value(name, value)
    return dict(sorted(found.items()))


def _keys(name: str, content: Any) -> tuple[str, ...]:
    """Return the keys that a dotted name consists of; keys in the file may have dots themselves."""
    parts, keys = name.split("."), list[str]()
    while parts:
        if content is not None and not isinstance(content, dict):
            what, expected = f"--set {name}: {'.'.join(keys)} has no keys below it", "keys with values"
            raise InvalidStudy(what, value=content, expected=expected, remedy=f"Set {'.'.join(keys)} as a whole.")
        known = content or {}
        number = next((n for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in known), 1)
        keys.append(".".join(parts[:number]))
        content, parts = known.get(keys[-1]), parts[number:]
    return tuple(keys)


def _value(name: str, text: str) -> Any:
    try:
        return load_yaml(text)
    except InvalidStudy as error:
        what = f"--set {name}: the value is not valid YAML"
        expected = "a number, a text, a list such as [1, 2], or keys such as {a: 1}"
        remedy = f"Put quotes around it for the shell: --set '{name}=…'."
        raise InvalidStudy(what, value=text, expected=expected, remedy=remedy) from error


def _named(name: str, changes: Changes) -> str:
    words = "-".join(f"{'.'.join(keys)}-{flow(value)}" for keys, value in changes.items())
    full = re.sub(r"-+", "-", re.sub(r"[^A-Za-z0-9_.-]+", "-", f"{name}-{words}")).rstrip("-.")
    if len(full) <= LONGEST:
        return full
    digest = sha256(words.encode()).hexdigest()[:8]
    return f"{full[: LONGEST - len(digest) - 1].rstrip('-.')}-{digest}"


def _require_same(present: Path, target: Path, text: str) -> None:
    differing = next(_differing(present, target, text), None)
    if differing is not None:
        what = "there is another study already"
        expected = "a new folder, or the same study with the same settings, which would go on"
        remedy = "Choose another folder with --into, or move this one away."
        raise InvalidStudy(what, value=f"{target}, where {differing} differs", expected=expected, remedy=remedy)


def _differing(present: Path, target: Path, text: str) -> Iterator[str]:
    written = target / STUDY
    if not written.is_file() or written.read_text(encoding="utf-8") != text:
        yield STUDY
    for folder, folders, names in os.walk(present):
        folders[:] = [name for name in folders if not is_result(Path(folder, name))]
        for name in names:
            one = (Path(folder) / name).relative_to(present)
            if is_result(present / one) or one == Path(STUDY):
                continue
            if not (target / one).is_file() or not filecmp.cmp(present / one, target / one):
                yield str(one)
