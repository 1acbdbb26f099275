"""The results of a finished study, read back: its posterior, its figures, and other posteriors from the same runs."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design.refinement import Refinement
from strandline.discrepancy import DISCREPANCIES, Discrepancy
from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import GaussianNoise, PointErrors, UnknownErrors
from strandline.models.fidelities import is_cheaper
from strandline.posterior import Posterior, from_datatree, read
from strandline.report.plots.pairs import PosteriorPlots
from strandline.runs import InProcess
from strandline.studies.folder import POSTERIOR, SUMMARY
from strandline.studies.models import cheaper_dropped
from strandline.studies.observed import noisy
from strandline.studies.parse import made, open_entry
from strandline.studies.study import Study, load_study


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A finished study.

    Args:
        study: The study as its folder now has it.
        posterior: Posterior that its last `strandline run` or `report` wrote.
        summary: Content of summary.json.
    """

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

        Args:
            sd: Standard deviation σ_N, in the unit of the discrepancy d.
            variance: Variance σ_N² instead, in the unit of d².
            errors: Errors of the observed points instead.
            measure: Another measure too; by default the study's.

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

        Args:
            measure: A discrepancy, or its name in study files.
            options: Options of a measure given by its name.

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
            observed = study.observed
            if study.truth is not None:
                (record,) = ledger.latest([study.runs.key(study.truth)]).values()
                observed = noisy(record.interfaces, study.synthetic_noise)
            observations = study.observations(observed)
            problem = Problem(study.model, study.space, study.fixed, observations, study.discrepancies)
            return calibrate(problem, settings, ledger=ledger, executor=InProcess(), given=given)


def load_result(folder: Path | str) -> Result:
    """Return the results of the study in `folder`.

    Raises:
        InvalidStudy: The study is not finished, or study.yaml has changed since its results were written.
    """
    study = load_study(folder)
    study.runs.require_finished()
    try:
        summary = json.loads((study.folder / SUMMARY).read_text(encoding="utf-8"))
        posterior = from_datatree(read(study.folder / POSTERIOR), study.space)
    except (OSError, ValueError, InvalidInput) as error:
        raise _no_results(study, str(error)) from None
    if not isinstance(summary, dict) or summary.get("study_sha256") != study.text_digest:
        raise _no_results(study, "results of an earlier study.yaml")
    return Result(study, posterior, summary)


def _no_results(study: Study, found: str) -> InvalidStudy:
    return InvalidStudy(
        f"results in {study.folder}",
        value=found,
        expected="posterior.nc and summary.json of study.yaml as it is",
        remedy=f"Write them: strandline report {study.folder}",
    )
