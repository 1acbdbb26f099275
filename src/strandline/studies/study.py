"""A study: a folder with study.yaml, loaded and checked as far as that goes without a forward run."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from strandline.calibrate import Settings
from strandline.discrepancy import Discrepancy
from strandline.errors import InvalidStudy
from strandline.interface import Interface
from strandline.models.protocol import ForwardModel, declared_inputs
from strandline.parameters import ParameterSpace
from strandline.runs import Executor, LocalProcesses
from strandline.smc import SMCSettings
from strandline.studies import build
from strandline.studies.observed import read_points
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
        return self.folder / "ledger.sqlite"

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
    observed, turned = _observation(folder, content.observation, model)
    return Study(
        folder=folder,
        name=content.name,
        text=text,
        model=model,
        space=build.build_space(content.inputs, model),
        fixed=build.build_fixed(content, model),
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
    return Settings(
        runs=sobol.runs,
        scramble=sobol.scramble,
        kernel=build.check_kernel(content.surrogate.log_likelihood.kernel),
        particles=smc.particles,
        smc=SMCSettings(rejuvenation_steps=smc.rejuvenation_steps, zeta=smc.zeta),
        seed=content.seed,
    )


def _observation(
    folder: Path, source: ObservationFile, model: ForwardModel
) -> tuple[Interface | Mapping[str, float], bool]:
    if source.synthetic is not None:
        build.check_values(source.synthetic, model, "observation.synthetic")
        missing = [item.name for item in declared_inputs(model) if item.name not in source.synthetic]
        if missing:
            raise InvalidStudy(
                "observation.synthetic",
                value=dict(source.synthetic),
                expected=f"a value for {', '.join(missing)} too",
                remedy="Name every input of the model.",
            )
        return dict(source.synthetic), False
    interface = read_points(folder / str(source.file), str(source.unit))
    undeformed = getattr(model, "undeformed", None)
    if undeformed is not None and interface.runs_against(undeformed()):
        return interface.reversed(), True
    return interface, False


def _reused_ledger(folder: Path, other: str) -> Path:
    target = folder / other
    if not target.is_dir():
        raise InvalidStudy(
            "reuse",
            value=other,
            expected="the folder of another study, relative to this one",
            remedy="Correct the path or remove it.",
        )
    return target / "ledger.sqlite"
