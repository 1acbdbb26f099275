"""The forward runs that a study needs, and which of them its ledgers hold."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from strandline.design import sobol
from strandline.errors import InvalidStudy
from strandline.models.fidelities import CHEAPER, first_runs, run_identity
from strandline.models.fingerprint import fingerprint
from strandline.runs import Ledger, RunRecord, run_key
from strandline.runs.ledger_schema import ATTEMPTS, EXCLUDED
from strandline.runs.plans import Plan
from strandline.studies.folder import REFINEMENT, read_json, write_json
from strandline.studies.settings import failure_words

if TYPE_CHECKING:
    from strandline.studies.study import Study


@dataclass(frozen=True)
class StudyRuns:
    """The runs of a study: which ones it needs, where they are kept, and how far they have got.

    The inputs of later batches and rounds depend on the runs before them: refinement.json holds those that have begun,
    as long as study.yaml does not change.

    Args:
        study: The study, as loaded or with parts of it replaced.
    """

    study: "Study"

    @cached_property
    def identity(self) -> str:
        """Fingerprint of the model; ledgers of another model are refused."""
        return fingerprint(self.study.model)

    def key(self, inputs: Mapping[str, float]) -> str:
        """Return the ledger key of a run."""
        return run_key(run_identity(self.study.model, self.identity, inputs), inputs)

    @property
    def design(self) -> list[dict[str, float]]:
        """Inputs of the first design in their order: the Sobol design, or the given runs of an active design."""
        study, given = self.study, self.given
        if given is not None:
            return given
        points = sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble)
        inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in study.space.to_physical(points)]
        return first_runs(study.model, inputs)

    @property
    def design_keys(self) -> list[str]:
        """Ledger keys of the first design, in its order."""
        return [self.key(inputs) for inputs in self.design]

    @property
    def rounds(self) -> list[list[str]]:
        """Ledger keys of each round of refinement, or batch, that has begun."""
        rounds = self._noted.get("rounds")
        return [list(keys) for keys in rounds] if isinstance(rounds, list) else []

    @property
    def given(self) -> list[dict[str, float]] | None:
        """Inputs of the existing runs that an active design starts with; None if there are none."""
        given = self._noted.get("given")
        return [dict(entry) for entry in given] if isinstance(given, list) and given else None

    @property
    def needed_keys(self) -> list[str]:
        """Ledger keys of all runs known to be needed: the synthetic one, the design, the rounds."""
        synthetic = [] if self.study.truth is None else [self.key(self.study.truth)]
        rounds = [key for keys in self.rounds for key in keys]
        return list(dict.fromkeys([*synthetic, *self.design_keys, *rounds]))

    @property
    def planned(self) -> int:
        """Number of runs of the design and of all rounds of refinement.

        For an active design: the most that it may make; once it has ended, those that it made.
        """
        settings, begun = self.study.settings, self.rounds
        first, made = len(self.design), sum(len(keys) for keys in begun)
        if settings.active is not None:
            most = settings.active.runs + (first if self.given is not None else 0)
            return first + made if self._noted.get("finished") else max(most, first + made)
        left = settings.refine.rounds - len(begun)
        return first + made + left * settings.refine.runs

    @property
    def plan(self) -> Plan:
        """What the study is known to need from its ledger."""
        study = self.study
        return Plan(
            study_sha256=study.text_digest,
            name=study.name,
            model=self.identity,
            inputs=tuple(study.space.names),
            sensitivities=study.sensitivities,
            planned=self.planned,
            parts=(tuple(self.design_keys), *(tuple(keys) for keys in self.rounds)),
        )

    @property
    def known(self) -> int:
        """Number of planned runs in the study's ledger or in a reused one."""
        keys = [*self.design_keys, *(key for some in self.rounds for key in some)]
        known: set[str] = set()
        for ledger in self._own_and_reused():
            known.update(record.key for record in settled(ledger, keys, sensitivities=self.study.sensitivities))
        return len(known)

    @property
    def failure_kinds(self) -> set[str]:
        """Kinds and states of the runs that did not end ok, be it with the model before its correction."""
        if not self.study.ledger_path.is_file():
            return set()
        with self._reading(self.study.ledger_path) as ledger:
            corrected = ledger.model != self.identity
            latest = list(ledger if corrected else ledger.latest(self.needed_keys).values())
        failed = [record for record in latest if not record.ok and record.state != EXCLUDED]
        return {word for record in failed for word in (record.failure_kind, record.state) if word}

    @property
    def unheard_kinds(self) -> list[str]:
        """Words under ``failures.kinds`` that the model does not declare and with which no run has ended."""
        named = self.study.settings.failures.actions
        known = {*failure_words(self.study.model), *(self.failure_kinds if named else ())}
        return [kind for kind in named if kind not in known]

    @property
    def open_attempts(self) -> int:
        """Number of runs in the ledger that were started and have not ended."""
        if not self.study.ledger_path.is_file():
            return 0
        with Ledger.open(self.study.ledger_path, model=None, read_only=True) as ledger:
            return ledger.counts().open

    def ledger(self) -> Ledger:
        """Open the study's ledger to write to it; it is made if there is none."""
        return Ledger.open(self.study.ledger_path, model=self.identity, description=self.study.name)

    def require_sound_ledgers(self) -> None:
        """Refuse a ledger, own or reused, that is damaged or belongs to another model or to a newer strandline."""
        for _ in self._own_and_reused():
            pass

    def require_finished(self) -> None:
        """Refuse a study that needs runs that have not been made yet."""
        study, keys, done = self.study, self.needed_keys, 0
        needed = len(keys) + self.planned - sum(len(some) for some in (self.design_keys, *self.rounds))
        if study.ledger_path.is_file():
            with self._reading(study.ledger_path) as ledger:
                done = len(settled(ledger, keys, sensitivities=study.sensitivities))
        if done < needed:
            raise InvalidStudy(
                "the study is not finished",
                value=f"{done} of {needed} forward runs done{', the synthetic one included' if study.truth else ''}",
                expected="all runs done before results are made",
                remedy=f"Run it first: strandline run {study.folder}",
            )

    def take_over(self, ledger: Ledger) -> None:
        """Copy runs of other studies that this one needs and has not made itself."""
        keys = self.needed_keys
        for other in self.study.reuse:
            known = ledger.latest(keys)
            missing = [key for key in keys if key not in known or self._lacks_sensitivities(known[key])]
            if missing and other.is_file():
                ledger.copy_from(other, missing, sensitivities=self.study.sensitivities)

    def begin_round(self, number: int, inputs: Sequence[Mapping[str, float]]) -> None:
        """Note the runs of round `number`, counted from 0; drop later rounds."""
        self._note(rounds=[*self.rounds[:number], [self.key(entry) for entry in inputs]], finished=False)

    def begin_active(self, ledger: Ledger) -> list[dict[str, float]] | None:
        """Return the inputs of the existing runs that an active design starts with; None for its Sobol design.

        They are the runs that the study's own and the reused ledgers hold from another study.yaml, if there are at
        least as many as the design would start with. The first answer is noted, so that the study goes on with it.
        """
        settings = self.study.settings
        if settings.active is None:
            return None
        if "given" not in self._noted:
            found = self._at_hand(ledger)
            self._note(given=found if len(found) >= settings.runs else [], rounds=[], finished=False)
        return self.given

    def note_batch(self, line: str) -> None:
        """Note the result of the last batch of an active design, for `strandline status`."""
        self._note(last_batch=line)

    def end_active(self) -> None:
        """Note that an active design has ended, so that its runs are all that the study needs."""
        if self.study.settings.active is not None:
            self._note(finished=True)

    def _reading(self, path: Path) -> Ledger:
        return Ledger.open(path, model=self.identity, read_only=True)

    def _own_and_reused(self) -> Iterator[Ledger]:
        for path in (self.study.ledger_path, *self.study.reuse):
            if path.is_file():
                with self._reading(path) as ledger:
                    yield ledger

    def _at_hand(self, ledger: Ledger) -> list[dict[str, float]]:
        """Return the inputs of settled runs in the box that have the study's known inputs, in a fixed order."""
        truth = None if self.study.truth is None else run_key(ledger.model, self.study.truth)
        found: dict[str, dict[str, float]] = {}
        for path in (None, *(path for path in self.study.reuse if path.is_file())):
            with nullcontext(ledger) if path is None else self._reading(path) as source:
                for record in source:
                    if record.final and record.state != EXCLUDED and record.key != truth and self._belongs(record):
                        found[record.key] = dict(record.inputs)
        return [found[key] for key in sorted(found)]

    def _belongs(self, record: RunRecord) -> bool:
        study, names = self.study, {*self.study.fixed, *self.study.space.names}
        if set(record.inputs) - {CHEAPER} != names or record.key != self.key(record.inputs):
            return False
        known = all(record.inputs[name] == value for name, value in study.fixed.items())
        box = zip(study.space.names, study.space.low, study.space.high, strict=True)
        useful = not study.sensitivities or not record.ok or bool(record.sensitivities)
        return known and useful and all(low <= record.inputs[name] <= high for name, low, high in box)

    def _lacks_sensitivities(self, record: RunRecord) -> bool:
        return record.final and not record.settles(sensitivities=self.study.sensitivities)

    @property
    def _noted(self) -> dict[str, Any]:
        """Content of refinement.json; empty if it belongs to another study.yaml."""
        found = read_json(self.study.folder / REFINEMENT)
        return found if found.get("study_sha256") == self.study.text_digest else {}

    def _note(self, **content: Any) -> None:
        digest = {"study_sha256": self.study.text_digest}
        write_json(self.study.folder / REFINEMENT, digest | self._noted | content)


def settled(ledger: Ledger, keys: Iterable[str], *, sensitivities: bool = False) -> list[RunRecord]:
    """Return the records of the runs `keys` that will not be tried again, given whether `sensitivities` are wanted."""
    return [
        record
        for record in ledger.latest(keys).values()
        if record.settles(sensitivities=sensitivities) or ledger.open_attempts(record.key) >= ATTEMPTS
    ]
