"""From a study folder to its results, the ledger, posterior.nc, summary.json, figures and report.html; and back."""

import io
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import Any

from strandline import foundations
from strandline import report as pages
from strandline.calibration import Calibration, Observer, Problem, Settings, calibrate, observer_or_default
from strandline.design import BatchReport, Refinement
from strandline.discrepancy import Discrepancy
from strandline.interface import GaussianNoise, Interface, Noise, PointErrors, UnknownErrors
from strandline.likelihood import compared
from strandline.models import is_cheaper, prepare_runs
from strandline.posterior import Posterior, to_datatree, write
from strandline.runs import Executor, FailurePolicy, InProcess, Ledger, Progress, RunRecord, run_campaign
from strandline.studies.foresight.check import finished_posterior, read_check
from strandline.studies.foresight.first_run import observations_of, require_ok, require_same_axes, require_same_size
from strandline.studies.keys.folder import POSTERIOR, REPORT, SUMMARY, require_writable
from strandline.studies.load.load import load_study
from strandline.studies.load.models import cheaper_dropped
from strandline.studies.load.observed import noisy
from strandline.studies.load.provenance import require_its_own_text
from strandline.studies.load.study import Study, require_study
from strandline.studies.write.shown import pictures_in_page
from strandline.studies.write.summary import summarise

TELLING_RUNS = 4
"""A study ends if this many first successful runs are all ten times larger or smaller than the observation, or lie far
from it and would not if its axes were others."""


@dataclass(frozen=True)
class Outcome:
    """A finished study: the calibration, its summary, and the path of the report, None if the study wants none."""

    calibration: Calibration
    summary: dict[str, Any]
    report: Path | None

    def __repr__(self) -> str:
        return f"<Outcome {self.calibration.posterior.line}; report: {self.report}>"

    def _repr_html_(self) -> str:
        return self.calibration._repr_html_()


def run_study(study: Study, *, executor: Executor | None = None, observer: Observer | None = None) -> Outcome:
    """Run a whole study; forward runs that the ledger already holds are not made again.

    They are made where the study says if no executor is given. The observer receives the progress.

    Raises:
        InvalidStudy: The folder cannot be written to, the synthetic observation cannot be made, or the study was
            changed after it was loaded.
        LedgerError: The ledger is locked, belongs to another model, or is damaged.
        InvalidInput: A measure cannot be evaluated on the observed interface, or a library that writes the results
            does not work.
        TooFewRuns: Too few forward runs succeeded.
        ResultsNotWritten: Some result files could not be written; the others were.
    """
    require_study(study)
    require_its_own_text(study)
    require_writers()
    require_writable(study.folder)
    study.runs.require_sound_ledgers()
    executor, observer, made = executor or study.executor, observer_or_default(observer), set[str]()

    def run(record: RunRecord, progress: Progress) -> None:
        made.add(record.key)
        observer.run(record, progress)

    told = replace(observer, run=run)
    with study.runs.ledger() as ledger:
        given = study.runs.begin_active(ledger)
        ledger.plan(study.runs.plan)
        study.runs.take_over(ledger)
        prepare_runs(study.model, observer.stage)
        observed = _observe(study, ledger, executor, observer)
        observations = study.observations(observed)
        problem = Problem(study.model, study.space, study.fixed, observations, study.discrepancies)
        for discrepancy in problem.discrepancies.values():  # tried on itself, so that errors come before the runs
            for seen in problem.observations:
                compared(seen, discrepancy, len(seen.interface.points)).measure(seen.interface, seen.interface)
        with _told_if_nothing_near(study, problem, ledger):
            calibration = calibrate(
                problem,
                study.settings,
                ledger=ledger,
                executor=executor,
                observer=_noting_rounds(_checking_sizes(told, study), study, ledger),
                given=given,
            )
        if study.settings.active is not None:
            study.runs.note(finished=True)  # its runs are all that the study needs
        ledger.plan(study.runs.plan)
    return _write_results(study, calibration, len(made), observer)


def submit_study(study: Study, *, executor: Executor, observer: Observer | None = None) -> None:
    """Submit the runs that are known to be needed and not yet made to an executor that does not wait for them.

    The executor raises when all of them have been submitted. Runs collected in the meantime are reported.
    """
    require_its_own_text(study)
    require_writers()
    require_writable(study.folder)
    study.runs.require_sound_ledgers()
    tell = observer_or_default(observer)
    inputs = [*([] if study.truth is None else [study.truth]), *study.runs.design]
    with study.runs.ledger() as ledger:
        study.runs.take_over(ledger)
        tell.stage("forward")
        run_campaign(study.model, inputs, ledger=ledger, executor=executor, on_record=tell.run)


@contextmanager
def _told_if_nothing_near(study: Study, problem: Problem, ledger: Ledger) -> Iterator[None]:
    """Name the cause of an analysis that fails because no run comes near the observation."""
    try:
        yield
    except foundations.InvalidStudy:
        raise
    except (foundations.NumericsError, ArithmeticError, ValueError) as error:
        known = ledger.latest(study.runs.design_keys)
        records = [record for record in known.values() if record.ok]
        message = pages.nothing_near(pages.nearest_runs(problem, records)) if records else None
        if message is None:
            raise
        raise foundations.NumericsError(f"{message} The analysis failed: {error}") from error


def _noting_rounds(observer: Observer, study: Study, ledger: Ledger) -> Observer:
    """Return an observer that also notes each round of refinement and takes over its runs from other studies."""
    numbers = count()

    def draws(inputs: Sequence[Mapping[str, float]]) -> None:
        study.runs.begin_round(next(numbers), inputs)
        ledger.plan(study.runs.plan)
        study.runs.take_over(ledger)
        observer.draws(inputs)

    def batch(report: BatchReport) -> None:
        study.runs.note(last_batch=report.line)
        observer.batch(report)

    return replace(observer, draws=draws, batch=batch)


def _checking_sizes(observer: Observer, study: Study) -> Observer:
    """Return an observer that ends the study if none of its first runs has size and axes of the observation."""
    found: list[foundations.InvalidStudy | None] = []

    def run(record: RunRecord, progress: Progress) -> None:
        observer.run(record, progress)
        if record.ok and len(found) < TELLING_RUNS:
            try:
                require_same_size(study, record)
                require_same_axes(study, record)
                found.append(None)
            except foundations.InvalidStudy as error:
                found.append(error)  # a single run of another size is set aside later
                if len(found) == TELLING_RUNS and None not in found:
                    raise

    return replace(observer, run=run)


def _observe(study: Study, ledger: Ledger, executor: Executor, observer: Observer) -> Mapping[str, Interface]:
    if study.truth is None:
        return study.observed
    observer.stage("observation")
    policy = FailurePolicy(again=study.settings.failures.again)
    (record,) = run_campaign(study.model, [study.truth], ledger=ledger, executor=executor, policy=policy)
    again = f"`strandline retry {study.folder} --kind {record.failure_kind or record.state}`"
    remedy = f"Choose other values under observation.synthetic; or remove the cause, and run {again}."
    require_ok(record, "of the synthetic observation", remedy)
    return noisy(record.interfaces, study.synthetic_noise)


def _write_results(study: Study, calibration: Calibration, new_runs: int, observer: Observer) -> Outcome:
    """Write every result, the summary last: what it does not name as missing exists too and belongs to it."""
    observer.stage("report")
    begun = time.perf_counter()
    summary = summarise(study, calibration, new_runs=new_runs, reused_runs=len(calibration.all_runs) - new_runs)
    results, report = Results(study.folder), study.folder / REPORT if study.with_report else None
    with suppress(OSError):
        (study.folder / SUMMARY).unlink(missing_ok=True)
    both, seen = calibration.under_uncertainty, calibration.problem.observations
    attrs = {"study": study.name, "strandline_version": foundations.__version__}
    cut = None if both is None else both.cut
    with results.writing(POSTERIOR):
        tree = to_datatree(calibration.posterior, seed=study.settings.seed, attrs=attrs, observed=seen, cut=cut)
        write(tree, study.folder / POSTERIOR)
    with results.writing(REPORT):
        if report is None:
            pages.remove_report(study.folder)
        else:
            pages.write_report(
                calibration,
                summary | {"warnings": [*results.warnings(), *summary["warnings"]]},
                study_text=study.text,
                truth=study.truth,
                folder=study.folder,
                check=read_check(study.folder, calibration.posterior),
                pictures=pictures_in_page(study),
                on_failure=results.failed,
            )
    summary |= {"missing": dict(results.missing), "warnings": [*results.warnings(), *summary["warnings"]]}
    summary["seconds"]["report"] = time.perf_counter() - begun
    with results.writing(SUMMARY):
        foundations.write_json(study.folder / SUMMARY, summary)
    outcome = Outcome(calibration, summary, report)
    if results.missing:
        raise foundations.ResultsNotWritten(study.folder, results.missing, outcome) from results.first
    return outcome


def require_writers() -> None:
    """Refuse to start if the libraries that write posterior.nc, the figures or the report do not work."""
    figures, page = partial(import_module, "matplotlib.backends.backend_pdf"), partial(pages.template, "report.html.j2")
    trials: dict[str, Callable[[], object]] = {POSTERIOR: _try_netcdf, pages.FIGURES: figures, REPORT: page}
    for name, trial in trials.items():
        try:
            trial()
        except Exception as error:
            what = f"{name} could not be written at the end"
            expected = "the libraries that strandline is installed with"
            remedy = "Install strandline again with its dependencies (`pip install --force-reinstall strandline`)."
            raise foundations.InvalidInput(what, value=reason(error), expected=expected, remedy=remedy) from error


class Results:
    """Writes the results of a study one by one; one that fails does not keep the others from being written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: dict[str, str] = {}
        self.first: Exception | None = None

    @contextmanager
    def writing(self, name: str) -> Iterator[None]:
        """Note an error inside the block as a failure to write the file `name`, and go on."""
        try:
            yield
        except Exception as error:
            self.failed(name, error)

    def failed(self, name: str, error: Exception) -> None:
        """Note why `name` is missing, and remove an older file of that name: it does not belong to these results."""
        self.missing[name] = reason(error)
        self.first = self.first or error
        with suppress(OSError):
            (self.folder / name).unlink(missing_ok=True)
        if name == pages.FIGURES:
            old = set((self.folder / pages.FIGURES).glob("*"))
            for figure in old - pages.of_other_pages(self.folder / pages.FIGURES):
                with suppress(OSError):
                    figure.unlink()
            with suppress(OSError):
                (self.folder / pages.FIGURES).rmdir()

    def warnings(self) -> list[str]:
        return [f"{name} could not be written: {why}" for name, why in self.missing.items()]


def reason(error: Exception) -> str:
    """Return why something failed, on one line."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")


def _try_netcdf() -> None:
    import h5netcdf

    h5netcdf.File(io.BytesIO(), "w").close()


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
    def plot(self) -> pages.PosteriorPlots:
        """Figures of the posterior: ``result.plot.joint(ax=ax)``."""
        return pages.PosteriorPlots(self.posterior)

    def with_noise(
        self, noise: float | Noise | PointErrors | UnknownErrors, measure: Discrepancy | None = None
    ) -> Calibration:
        """Return the posterior under another noise, from the existing runs; nothing is written.

        The noise is a variance σ_N² in the unit of d² [mm² or mm], or a model of it, or errors of the observed points;
        it takes the place of all that the study says of its noise, shared errors too. By default, the measure stays.

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
    return Result(study, posterior, foundations.read_json(study.folder / SUMMARY))
