"""The results of a finished study, read back: its posterior, its figures, and other posteriors from the same runs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design import Refinement
from strandline.discrepancy import DISCREPANCIES, Discrepancy
from strandline.foundations import InvalidInput, read_json
from strandline.interface import GaussianNoise, PointErrors, UnknownErrors
from strandline.models import is_cheaper
from strandline.posterior import Posterior
from strandline.report import PosteriorPlots
from strandline.runs import InProcess
from strandline.studies.foresight.check import finished_posterior
from strandline.studies.foresight.first_run import observations_of
from strandline.studies.keys.folder import SUMMARY
from strandline.studies.keys.parse import made, open_entry
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
        self,
        *,
        sd: float | None = None,
        variance: float | None = None,
        errors: PointErrors | UnknownErrors | None = None,
        measure: Discrepancy | None = None,
    ) -> Calibration:
        """Return the posterior under another noise, from the existing runs; nothing is written.

        The noise is a standard deviation σ_N in the unit of d, or a variance σ_N² in that of d², or errors of the
        observed points. The measure is the study's by default.

        Raises:
            InvalidInput: Not one of the three is given, or the number is not above 0.
        """
        if sum(one is not None for one in (sd, variance, errors)) != 1:
            raise InvalidInput(
                "noise of another posterior",
                value="none" if sd is None and variance is None and errors is None else "more than one",
                expected="one of sd, variance and errors",
                remedy="Give one, e.g. with_noise(sd=0.01).",
            )
        others = {} if measure is None else {"discrepancies": {type(measure).__name__: measure}}
        if errors is not None:
            return self._calibrated(noise=errors, noises={}, **others)
        noise = GaussianNoise(float(variance if sd is None else sd**2))  # type: ignore[arg-type]
        return self._calibrated(noise=noise, noises={}, **others)

    def with_measure(self, measure: str | Discrepancy, **options: Any) -> Calibration:
        """Return the posterior under another measure, from the existing runs; nothing is written.

        The measure is an object, or its name in study files, with its options.

        Raises:
            InvalidInput: There is no such measure, or it has no such option.
        """
        if isinstance(measure, str):
            factory = open_entry(DISCREPANCIES, measure, "measure", "a discrepancy")
            return self._calibrated(discrepancies={measure: made(factory, options, f"measure {measure}")})
        if options:
            raise InvalidInput(
                "options of a measure that is an object",
                value=", ".join(options),
                expected="options with a name only",
                remedy="Give them where the measure is made.",
            )
        return self._calibrated(discrepancies={type(measure).__name__: measure})

    @cached_property
    def _inputs(self) -> list[Mapping[str, float]]:
        """Inputs of all runs that are used, in the order in which the study asked for them."""
        runs, truth = self.study.runs, self.study.truth
        synthetic = None if truth is None else runs.key(truth)
        with runs.ledger() as ledger:
            records = ledger.latest([key for key in runs.needed_keys if key != synthetic]).values()
        dropped = cheaper_dropped(self.study.folder)
        return [record.inputs for record in records if not (dropped and is_cheaper(record.inputs))]

    def _calibrated(self, **changes: Any) -> Calibration:
        study = replace(self.study, **changes)
        settings: Settings = replace(study.settings, active=None, refine=Refinement())
        given = self._inputs
        with study.runs.ledger() as ledger:
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
