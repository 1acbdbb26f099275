"""A study: the content of study.yaml as objects, the forward runs that it needs, and which of them its ledgers hold."""

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from strandline import models
from strandline.calibration import Settings
from strandline.design import Candidate, first_inputs, sobol
from strandline.discrepancy import Discrepancy
from strandline.foundations import InvalidInput, InvalidStudy, html_table, html_text, read_json, write_json
from strandline.interface import Interface, Noise, Observation, PointErrors, UnknownErrors
from strandline.parameters import ParameterSpace
from strandline.runs import ATTEMPTS, COMMON_KINDS, ENDS, EXCLUDED, Executor, Ledger, Plan, RunRecord, run_key
from strandline.studies.keys.folder import LEDGER, REFINEMENT, Results, digest_of, results_in
from strandline.studies.load.observed import Scanned, SyntheticNoise
from strandline.studies.load.photographed import Photographed, Undeformed
from strandline.surrogate import MANY_INPUTS


@dataclass(frozen=True)
class Study:
    """The content of study.yaml as domain objects.

    `text` is that of study.yaml. The model has sensitivities if the study asks for them; `space` are its unknown,
    `fixed` its known inputs. Of the measures by name, the first makes the posterior. `noise` holds for conditions
    without an entry of their own in `noises`. Interfaces, in mm, are `observed` by condition; none are if the model
    makes them, at the inputs `truth` and with `synthetic_noise`. The observed points of the conditions `turned` were in
    the opposite direction. Observed interfaces may come from pictures or stacks, the undeformed outline from a picture.
    `reuse` are ledgers of other studies whose runs are taken over if they fit, `candidates` those for the next
    experiment. `as_loaded` is the study as loaded, to notice fields replaced since; None for one made in another way.
    """

    folder: Path
    name: str
    text: str
    model: models.ForwardModel
    space: ParameterSpace
    fixed: Mapping[str, float]
    discrepancies: Mapping[str, Discrepancy]
    noise: Noise | PointErrors | UnknownErrors
    noises: Mapping[str, Noise | PointErrors | UnknownErrors]
    observed: Mapping[str, Interface]
    truth: Mapping[str, float] | None
    synthetic_noise: SyntheticNoise | None
    turned: tuple[str, ...]
    pictures: Mapping[str, Photographed]
    stacks: Mapping[str, Scanned]
    undeformed: Undeformed | None
    settings: Settings
    executor: Executor
    reuse: tuple[Path, ...]
    candidates: tuple[Candidate, ...] = ()
    with_report: bool = True
    as_loaded: "Study | None" = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        unknown, model = ", ".join(self.space.shown), self._simulator
        return f"<Study {self.name}: {unknown} of {model}, {self.settings.planned_runs} runs, {self.folder}>"

    def _repr_html_(self) -> str:
        scalars = [self.space[name] for name in self.space.scalars]
        priors = [
            (html_text(p.name), *map(html.escape, (p.unit, repr(p.prior)))) for p in (*scalars, *self.space.fields)
        ]
        facts = [("model", html.escape(self._simulator)), ("folder", html.escape(str(self.folder)))]
        facts += [("runs", str(self.settings.planned_runs)), ("measures", ", ".join(self.discrepancies))]
        facts += [(html.escape(name), f"{value:g}") for name, value in self.fixed.items()]
        inputs = html_table(("input", "unit", "prior"), priors, caption=self.name)
        return inputs + html_table(("study", ""), facts)

    @property
    def _simulator(self) -> str:
        model = self.model
        while isinstance(model, models.WithFields | models.WithCheaper):
            model = model.model
        return type(model).__name__

    @cached_property
    def runs(self) -> "StudyRuns":
        return StudyRuns(self)

    @property
    def measure(self) -> Discrepancy:
        return next(iter(self.discrepancies.values()))

    def noise_of(self, condition: str) -> Noise | PointErrors | UnknownErrors:
        return self.noises.get(condition, self.noise)

    def observation(self, interface: Interface, condition: str) -> Observation:
        """Return an interface as if it had been observed; if points have their own sd, others have their rms."""
        noise = self.noise_of(condition)
        stated = noise.of_points(len(interface.points)) if isinstance(noise, PointErrors) else noise
        return Observation(interface, stated, condition)

    def observations(self, observed: Mapping[str, Interface]) -> tuple[Observation, ...]:
        return tuple(Observation(seen, self.noise_of(name), name) for name, seen in observed.items())

    @property
    def ledger_path(self) -> Path:
        return self.folder / LEDGER

    @property
    def text_digest(self) -> str:
        """SHA-256 of study.yaml without its questions, to notice results of another version of it."""
        return digest_of(self.text)

    @property
    def results(self) -> Results:
        """Whether there are results, and whether they belong to the present study.yaml."""
        return results_in(self.folder, self.text_digest)

    @property
    def sensitivities(self) -> bool:
        return models.asks_sensitivities(self.model)

    @property
    def draws_by_chains(self) -> bool:
        """Whether an active design of many inputs draws from the posterior by chains."""
        active, many = self.settings.active, self.space.dim >= MANY_INPUTS
        alone = not isinstance(self.model, models.WithCheaper)
        return active is not None and many and alone and (active.differences or self.sensitivities)


def require_study(given: object) -> None:
    """Refuse the folder of a study, or its result, in place of the study itself."""
    if not isinstance(given, Study):
        remedy = "Load it with load_study(FOLDER); the result of load_result has it as `.study`."
        raise InvalidInput("study", value=given, expected="a Study", remedy=remedy)


RULES = 2  # of the active design: which first runs it makes, and what follows them


@dataclass(frozen=True)
class StudyRuns:
    """The runs of a study: which ones it needs, where they are kept, and how far they have got.

    The inputs of later batches and rounds depend on the runs before them: refinement.json holds those that have begun,
    as long as study.yaml does not change.
    """

    study: Study

    @cached_property
    def identity(self) -> str:
        """Fingerprint of the model; ledgers of another model are refused."""
        return models.fingerprint(self.study.model)

    def key(self, inputs: Mapping[str, float]) -> str:
        return run_key(models.run_identity(self.study.model, self.identity, inputs), inputs)

    @property
    def design(self) -> list[dict[str, float]]:
        """Inputs of the first design in their order: the Sobol design, or the given runs of an active design."""
        study, given = self.study, self.given
        if given is not None or self._of_other_rules:
            return given or []
        number, space, scramble = study.settings.runs, study.space, study.settings.scramble
        if study.settings.active is None:
            points = space.to_physical(sobol(number, space.dim, scramble=scramble))
        else:
            points = first_inputs(study.settings.active, space, number, scramble)
        inputs = [{**study.fixed, **space.as_mapping(x)} for x in points]
        return models.first_runs(study.model, inputs)

    @property
    def design_keys(self) -> list[str]:
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
    def may_end_early(self) -> bool:
        """Whether an active design has not ended yet; it may do so before its `planned` runs."""
        return self.study.settings.active is not None and not self._noted.get("finished")

    @property
    def planned(self) -> int:
        """Number of runs of the design and all rounds; at most, if it is active, and those made once it has ended."""
        settings, begun = self.study.settings, self.rounds
        first, made = len(self.design), sum(len(keys) for keys in begun)
        if settings.active is not None:
            most = settings.active.runs + (first if self.given is not None else 0)
            return max(most, first + made) if self.may_end_early else first + made
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
        with self.reading() as ledger:
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
        if not self.study.ledger_path.is_file():
            return 0
        with Ledger.open(self.study.ledger_path, model=None, read_only=True) as ledger:
            return ledger.counts().open

    def ledger(self) -> Ledger:
        """Open the study's ledger to write to it; it is made if there is none."""
        return Ledger.open(self.study.ledger_path, model=self.identity, description=self.study.name)

    def reading(self, path: Path | None = None) -> Ledger:
        """Open the study's ledger, or another one, to read it; a ledger of another model is refused."""
        return Ledger.open(path or self.study.ledger_path, model=self.identity, read_only=True)

    def require_sound_ledgers(self) -> None:
        """Refuse a ledger, own or reused, that is damaged or belongs to another model or to a newer strandline."""
        for _ in self._own_and_reused():
            pass

    def require_finished(self) -> None:
        """Refuse a study some of whose runs, a synthetic one or a check's included, are not yet done."""
        study, keys, done = self.study, self.needed_keys, 0
        needed = len(keys) + self.planned - sum(len(some) for some in (self.design_keys, *self.rounds))
        if study.ledger_path.is_file():
            with self.reading() as ledger:
                done = len(settled(ledger, keys, sensitivities=study.sensitivities))
        if done < needed:
            most, truth = "at most " * self.may_end_early, ", the synthetic one included" if study.truth else ""
            value = f"{done} of {most}{needed} forward runs done{truth}"
            if study.results == "outdated":
                value += ", and results of an earlier study.yaml"
            expected, remedy = "all runs done before results are made", f"Run it first: strandline run {study.folder}"
            raise InvalidStudy("the study is not finished", value=value, expected=expected, remedy=remedy)

    def take_over(self, ledger: Ledger) -> None:
        """Copy runs of other studies that this one needs and has not made itself."""
        keys, sensitivities = self.needed_keys, self.study.sensitivities
        for other in self.study.reuse:
            known = ledger.latest(keys).values()
            here = {one.key for one in known if one.settles(sensitivities=sensitivities) or not one.final}
            missing = [key for key in keys if key not in here]
            if missing and other.is_file():
                ledger.copy_from(other, missing, sensitivities=sensitivities)

    def begin_round(self, number: int, inputs: Sequence[Mapping[str, float]]) -> None:
        """Note the runs of round `number`, counted from 0; drop later rounds."""
        self.note(rounds=[*self.rounds[:number], [self.key(entry) for entry in inputs]], finished=False)

    def begin_active(self, ledger: Ledger) -> list[dict[str, float]] | None:
        """Return the inputs of the existing runs that an active design starts with; None for its Sobol design.

        They are the runs that the study's own and the reused ledgers hold from another study.yaml, if there are at
        least as many as the design would start with. The first answer is noted, so that the study goes on with it.
        """
        settings = self.study.settings
        if settings.active is None:
            return None
        if "given" not in self._noted or self._of_other_rules:
            found = self._at_hand(ledger)
            self.note(given=found if len(found) >= settings.runs else [], rounds=[], finished=False, rules=RULES)
        return self.given

    @property
    def _of_other_rules(self) -> bool:
        """Whether an earlier version has begun the active design; its runs are then given to a new one."""
        noted = self._noted
        return self.study.settings.active is not None and "given" in noted and noted.get("rules") != RULES

    def note(self, **content: Any) -> None:
        """Note in refinement.json how far refinement or an active design has got."""
        digest = {"study_sha256": self.study.text_digest}
        write_json(self.study.folder / REFINEMENT, digest | self._noted | content)

    def _own_and_reused(self) -> Iterator[Ledger]:
        for path in (self.study.ledger_path, *self.study.reuse):
            if path.is_file():
                with self.reading(path) as ledger:
                    yield ledger

    def _at_hand(self, ledger: Ledger) -> list[dict[str, float]]:
        """Return the inputs of settled runs in the box that have the study's known inputs, in a fixed order."""
        truth = None if self.study.truth is None else run_key(ledger.model, self.study.truth)
        found: dict[str, dict[str, float]] = {}
        for path in (None, *(path for path in self.study.reuse if path.is_file())):
            with nullcontext(ledger) if path is None else self.reading(path) as source:
                for record in source:
                    if record.final and record.state != EXCLUDED and record.key != truth and self._belongs(record):
                        found[record.key] = dict(record.inputs)
        return [found[key] for key in sorted(found)]

    def _belongs(self, record: RunRecord) -> bool:
        study, names = self.study, {*self.study.fixed, *self.study.space.names}
        if set(record.inputs) - {models.CHEAPER} != names or record.key != self.key(record.inputs):
            return False
        known = all(record.inputs[name] == value for name, value in study.fixed.items())
        box = zip(study.space.names, study.space.low, study.space.high, strict=True)
        useful = not study.sensitivities or not record.ok or any(record.sensitivities.values())
        return known and useful and all(low <= record.inputs[name] <= high for name, low, high in box)

    @property
    def _noted(self) -> dict[str, Any]:
        """Content of refinement.json; empty if it belongs to another study.yaml."""
        found = read_json(self.study.folder / REFINEMENT)
        return found if found.get("study_sha256") == self.study.text_digest else {}


def settled(ledger: Ledger, keys: Iterable[str], *, sensitivities: bool = False) -> list[RunRecord]:
    """Return the records of the runs `keys` that will not be tried again, given whether `sensitivities` are wanted."""
    return [
        record
        for record in ledger.latest(keys).values()
        if record.settles(sensitivities=sensitivities) or ledger.open_attempts(record.key) >= ATTEMPTS
    ]


def failure_words(model: models.ForwardModel) -> tuple[str, ...]:
    """Return the known words for failed runs of `model`: states, its own kinds, kinds of any model."""
    states = (state for state in ENDS if state != "ok")
    return tuple(dict.fromkeys([*states, *(models.declared_failure_kinds(model) or ()), *COMMON_KINDS]))
