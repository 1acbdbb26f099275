"""The results of a finished study, read back: its posterior, its figures, and other posteriors from the same runs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design import Refinement
from strandline.discrepancy import Discrepancy
from strandline.foundations import read_json
from strandline.interface import GaussianNoise, Noise, PointErrors, UnknownErrors
from strandline.models import is_cheaper
from strandline.posterior import Posterior
from strandline.report import PosteriorPlots
from strandline.runs import InProcess
from strandline.studies.foresight.check import finished_posterior
from strandline.studies.foresight.first_run import observations_of
from strandline.studies.keys.folder import SUMMARY
from strandline.studies.load.load import load_study
from strandline.studies.load.models import cheaper_dropped
from strandline.studies.load.study import Study


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A finished study as its folder now has it, with the posterior and the summary that were written last."""

    study: Study
    posterior: Posterior
    summary: dict[str, Any]

    def __repr__(self) -> str:
        return f"<Result of {self.study.name}: {self.posterior!r}>"

    def _repr_html_(self) -> str:
        return self.posterior._repr_html_()

    @property
    def plot(self) -> PosteriorPlots:
        """Figures of the posterior: ``result.plot.joint(ax=ax)``."""
        return PosteriorPlots(self.posterior)

    def with_noise(
        self, noise: float | Noise | PointErrors | UnknownErrors, measure: Discrepancy | None = None
    ) -> Calibration:
        """Return the posterior under another noise, from the existing runs; nothing is written.

        The noise is a variance σ_N² in the unit of d² [mm² or mm], or a model of it, or errors of the observed points;
        it takes the place of all that the study says of its noise, shared errors too. The measure is the study's by
        default.

        Raises:
            InvalidInput: The variance is not above 0.
        """
        measures = self.study.discrepancies if measure is None else {type(measure).__name__: measure}
        stated = GaussianNoise(noise) if isinstance(noise, float) else noise
        study = replace(self.study, noise=stated, noises={}, discrepancies=measures)
        settings: Settings = replace(study.settings, active=None, refine=Refinement())
        synthetic = None if study.truth is None else study.runs.key(study.truth)
        dropped = cheaper_dropped(study.folder)
        with study.runs.ledger() as ledger:
            records = ledger.latest([key for key in study.runs.needed_keys if key != synthetic]).values()
            given = [record.inputs for record in records if not (dropped and is_cheaper(record.inputs))]
            observations = study.observations(observations_of(study))
            problem = Problem(study.model, study.space, study.fixed, observations, study.discrepancies)
            return calibrate(problem, settings, ledger=ledger, executor=InProcess(), given=given)


def load_result(folder: Path | str) -> Result:
    """Return the results of the study in `folder`.

    Raises:
        InvalidStudy: The study is not finished, or study.yaml has changed since its results were written.
    """
    study = load_study(folder)
    study.runs.require_finished()
    posterior = finished_posterior(study, purpose="load")
    return Result(study, posterior, read_json(study.folder / SUMMARY))
