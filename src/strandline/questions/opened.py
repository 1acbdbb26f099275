"""A study opened for many specimens: the surrogate is learnt once, and serves one outline after another.

Which files there are, how each is read, and what is known about its inputs, stands in study.yaml.
"""

import csv
import glob
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from strandline import studies
from strandline.discrepancy import Discrepancy, require_plausible
from strandline.foundations import InvalidInput, InvalidStudy, one_thread, require, use_double
from strandline.interface import Interface, Noise, Observation, PointErrors, UnknownErrors
from strandline.models import declared_conditions
from strandline.parameters import ParameterSpace
from strandline.questions.answer import LineFile
from strandline.questions.knowledge import chosen_measure, digest_of, field_knowledge, require_seed
from strandline.questions.many import Task
from strandline.questions.specimen import Certified, SpecimenPosterior, Start, posterior_of
from strandline.runs import Ledger, RunRecord

__all__ = ["Specimens", "open_specimens"]

FILE = "file"  # column of the table that names the specimen


@dataclass(frozen=True, eq=False)
class SpecimenFiles:
    """The files of all specimens of a study: `pattern` is relative to its folder, `source` says how each is read,
    `known` inputs have their values in `given`, by specimen.
    """

    study: studies.Study
    content: studies.StudyFile
    pattern: str
    source: studies.ObservationFile
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
        apart = {(self.study.folder / name).resolve() for name in (studies.SPECIMENS_TABLE, given) if name is not None}
        pattern = Path(self.pattern)
        try:
            found = Path(pattern.anchor or self.study.folder).glob(str(pattern.relative_to(pattern.anchor)))
            return sorted(path for path in found if path.is_file() and path.resolve() not in apart)
        except (ValueError, NotImplementedError) as error:
            expected = f"a pattern of files: {error}"
            raise InvalidStudy("specimens.files", value=self.pattern, expected=expected, remedy="Correct it.") from None

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

    def read(self, path: Path) -> tuple[Observation, str]:
        """Return the outline in a file, with its noise, and its SHA-256; refuse a file that holds no simple outline."""
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
        found = studies.read_observation(self.study.folder, self.source.model_copy(update=changed), self.study.model)
        noise = studies.build_noise(self.content.noise, self.study.space.names, found)
        if self.study.undeformed is not None:
            noise = studies.with_errors_of(self.study.undeformed, noise, found.interface, conditions=1)
        studies.require_fits(noise, found.interface)
        return Observation(found.interface, noise), digest

    def given_of(self, name: str) -> dict[str, float]:
        """Return the known inputs of a specimen; refuse one without a row in the table, or a cell that is no number."""
        row = self.given.get(name, {})
        missing = [key for key in self.known if row.get(key) is None]
        value = f"no number for {', '.join(missing)}" if row else "no row in the table"
        expected = f"a row with numbers for {', '.join(self.known)}"
        require(not missing, f"known inputs of {name}", value, expected, "Add it to the table in specimens.given.")
        return {key: float(value) for key, value in row.items() if value is not None}


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def specimen_files(study: studies.Study) -> SpecimenFiles:
    """Return the files of all specimens of a study; refuse a study that names none."""
    content = studies.StudyFile.model_validate(studies.load_yaml(study.text))
    said = content.specimens
    if said is None:
        expected, remedy = "the key specimens, e.g. `specimens: specimens/*.csv`", "Add it; the runs stay valid."
        raise InvalidStudy("study.yaml names no specimens", value=study.name, expected=expected, remedy=remedy)
    require_one_condition(study)
    known, given = ((), {}) if said.given is None else _table(study, said.given)
    return SpecimenFiles(study, content, said.files, _source(content, said), known, given)


def require_one_condition(study: studies.Study) -> None:
    """Refuse a model with named conditions: a specimen has one outline."""
    names = declared_conditions(study.model)
    words = "a model with a single outline", "Make a study for each specimen, or let the model return one interface."
    require(not any(names), "specimens of a model with several conditions", ", ".join(names), *words, InvalidStudy)


def _source(content: studies.StudyFile, said: studies.SpecimensFile) -> studies.ObservationFile:
    if said.read is None:
        own = content.observation
        if not isinstance(own, list) and own.synthetic is None:
            return own
        what, value = "specimens: how to read the files", "observation.synthetic, which reads none"
        expected = "the unit of the coordinates, `specimens: {files: …, read: {unit: mm}}`"
        raise InvalidStudy(what, value=value, expected=expected, remedy="Add read.")
    image = said.read.get("image")
    into = {"image": {**image, FILE: said.files}} if isinstance(image, Mapping) else {FILE: said.files}
    return studies.checked(studies.ObservationFile, {**said.read, **into}, "specimens.read")


def _table(study: studies.Study, name: str) -> tuple[tuple[str, ...], dict[str, dict[str, float | None]]]:
    try:
        with (study.folder / name).open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        words: Any = {"expected": "a readable table", "remedy": "Correct the path."}
        raise InvalidStudy("specimens.given", value=f"{name}: {error}", **words) from None
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


ARRAYS = ("mean", "covariance", "quantiles", "draws")


def lines_of(study: studies.Study) -> LineFile:
    """Return the file of a study's posteriors, one a line, each with the digest of all that it depends on."""
    return LineFile(study.folder / studies.SPECIMENS_LINES)


def known_posteriors(study: studies.Study) -> dict[str, SpecimenPosterior]:
    """Return the posteriors of specimens that have been written, by digest."""
    names = {*study.space.names}
    ours = (one for one in lines_of(study).entries() if "of" in one and names.issuperset(one.get("inputs", [""])))
    return {str(one["of"]): _posterior(one, study.space) for one in ours}


def entry_of(one: SpecimenPosterior, of: str) -> dict[str, Any]:
    """Return a posterior as a line has it, with the digest of all that it depends on."""
    return {
        "of": of,
        "specimen": one.name,
        "given": dict(one.given),
        "inputs": list(one.space.names),
        **{name: getattr(one, name).tolist() for name in ARRAYS},
        "effective": one.effective,
        "by": one.by,
        **vars(one.certified),
    }


def _posterior(entry: Mapping[str, Any], space: ParameterSpace) -> SpecimenPosterior:
    arrays: dict[str, Any] = {name: np.array(entry[name], float) for name in ARRAYS}
    return SpecimenPosterior(
        name=entry["specimen"],
        given=entry["given"],
        space=space.subspace(space.names.index(name) for name in entry["inputs"]),
        effective=entry["effective"],
        by=entry["by"],
        certified=Certified(entry["shift"], entry["surprise"]),
        **arrays,
    )


@dataclass(frozen=True, eq=False)
class Specimens:
    """A study that is ready to analyse outlines, without a forward run: `begin` is the surrogate of the interface with
    draws of the prior; it was learnt from `further` runs too, made for specimens. All random numbers have one seed.
    """

    study: studies.Study
    measure: str
    seed: int
    begin: Start
    further: tuple[RunRecord, ...]

    def __repr__(self) -> str:
        return f"<Specimens of {self.study.name}: surrogate of {self.begin.knowledge.surrogate.runs} runs>"

    @property
    def discrepancy(self) -> Discrepancy:
        """The measure d²."""
        return self.study.discrepancies[self.measure]

    @cached_property
    def files(self) -> SpecimenFiles:
        """The files that study.yaml names."""
        return specimen_files(self.study)

    def posterior(
        self,
        interface: Interface,
        *,
        given: Mapping[str, float] | None = None,
        noise: Noise | PointErrors | UnknownErrors | None = None,
        name: str = "specimen",
    ) -> SpecimenPosterior:
        """Return the posterior of the inputs for one outline, mm, by default with the noise of the study.

        `given` has known inputs by name. The name of the specimen, with the seed, decides all random numbers.

        Raises:
            InvalidInput: The outline cannot be compared, or a known input lies outside its box.
        """
        stated = self.study.observation(interface, "").noise if noise is None else noise
        seen = self._observation(interface, stated, name)
        use_double()
        with one_thread():
            begin = self.begin.with_given(given or {})
            return posterior_of(begin, (seen,), self.discrepancy, name=name, seed=self.seed)

    def task(self, path: Path) -> tuple[Task, str]:
        """Return the specimen in a file, and the digest of all that its posterior depends on."""
        name = self.files.name(path)
        (outline, digest), given = self.files.read(path), self.files.given_of(name)
        seen = self._observation(outline.interface, outline.noise, name)
        read = self.files.source.model_dump_json()
        facts = [self._key, name, digest, sorted(given.items()), repr(outline.noise), read]
        return Task(name, (seen,), given), sha256(json.dumps(facts).encode()).hexdigest()

    def _observation(self, interface: Interface, noise: Noise | PointErrors | UnknownErrors, name: str) -> Observation:
        template = self.begin.knowledge.surrogate.layouts[""].template
        found, expected = f"{interface.dim} dimensions", f"{template.dim}, as the runs have"
        require(interface.dim == template.dim, f"outline of {name}", found, expected, "Check the file.")
        require_plausible(f"outline of {name}", interface, template)
        seen = Observation(interface, noise)
        return seen.reversed() if interface.runs_against(template) else seen

    @cached_property
    def _key(self) -> str:
        """Digest of everything that all posteriors depend on."""
        return digest_of(self.study, self.measure, self.seed, further=sorted(record.key for record in self.further))


def open_specimens(study: studies.Study, *, seed: int = 1, measure: str | None = None) -> Specimens:
    """Learn the interface from the runs of a finished study, to analyse many outlines with it.

    The measure is the study's first by default; the seed, 0 or above, that of all random numbers.

    Raises:
        InvalidInput: An argument is out of its range.
        InvalidStudy: The study is not finished, or its model has several conditions.
        LedgerError: The ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs succeeded to learn the interface.
    """
    name = chosen_measure(study, measure, "the specimens")
    require_seed(seed, "the specimens")
    require_one_condition(study)
    study.runs.require_finished()
    use_double()
    further = further_runs(study)
    with one_thread():
        knowledge = field_knowledge(study, name, purpose="the analysis of many specimens", more=further)
    return Specimens(study, name, seed, Start(knowledge, study.space), further)


def further_runs(study: studies.Study) -> tuple[RunRecord, ...]:
    """Return the runs that were made for specimens of a study, in the order of their keys."""
    path = study.folder / studies.SPECIMENS_LEDGER
    if not path.is_file():
        return ()
    with Ledger.open(path, model=study.runs.identity, read_only=True) as ledger:
        keys = {record.key for record in ledger}
        return tuple(sorted(studies.settled(ledger, keys), key=lambda record: record.key))
