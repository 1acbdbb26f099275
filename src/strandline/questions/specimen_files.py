"""The outlines of many specimens: which files there are, how each is read, and what is known about its inputs."""

import csv
import glob
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from itertools import takewhile
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.models.protocol import declared_conditions
from strandline.questions.knowledge import require
from strandline.studies.folder import SPECIMENS_TABLE
from strandline.studies.keys import StudyFile
from strandline.studies.keys.observation import ObservationFile
from strandline.studies.keys.study_file import SpecimensFile
from strandline.studies.noise import build_noise, require_fits
from strandline.studies.observed import read_observation
from strandline.studies.parse import checked
from strandline.studies.pictures.undeformed import with_errors_of
from strandline.studies.study import Study
from strandline.studies.text import load_yaml

FILE = "file"
"""Column of the table that names the specimen."""


@dataclass(frozen=True, eq=False)
class SpecimenOutline:
    """The outline of a specimen, mm, its noise, and the SHA-256 of its file."""

    interface: Interface
    noise: Noise | PointErrors | UnknownErrors
    digest: str


@dataclass(frozen=True, eq=False)
class SpecimenFiles:
    """The files of all specimens of a study: `pattern` is relative to its folder, `source` says how each is read,
    `known` inputs have their values in `given`, by specimen.
    """

    study: Study
    content: StudyFile
    pattern: str
    source: ObservationFile
    known: tuple[str, ...]
    given: Mapping[str, Mapping[str, float | None]]

    @property
    def base(self) -> Path:
        """The folder that names of specimens are relative to."""
        parts = takewhile(lambda part: not glob.has_magic(part), Path(self.pattern).parts[:-1])
        return self.study.folder.joinpath(*parts)

    @property
    def paths(self) -> list[Path]:
        """The files there are now, in the order of their names, without the tables beside them."""
        given = self.content.specimens.given if self.content.specimens else None
        apart = {(self.study.folder / name).resolve() for name in (SPECIMENS_TABLE, given) if name is not None}
        pattern = Path(self.pattern)
        try:
            found = Path(pattern.anchor or self.study.folder).glob(str(pattern.relative_to(pattern.anchor)))
            return sorted(path for path in found if path.is_file() and path.resolve() not in apart)
        except (ValueError, NotImplementedError) as error:
            raise InvalidStudy(
                "specimens.files", value=self.pattern, expected=f"a pattern of files: {error}", remedy="Correct it."
            ) from None

    def name(self, path: Path) -> str:
        base = self.base.absolute()
        return path.absolute().relative_to(base).as_posix() if path.absolute().is_relative_to(base) else path.name

    def alike(self, paths: Iterable[Path]) -> list[tuple[str, ...]]:
        """Return names of specimens whose files have the same content; one that cannot be read is like no other."""
        names: dict[str, list[str]] = {}
        for path in paths:
            with suppress(OSError):
                names.setdefault(_digest(path), []).append(self.name(path))
        return [tuple(some) for some in names.values() if len(some) > 1]

    def read(self, path: Path) -> SpecimenOutline:
        """Return the outline in a file, with its noise; refuse a file that holds no simple outline."""
        try:
            digest = _digest(path)
        except OSError as error:
            value, expected = error.strerror or str(error), "a file that can be read"
            raise InvalidInput(f"outline {path.name}", value=value, expected=expected, remedy="Check it.") from None
        there = str(path.absolute())
        changed: dict[str, Any] = {FILE: there}
        for kind in ("image", "stack"):
            if (part := getattr(self.source, kind)) is not None:
                changed = {kind: part.model_copy(update={FILE: there})}
        found = read_observation(self.study.folder, self.source.model_copy(update=changed), self.study.model)
        noise = build_noise(self.content.noise, tuple(self.content.inputs), found)
        if self.study.undeformed is not None:
            noise = with_errors_of(self.study.undeformed, noise, found.interface, conditions=1)
        require_fits(noise, found.interface)
        return SpecimenOutline(found.interface, noise, digest)

    def given_of(self, name: str) -> dict[str, float]:
        """Return the known inputs of a specimen; refuse one without a row in the table, or with a cell that is no
        number.
        """
        row = self.given.get(name, {})
        missing = [key for key in self.known if row.get(key) is None]
        value = f"no number for {', '.join(missing)}" if row else "no row in the table"
        expected = f"a row with numbers for {', '.join(self.known)}"
        require(not missing, f"known inputs of {name}", value, expected, "Add it to the table in specimens.given.")
        return {key: float(value) for key, value in row.items() if value is not None}


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def specimen_files(study: Study) -> SpecimenFiles:
    """Return the files of all specimens of a study; refuse a study that names none."""
    content = StudyFile.model_validate(load_yaml(study.text))
    said = content.specimens
    if said is None:
        expected, remedy = "the key specimens, e.g. `specimens: specimens/*.csv`", "Add it; the runs stay valid."
        raise InvalidStudy("study.yaml names no specimens", value=study.name, expected=expected, remedy=remedy)
    require_one_condition(study)
    known, given = ((), {}) if said.given is None else _table(study, said.given)
    return SpecimenFiles(study, content, said.files, _source(content, said), known, given)


def require_one_condition(study: Study) -> None:
    """Refuse a model with named conditions: a specimen has one outline."""
    names = declared_conditions(study.model)
    require(
        not any(names),
        "specimens of a model with several conditions",
        ", ".join(names),
        "a model with a single outline",
        "Make a study for each specimen, or let the model return one interface.",
        InvalidStudy,
    )


def _source(content: StudyFile, said: SpecimensFile) -> ObservationFile:
    if said.read is None:
        own = content.observation
        if isinstance(own, list) or own.synthetic is not None:
            raise InvalidStudy(
                "specimens: how to read the files",
                value="observation.synthetic, which reads none",
                expected="the unit of the coordinates, `specimens: {files: …, read: {unit: mm}}`",
                remedy="Add read.",
            )
        return own
    image = said.read.get("image")
    into = {"image": {**image, FILE: said.files}} if isinstance(image, Mapping) else {FILE: said.files}
    return checked(ObservationFile, {**said.read, **into}, "specimens.read")


def _table(study: Study, name: str) -> tuple[tuple[str, ...], dict[str, dict[str, float | None]]]:
    """Return the names of the known inputs, and their values by specimen."""
    try:
        with (study.folder / name).open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InvalidStudy(
            "specimens.given", value=f"{name}: {error}", expected="a readable table", remedy="Correct the path."
        ) from None
    heads = [str(head).strip() for head in rows[0]] if rows else []
    known = tuple(head for head in heads if head in study.space.names)
    right = sorted(heads) == sorted([FILE, *known]) and 0 < len(known) < study.space.dim
    expected = f"file and some, not all, of the inputs {', '.join(study.space.names)}"
    what, remedy = f"specimens.given: columns of {name}", "Correct the first line of the table."
    require(right, what, ", ".join(heads) or "none", expected, remedy, InvalidStudy)
    cleaned = [{str(key).strip(): value for key, value in row.items()} for row in rows]
    counts = Counter(str(row[FILE]).strip() for row in cleaned)
    twice = f"several for {', '.join(sorted(one for one, number in counts.items() if number > 1))}"
    what, remedy = f"specimens.given: rows of {name}", "Remove the wrong ones."
    require(max(counts.values()) == 1, what, twice, "one for each specimen", remedy, InvalidStudy)
    return known, {str(row[FILE]).strip(): {key: _number(row[key]) for key in known} for row in cleaned}


def _number(text: str | None) -> float | None:
    try:
        return float(text or "")
    except ValueError:
        return None
