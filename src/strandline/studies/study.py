"""A study: a folder with study.yaml, loaded and checked as far as that goes without a forward run."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

from strandline.calibrate import Settings
from strandline.discrepancy import Discrepancy
from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel, asks_sensitivities, declared_conditions
from strandline.parameters import ParameterSpace
from strandline.refinement import Refinement
from strandline.runs import Executor
from strandline.smc import SMCSettings
from strandline.studies import build
from strandline.studies.executors import build_executor
from strandline.studies.folder import LEDGER
from strandline.studies.known_model import as_in_ledgers
from strandline.studies.observed import SyntheticNoise, read_points, require_plausible
from strandline.studies.parse import parse_study
from strandline.studies.schema import ConditionFile, ObservationFile, StudyFile

__all__ = ["Study", "load_study"]

FEW_INPUTS = 3
"""Inputs up to which a surrogate of the log-likelihood that is there to compare has one length scale."""


@dataclass(frozen=True)
class Study:
    """All that study.yaml says, as objects of the domain.

    Args:
        folder: where the study lies and its results go.
        name: of the study.
        text: of study.yaml, kept for provenance.
        model: the simulator, asked for sensitivities where the study wants them.
        space: the unknown inputs.
        fixed: the known inputs.
        discrepancies: measures by name; the first one makes the posterior.
        noise_variance: σ_N², in the unit of d²; of every condition.
        observed: the observed interfaces by condition, mm; empty where the model makes synthetic ones.
        truth: the inputs at which the model makes a synthetic observation of each of its conditions, or None.
        synthetic_noise: what is added to a synthetic observation, or None.
        turned: the conditions whose observed points ran the other way round and were turned.
        settings: how the posterior is computed.
        executor: where forward runs are made.
        reuse: ledgers of other studies whose runs are taken over where they fit.
        as_loaded: What study.yaml says, to notice what was replaced since; None for a study made otherwise.
    """

    folder: Path
    name: str
    text: str
    model: ForwardModel
    space: ParameterSpace
    fixed: Mapping[str, float]
    discrepancies: Mapping[str, Discrepancy]
    noise_variance: float
    observed: Mapping[str, Interface]
    truth: Mapping[str, float] | None
    synthetic_noise: SyntheticNoise | None
    turned: tuple[str, ...]
    settings: Settings
    executor: Executor
    reuse: tuple[Path, ...]
    as_loaded: "Study | None" = field(default=None, repr=False, compare=False)

    @property
    def ledger_path(self) -> Path:
        """The ledger of this study's runs."""
        return self.folder / LEDGER

    @property
    def text_digest(self) -> str:
        """Tells whether results belong to study.yaml as it is."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def sensitivities(self) -> bool:
        """Whether the runs are to yield sensitivities too."""
        return asks_sensitivities(self.model)


def load_study(folder: Path) -> Study:
    """Return the study in `folder`; nothing is written and no forward run is made.

    Raises:
        InvalidStudy: see `parse_study`, or any value in it that cannot be used.
    """
    content, text = parse_study(folder)
    model = build.build_model(content.model, folder, sensitivities=content.sensitivities)
    reuse = tuple(_reused_ledger(folder, other) for other in content.reuse)
    model = as_in_ledgers(model, (folder / LEDGER, *reuse))
    space, fixed = build.build_space(content.inputs, model), build.build_fixed(content, model)
    truth = _truth(content.observation, model, names=(*space.names, *fixed))
    observed, turned = ({}, ()) if truth is not None else _observed(folder, content.observation, model)
    study = Study(
        folder=folder,
        name=content.name,
        text=text,
        model=model,
        space=space,
        fixed=fixed,
        discrepancies=build.build_discrepancies(content.discrepancy),
        noise_variance=content.noise.squared,
        observed=observed,
        truth=truth,
        synthetic_noise=_synthetic_noise(content),
        turned=turned,
        settings=_settings(content, model),
        executor=build_executor(content.executor, folder),
        reuse=reuse,
    )
    return replace(study, as_loaded=study)


def _settings(content: StudyFile, model: ForwardModel) -> Settings:
    smc, sobol, refine = content.sampler.smc, content.design.sobol, content.design.refine
    build.check_refine(refine, smc.particles)
    dim, log_likelihood = len(content.inputs), content.surrogate.log_likelihood
    active = build.build_active(content.design.active, dim, sensitivities=content.sensitivities)
    if sobol is not None and content.surrogate.field is None:
        build.check_runs(sobol.runs, dim)
    by_field = active is not None or content.surrogate.field is not None
    kernel = None if log_likelihood is None else log_likelihood.kernel
    start = content.design.active if sobol is None else sobol
    return Settings(
        runs=sobol.runs if sobol is not None else (active.initial if active and active.initial else 0),
        scramble=None if start is None else start.scramble,
        refine=Refinement() if refine is None else Refinement(refine.rounds, refine.runs, refine.temperature),
        kernel=build.check_kernel(kernel or ("matern32" if dim <= FEW_INPUTS or not by_field else "matern32_product")),
        surrogate="field" if by_field else "log_likelihood",
        active=active,
        particles=smc.particles,
        smc=SMCSettings(rejuvenation_steps=smc.rejuvenation_steps, zeta=smc.zeta),
        seed=content.seed,
        nuisance_values=content.sampler.cut.values,
        failures=build.build_failures(content.failures, model),
    )


def _truth(
    source: ObservationFile | list[ConditionFile], model: ForwardModel, *, names: tuple[str, ...]
) -> dict[str, float] | None:
    """Return the inputs of a synthetic observation."""
    if isinstance(source, list) or source.synthetic is None:
        return None
    build.check_complete(source.synthetic, names, model, "observation.synthetic")
    return dict(source.synthetic)


def _synthetic_noise(content: StudyFile) -> SyntheticNoise | None:
    """Return the noise of a synthetic observation; its seed is the study's where it has none."""
    source = content.observation
    if isinstance(source, list) or source.noise is None:
        return None
    seed = source.noise.seed
    return SyntheticNoise(source.noise.sd, content.seed if seed is None else seed)


def _observed(
    folder: Path, source: ObservationFile | list[ConditionFile], model: ForwardModel
) -> tuple[dict[str, Interface], tuple[str, ...]]:
    """Return the observed interfaces by condition, and the conditions whose points were turned round."""
    files = {item.condition: item for item in source} if isinstance(source, list) else {"": source}
    known = declared_conditions(model)
    for condition in files:
        if condition not in known:
            raise _unknown_condition(condition, known)
    read = {condition: _read(folder, item, model) for condition, item in files.items()}
    turned = tuple(condition for condition, (_, was_turned) in read.items() if was_turned)
    return {condition: interface for condition, (interface, _) in read.items()}, turned


def _unknown_condition(condition: str, known: tuple[str, ...]) -> InvalidStudy:
    if not any(known):
        return InvalidStudy(
            "observation: the model has a single condition without a name",
            value=condition,
            expected="one mapping, observation: {file: …, unit: …}",
            remedy="Remove the list and `condition`, or let the model declare its `conditions`.",
        )
    close = get_close_matches(condition, known, n=1)
    return InvalidStudy(
        "observation: the model has no such condition" if condition else "observation: the condition is not named",
        value=condition or "no name",
        expected=f"some of {', '.join(known)}",
        remedy=f"Did you mean {close[0]}?" if close else "Give a list, - {condition: NAME, file: …, unit: …}.",
    )


def _read(folder: Path, source: ObservationFile, model: ForwardModel) -> tuple[Interface, bool]:
    """Return an observed interface, run through as the model's is, and whether it was turned for that."""
    path = folder / str(source.file)
    interface = read_points(path, str(source.unit), options=source.reading)
    undeformed = getattr(model, "undeformed", None)
    if undeformed is None:
        return interface, False
    require_plausible(f"observation {path.name}", interface, undeformed(), unit=str(source.unit))
    turned = interface.runs_against(undeformed())
    return (interface.reversed() if turned else interface), turned


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
