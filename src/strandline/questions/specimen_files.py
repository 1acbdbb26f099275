"""The outlines of many specimens: which files there are, how each is read, and what is known about its inputs."""

import csv
import glob
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import Interface, Noise, PointErrors, UnknownErrors
from strandline.models.protocol import declared_conditions
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
        parts = []
        for part in Path(self.pattern).parts[:-1]:
            if glob.has_magic(part):
                break
            parts.append(part)
        return self.study.folder.joinpath(*parts)

    @property
    def paths(self) -> list[Path]:
        """The files there are now, in the order of their names, without the tables beside them.

        Raises:
            InvalidStudy: The pattern cannot be used.
        """
        said = self.content.specimens
        tables = [self.study.folder / SPECIMENS_TABLE]
        if said is not None and said.given is not None:
            tables.append(self.study.folder / said.given)
        apart = {path.resolve() for path in tables}
        try:
            return sorted(path for path in self._matching() if path.is_file() and path.resolve() not in apart)
        except (ValueError, NotImplementedError) as error:
            raise InvalidStudy(
                "specimens.files", value=self.pattern, expected=f"a pattern of files: {error}", remedy="Correct it."
            ) from None

    def _matching(self) -> Iterator[Path]:
        pattern = Path(self.pattern)
        if pattern.is_absolute():
            return Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor)))
        return self.study.folder.glob(self.pattern)

    def name(self, path: Path) -> str:
        """Return the name of the specimen in a file."""
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
        """Return the outline in a file, with its noise.

        Raises:
            InvalidInput: The file cannot be read, or holds no simple outline.
        """
        try:
            digest = _digest(path)
        except OSError as error:
            raise InvalidInput(
                f"outline {path.name}",
                value=error.strerror or str(error),
                expected="a file that can be read",
                remedy="Check it.",
            ) from None
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
        """Return the known inputs of a specimen.

        Raises:
            InvalidInput: The table has no row for it, or a cell that is not a number.
        """
        if not self.known:
            return {}
        row = self.given.get(name)
        missing = list(self.known) if row is None else [key for key, value in row.items() if value is None]
        if row is None or missing:
            raise InvalidInput(
                f"known inputs of {name}",
                value="no row in the table" if row is None else f"no number for {', '.join(missing)}",
                expected=f"a row with numbers for {', '.join(self.known)}",
                remedy=f"Add it to {self.content.specimens.given if self.content.specimens else 'the table'}.",
            )
        return {key: float(value) for key, value in row.items() if value is not None}


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def specimen_files(study: Study) -> SpecimenFiles:
    """Return the files of all specimens of a study.

    Raises:
        InvalidStudy: study.yaml names none, its model has several conditions, or the table of known inputs is wrong.
    """
    content = StudyFile.model_validate(load_yaml(study.text))
    said = content.specimens
    if said is None:
        raise InvalidStudy(
            "study.yaml names no specimens",
            value=study.name,
            expected="the key specimens, e.g. `specimens: specimens/*.csv`",
            remedy="Add it; the runs of the study stay valid.",
        )
    require_one_condition(study)
    known, given = ((), {}) if said.given is None else _table(study, said.given)
    return SpecimenFiles(study, content, said.files, _source(content, said), known, given)


def require_one_condition(study: Study) -> None:
    """Refuse a model with named conditions: a specimen has one outline."""
    names = declared_conditions(study.model)
    if any(names):
        raise InvalidStudy(
            "specimens of a model with several conditions",
            value=", ".join(names),
            expected="a model with a single outline",
            remedy="Make a study for each specimen, or let the model return one interface.",
        )


def noise_of_outline(study: Study, interface: Interface) -> Noise | PointErrors | UnknownErrors:
    """Return the noise of an outline that does not come from a file of the study."""
    return study.observation(interface, "").noise


def _source(content: StudyFile, said: SpecimensFile) -> ObservationFile:
    """Return how the files are read."""
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
    wrong = [head for head in heads if head not in (FILE, *study.space.names)]
    known = tuple(head for head in heads if head in study.space.names)
    if FILE not in heads or not known or wrong or len(known) == study.space.dim:
        raise InvalidStudy(
            f"specimens.given: columns of {name}",
            value=", ".join(heads) or "none",
            expected=f"file and some, not all, of the inputs {', '.join(study.space.names)}",
            remedy="Correct the first line of the table.",
        )
    cleaned = [{str(key).strip(): value for key, value in row.items()} for row in rows]
    _require_once([str(row[FILE]).strip() for row in cleaned], name)
    return known, {str(row[FILE]).strip(): {key: _number(row[key]) for key in known} for row in cleaned}


def _require_once(names: Sequence[str], table: str) -> None:
    twice = sorted(name for name, number in Counter(names).items() if number > 1)
    if twice:
        raise InvalidStudy(
            f"specimens.given: rows of {table}",
            value=f"several for {', '.join(twice)}",
            expected="one for each specimen",
            remedy="Remove the wrong ones.",
        )


def _number(text: str | None) -> float | None:
    try:
        return float(text or "")
    except ValueError:
        return None
