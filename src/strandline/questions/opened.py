"""A study opened for many specimens: the surrogate is learnt once, and serves one outline after another."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from strandline.discrepancy import Discrepancy
from strandline.interface import Interface, Noise, Observation, PointErrors, UnknownErrors
from strandline.numerics.threads import one_thread, use_double
from strandline.parameters import ParameterSpace
from strandline.questions.answer import LineFile
from strandline.questions.knowledge import chosen_measure, digest_of, field_knowledge, require, require_seed
from strandline.questions.many import Task
from strandline.questions.specimen import SpecimenPosterior, posterior_of
from strandline.questions.specimen_files import SpecimenFiles, require_one_condition, specimen_files
from strandline.questions.start import Certified, Start
from strandline.runs import Ledger, RunRecord
from strandline.studies.folder import SPECIMENS_LEDGER, SPECIMENS_LINES
from strandline.studies.observed import require_plausible
from strandline.studies.study import Study
from strandline.studies.study_runs import settled

__all__ = ["Specimens", "open_specimens"]

ARRAYS = ("mean", "covariance", "quantiles", "draws")


def lines_of(study: Study) -> LineFile:
    """Return the file of a study's posteriors, one a line, each with the digest of all that it depends on."""
    return LineFile(study.folder / SPECIMENS_LINES)


def known_posteriors(study: Study) -> dict[str, SpecimenPosterior]:
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
        space=ParameterSpace(tuple(space[name] for name in entry["inputs"])),
        effective=entry["effective"],
        by=entry["by"],
        certified=Certified(entry["shift"], entry["surprise"]),
        **arrays,
    )


@dataclass(frozen=True, eq=False)
class Specimens:
    """A study that is ready to analyse outlines, without a forward run: `begin` is the surrogate of the interface with
    draws of the prior; it was learnt from `further` runs too, made for specimens. The seed is that of all random
    numbers.
    """

    study: Study
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
        """Return the posterior of the inputs for one outline, mm, with the noise of the study unless another one is
        given.

        `given` has known inputs by name. The name of the specimen, with the seed, decides all random numbers.

        Raises:
            InvalidInput: The outline cannot be compared, or a known input lies outside its box.
        """
        stated = self.study.observation(interface, "").noise if noise is None else noise
        task = Task(name, (self._observation(interface, stated, name),), given or {})
        use_double()
        with one_thread():
            begin = self.begin.with_given(task.given)
            return posterior_of(begin, task.observations, self.discrepancy, name=name, seed=self.seed)

    def task(self, path: Path) -> tuple[Task, str]:
        """Return the specimen in a file, and the digest of all that its posterior depends on."""
        name = self.files.name(path)
        outline, given = self.files.read(path), self.files.given_of(name)
        seen = self._observation(outline.interface, outline.noise, name)
        read = self.files.source.model_dump_json()
        facts = [self._key, name, outline.digest, sorted(given.items()), repr(outline.noise), read]
        return Task(name, (seen,), given), sha256(json.dumps(facts).encode()).hexdigest()

    def _observation(self, interface: Interface, noise: Noise | PointErrors | UnknownErrors, name: str) -> Observation:
        """Return an outline in the direction of the runs."""
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


def open_specimens(study: Study, *, seed: int = 1, measure: str | None = None) -> Specimens:
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


def further_runs(study: Study) -> tuple[RunRecord, ...]:
    """Return the runs that were made for specimens of a study, in the order of their keys."""
    path = study.folder / SPECIMENS_LEDGER
    if not path.is_file():
        return ()
    with Ledger.open(path, model=study.runs.identity, read_only=True) as ledger:
        keys = {record.key for record in ledger}
        return tuple(sorted(settled(ledger, keys), key=lambda record: record.key))
