"""A study: a folder with study.yaml, loaded and checked as far as that goes without a forward run."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from strandline.calibrate import Settings
from strandline.discrepancy import Discrepancy
from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel
from strandline.parameters import ParameterSpace
from strandline.runs import Executor, LocalProcesses
from strandline.smc import SMCSettings
from strandline.studies import build
from strandline.studies.folder import LEDGER
from strandline.studies.observed import read_points, require_plausible
from strandline.studies.parse import parse_study
from strandline.studies.schema import ObservationFile, StudyFile

__all__ = ["Study", "load_study"]


@dataclass(frozen=True)
class Study:
    """All that study.yaml says, as objects of the domain.

    Args:
        folder: where the study lies and its results go.
        name: of the study.
        text: of study.yaml, kept for provenance.
        model: the simulator.
        space: the unknown inputs.
        fixed: the known inputs.
        discrepancies: measures by name; the first one makes the posterior.
        noise_variance: σ_N², in the unit of d².
        observed: the observed interface, mm; or the inputs at which the model makes a synthetic one.
        observation_turned: whether the observed points ran the other way round and were turned.
        settings: how the posterior is computed.
        executor: where forward runs are made.
        reuse: ledgers of other studies whose runs are taken over where they fit.
    """

    folder: Path
    name: str
    text: str
    model: ForwardModel
    space: ParameterSpace
    fixed: Mapping[str, float]
    discrepancies: Mapping[str, Discrepancy]
    noise_variance: float
    observed: Interface | Mapping[str, float]
    observation_turned: bool
    settings: Settings
    executor: Executor
    reuse: tuple[Path, ...]

    @property
    def ledger_path(self) -> Path:
        """The ledger of this study's runs."""
        return self.folder / LEDGER

    @property
    def text_digest(self) -> str:
        """Tells whether results belong to study.yaml as it is."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def truth(self) -> Mapping[str, float] | None:
        """The inputs of a synthetic observation."""
        return None if isinstance(self.observed, Interface) else self.observed


def load_study(folder: Path) -> Study:
    """Return the study in `folder`; nothing is written and no forward run is made.

    Raises:
        InvalidStudy: see `parse_study`, or any value in it that cannot be used.
    """
    content, text = parse_study(folder)
    model = build.build_model(content.model)
    space, fixed = build.build_space(content.inputs, model), build.build_fixed(content, model)
    observed, turned = _observation(folder, content.observation, model, names=(*space.names, *fixed))
    return Study(
        folder=folder,
        name=content.name,
        text=text,
        model=model,
        space=space,
        fixed=fixed,
        discrepancies=build.build_discrepancies(content.discrepancy),
        noise_variance=content.noise.variance or (content.noise.sd or 0.0) ** 2,
        observed=observed,
        observation_turned=turned,
        settings=_settings(content),
        executor=LocalProcesses(workers=content.executor.local.workers, timeout=content.executor.local.timeout),
        reuse=tuple(_reused_ledger(folder, other) for other in content.reuse),
    )


def _settings(content: StudyFile) -> Settings:
    smc, sobol = content.sampler.smc, content.design.sobol
    build.check_runs(sobol.runs, len(content.inputs))
    return Settings(
        runs=sobol.runs,
        scramble=sobol.scramble,
        kernel=build.check_kernel(content.surrogate.log_likelihood.kernel),
        particles=smc.particles,
        smc=SMCSettings(rejuvenation_steps=smc.rejuvenation_steps, zeta=smc.zeta),
        seed=content.seed,
    )


def _observation(
    folder: Path, source: ObservationFile, model: ForwardModel, *, names: tuple[str, ...]
) -> tuple[Interface | Mapping[str, float], bool]:
    """Return the observed interface or the inputs of a synthetic one, and whether it was turned round."""
    if source.synthetic is not None:
        build.check_complete(source.synthetic, names, model, "observation.synthetic")
        return dict(source.synthetic), False
    path = folder / str(source.file)
    interface = read_points(path, str(source.unit))
    undeformed = getattr(model, "undeformed", None)
    if undeformed is None:
        return interface, False
    require_plausible(path, interface, undeformed(), unit=str(source.unit))
    turned = interface.runs_against(undeformed())
    return (interface.reversed() if turned else interface), turned


def _reused_ledger(folder: Path, other: str) -> Path:
    target = folder / other
    if not target.is_dir():
        raise InvalidStudy(
            "reuse",
            value=other,
            expected="the folder of another study, relative to this one",
            remedy="Correct the path or remove it.",
        )
    return target / LEDGER
