"""A study: a folder with study.yaml, loaded and checked as far as possible without a forward run."""

import html
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from strandline.calibration import Settings
from strandline.design.candidates import Candidate
from strandline.discrepancy import Discrepancy
from strandline.errors import InvalidStudy
from strandline.interface import Interface, Noise, Observation, PointErrors, UnknownErrors
from strandline.models.protocol import ForwardModel, asks_sensitivities, declared_conditions
from strandline.parameters import ParameterSpace
from strandline.runs import Executor
from strandline.studies.folder import LEDGER, digest_of
from strandline.studies.inputs import build_fixed, build_space, check_complete, read_candidates
from strandline.studies.keys import StudyFile
from strandline.studies.keys.observation import COLUMN, IMAGE, ConditionFile, ConditionNoise, ObservationFile
from strandline.studies.models import as_in_ledgers, build_discrepancies, build_model, with_cheaper
from strandline.studies.noise import (
    build_noise,
    require_fits,
    require_inferable,
    require_offset,
    require_shared,
    require_unit,
)
from strandline.studies.observed import Found, SyntheticNoise, read_observations
from strandline.studies.parse import parse_study
from strandline.studies.pictures.photographed import Photographed
from strandline.studies.pictures.scanned import Scanned
from strandline.studies.pictures.undeformed import Undeformed, undeformed_in, with_errors_of
from strandline.studies.settings import build_executor, build_settings
from strandline.studies.study_runs import StudyRuns
from strandline.typeset import html_table, html_text


@dataclass(frozen=True)
class Study:
    """The content of study.yaml as domain objects.

    Args:
        folder: Folder of the study and its results.
        name: Name of the study.
        text: Text of study.yaml, kept for provenance.
        model: The simulator, with sensitivities if the study asks for them.
        space: The unknown inputs.
        fixed: The known inputs by name.
        discrepancies: Measures by name; the first one makes the posterior.
        noise: Noise of every condition without its own.
        noises: Noise by condition.
        observed: The observed interfaces by condition, mm; empty if the model makes synthetic ones.
        truth: The inputs at which the model makes a synthetic observation of each of its conditions, or None.
        synthetic_noise: Noise added to a synthetic observation, or None.
        turned: The conditions whose observed points were in the opposite direction and were reversed.
        pictures: The pictures, by condition, in which observed interfaces were found.
        stacks: The stacks of pictures, by condition, in which observed surfaces were found.
        undeformed: The model's undeformed outline, if it comes from a picture.
        settings: How the posterior is computed.
        executor: Where forward runs are made.
        reuse: Ledgers of other studies whose runs are taken over if they fit.
        candidates: Candidates for the next experiment.
        as_loaded: The study as loaded, to notice fields replaced since; None for a study made in another way.
    """

    folder: Path
    name: str
    text: str
    model: ForwardModel
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
        unknown, model = ", ".join(self.space.names), type(self.model).__name__
        return f"<Study {self.name}: {unknown} of {model}, {self.settings.planned_runs} runs, {self.folder}>"

    def _repr_html_(self) -> str:
        priors = [(html_text(p.name), html.escape(p.unit), html.escape(repr(p.prior))) for p in self.space]
        facts = [("model", html.escape(type(self.model).__name__)), ("folder", html.escape(str(self.folder)))]
        facts += [("runs", str(self.settings.planned_runs)), ("measures", ", ".join(self.discrepancies))]
        facts += [(html.escape(name), f"{value:g}") for name, value in self.fixed.items()]
        inputs = html_table(("input", "unit", "prior"), priors, caption=self.name)
        return inputs + html_table(("study", ""), facts)

    @cached_property
    def runs(self) -> StudyRuns:
        """The runs that the study needs, and which of them its ledgers hold."""
        return StudyRuns(self)

    @property
    def measure(self) -> Discrepancy:
        """The measure that defines the posterior."""
        return next(iter(self.discrepancies.values()))

    def noise_of(self, condition: str) -> Noise | PointErrors | UnknownErrors:
        """Return the noise of a condition, or the errors of its observed points."""
        return self.noises.get(condition, self.noise)

    def observation(self, interface: Interface, condition: str) -> Observation:
        """Return an interface as if it had been observed; if points have their own sd, others have their rms."""
        noise = self.noise_of(condition)
        stated = noise.of_points(len(interface.points)) if isinstance(noise, PointErrors) else noise
        return Observation(interface, stated, condition)

    def observations(self, observed: Mapping[str, Interface]) -> tuple[Observation, ...]:
        """Return observed interfaces by condition with their noise."""
        return tuple(Observation(seen, self.noise_of(name), name) for name, seen in observed.items())

    @property
    def ledger_path(self) -> Path:
        """The ledger of this study's runs."""
        return self.folder / LEDGER

    @property
    def text_digest(self) -> str:
        """SHA-256 of study.yaml without its questions, to notice results of another version of it."""
        return digest_of(self.text)

    @property
    def sensitivities(self) -> bool:
        """Whether the runs also return sensitivities."""
        return asks_sensitivities(self.model)


def load_study(folder: Path | str) -> Study:
    """Return the study in `folder`; nothing is written and no forward run is made.

    Raises:
        InvalidStudy: The study cannot be parsed, see `parse_study`, or a value in it cannot be used.
    """
    folder = Path(folder)
    return study_of(folder, *parse_study(folder))


def study_of(folder: Path, content: StudyFile, text: str) -> Study:
    """Return the study that a study file states."""
    undeformed = undeformed_in(content.model, folder)
    model = build_model(content.model, folder, sensitivities=content.sensitivities, undeformed=undeformed)
    reuse = tuple(_reused_ledger(folder, other) for other in content.reuse)
    model = with_cheaper(as_in_ledgers(model, (folder / LEDGER, *reuse)), content, folder, undeformed)
    space, fixed = build_space(content.inputs, model), build_fixed(content, model)
    truth = _truth(content.observation, model, names=(*space.names, *fixed))
    read = {} if truth is not None else read_observations(folder, content.observation, model)
    observed = {condition: one.interface for condition, one in read.items()}
    noise, noises = _noises(content, model, read)
    if undeformed is not None:
        undeformed = replace(undeformed, noises={name: noises.get(name, noise) for name in read})
        with_errors = partial(with_errors_of, undeformed, conditions=len(read))
        noises |= {name: with_errors(undeformed.noises[name], one.interface) for name, one in read.items()}
    study = Study(
        folder=folder,
        name=content.name,
        text=text,
        model=model,
        space=space,
        fixed=fixed,
        discrepancies=build_discrepancies(content.discrepancy),
        noise=noise,
        noises=noises,
        observed=observed,
        truth=truth,
        synthetic_noise=_synthetic_noise(content),
        turned=tuple(condition for condition, one in read.items() if one.turned),
        pictures={condition: one.picture for condition, one in read.items() if one.picture is not None},
        stacks={condition: one.stack for condition, one in read.items() if one.stack is not None},
        undeformed=undeformed,
        settings=build_settings(content, model),
        executor=build_executor(content.executor, folder),
        reuse=reuse,
        candidates=read_candidates(content.next, model, space, fixed),
        with_report=content.report == "full",
    )
    for condition, seen in observed.items():
        require_fits(study.noise_of(condition), seen)
    stated = {name: study.noise_of(name) for name in observed or declared_conditions(model)}
    require_shared(stated)
    measure, by_field = study.measure, study.settings.surrogate == "field"
    for given in (content.noise, *content.noise.conditions.values()):
        require_unit(given, study.discrepancies.values())
    require_inferable(stated.values(), measure, by_field=by_field)
    return replace(study, as_loaded=study)


def _noises(
    content: StudyFile, model: ForwardModel, read: Mapping[str, Found]
) -> tuple[Noise | PointErrors | UnknownErrors, dict[str, Noise | PointErrors | UnknownErrors]]:
    """Return the noise, and that of each condition that has its own."""
    known = declared_conditions(model)
    for condition in content.noise.conditions:
        if condition not in known:
            raise InvalidStudy(
                "noise.conditions: the model has no such condition",
                value=condition,
                expected=f"some of {', '.join(known)}" if any(known) else "no conditions: the model has a single one",
                remedy="Correct the name, or remove it.",
            )
    names, stated = tuple(content.inputs), dict[str, ConditionNoise](content.noise.conditions)
    if content.noise.sd in (COLUMN, IMAGE):
        stated = {**dict.fromkeys(read, content.noise), **stated}
    for name, one in read.items():
        _require_taken(stated.get(name, content.noise), one, name)
    noises = {name: build_noise(given, names, read.get(name)) for name, given in stated.items()}
    told = [one for one in read.values() if one.sds is not None or one.errors is not None]
    noise = build_noise(content.noise, names, next(iter([*told, *read.values()]), None))
    return noise, noises


def _require_taken(given: ConditionNoise, one: Found, condition: str) -> None:
    """Refuse standard deviations of points that the noise leaves aside, and a picture's edge without an offset."""
    if one.sds is not None and given.sd != COLUMN:
        raise InvalidStudy(
            "observation.sd: the noise does not take it",
            value=f"condition {condition}" if condition else f"noise.sd: {given.sd}",
            expected=f"`noise: {{sd: {COLUMN}, unit: um}}`",
            remedy="Write that, or remove observation.sd.",
        )
    if one.errors is not None:
        require_offset(given)


def _truth(
    source: ObservationFile | list[ConditionFile], model: ForwardModel, *, names: tuple[str, ...]
) -> dict[str, float] | None:
    """Return the inputs of a synthetic observation."""
    if isinstance(source, list) or source.synthetic is None:
        return None
    check_complete(source.synthetic, names, model, "observation.synthetic")
    return dict(source.synthetic)


def _synthetic_noise(content: StudyFile) -> SyntheticNoise | None:
    """Return the noise of a synthetic observation; its seed is the study's if it has none."""
    source = content.observation
    if isinstance(source, list) or source.noise is None:
        return None
    seed = source.noise.seed
    return SyntheticNoise(source.noise.sd, content.seed if seed is None else seed)


def _reused_ledger(folder: Path, other: str) -> Path:
    target = folder / other
    try:
        found = target.is_dir()
    except (OSError, ValueError):  # a name too long, or one that the system cannot hold
        found = False
    if not found:
        raise InvalidStudy(
            "reuse",
            value=other,
            expected="the folder of another study, relative to this one",
            remedy="Correct the path or remove it.",
        )
    return target / LEDGER
