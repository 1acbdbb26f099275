"""From a study folder to its results: the ledger, posterior.nc, summary.json, figures and report.html."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from strandline import __version__
from strandline.calibrate import Calibration, Observer, Problem, calibrate
from strandline.design import sobol
from strandline.errors import InvalidStudy
from strandline.interface import Interface, Observation
from strandline.models.protocol import fingerprint
from strandline.posterior import to_datatree, write
from strandline.report import write_report
from strandline.runs import Executor, Ledger, Progress, RunRecord, run_campaign, run_key
from strandline.studies.study import Study
from strandline.studies.summary import summarise

__all__ = ["Outcome", "check_ledgers", "design_keys", "require_finished", "require_writable", "run_study"]


@dataclass(frozen=True)
class Outcome:
    """A finished study: the calibration, its summary, and where the report lies."""

    calibration: Calibration
    summary: dict[str, Any]
    report: Path


def run_study(study: Study, *, executor: Executor | None = None, observer: Observer | None = None) -> Outcome:
    """Do the whole of a study; what the ledger holds already is not run again.

    Args:
        study: from `load_study`.
        executor: where forward runs are made, if not where the study says.
        observer: who is told how far it is.

    Raises:
        InvalidStudy: the folder cannot be written to, or the synthetic observation cannot be made.
        LedgerError: the ledger is locked, belongs to another model, or is damaged.
        TooFewRuns: too few forward runs succeeded.
    """
    require_writable(study.folder)
    executor, observer, made = executor or study.executor, observer or Observer(), _Counter()
    with Ledger.open(study.ledger_path, model=fingerprint(study.model), description=study.name) as ledger:
        _take_over(study, ledger)
        observation = Observation(_observe(study, ledger, executor, observer), study.noise_variance)
        problem = Problem(study.model, study.space, study.fixed, (observation,), study.discrepancies)
        calibration = calibrate(
            problem, study.settings, ledger=ledger, executor=executor, observer=made.listening(observer)
        )
    return _write_results(study, calibration, made.number, observer)


def design_keys(study: Study) -> list[str]:
    """Return the ledger keys of the study's design, in its order."""
    identity = fingerprint(study.model)
    design = study.space.to_physical(sobol(study.settings.runs, study.space.dim, scramble=study.settings.scramble))
    return [run_key(identity, {**study.fixed, **study.space.as_mapping(x)}) for x in design]


def require_writable(folder: Path) -> None:
    """Refuse a folder in which no file can be made."""
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidStudy(
            "the study folder cannot be written to",
            value=str(folder),
            expected="a folder with write permission, for the ledger and the results",
            remedy="Change its permissions, or copy the study elsewhere.",
        )


def check_ledgers(study: Study) -> None:
    """Refuse a ledger of another model, a damaged one, or one that a newer strandline made; own and reused."""
    for path in (study.ledger_path, *study.reuse):
        if path.is_file():
            with Ledger.open(path, model=fingerprint(study.model), read_only=True):
                pass


def require_finished(study: Study) -> None:
    """Refuse a study whose design has runs that are not made yet."""
    keys, done = design_keys(study), 0
    if study.ledger_path.is_file():
        with Ledger.open(study.ledger_path, model=fingerprint(study.model), read_only=True) as ledger:
            done = sum(record.final for record in ledger.latest(keys).values())
    if done < len(set(keys)):
        raise InvalidStudy(
            "the study is not finished",
            value=f"{done} of {len(set(keys))} forward runs done",
            expected="a finished study",
            remedy=f"Run it first: strandline run {study.folder}",
        )


def _take_over(study: Study, ledger: Ledger) -> None:
    """Copy runs of other studies that this one needs and has not made itself."""
    keys = design_keys(study)
    if study.truth is not None:
        keys.append(run_key(ledger.model, study.truth))
    for other in study.reuse:
        known = ledger.latest(keys)
        missing = [key for key in keys if key not in known]
        if missing and other.is_file():
            ledger.copy_from(other, missing)


def _observe(study: Study, ledger: Ledger, executor: Executor, observer: Observer) -> Interface:
    """Return the observed interface; a synthetic one is a run of the model like any other."""
    if isinstance(study.observed, Interface):
        return study.observed
    observer.stage("observation")
    (record,) = run_campaign(study.model, [study.observed], ledger=ledger, executor=executor)
    if record.interface is None:
        raise InvalidStudy(
            "the synthetic observation could not be made",
            value=f"{dict(study.observed)}: {record.failure_kind or record.state}",
            expected="inputs at which the model runs",
            remedy="Choose other values under observation.synthetic.",
        )
    return record.interface


def _write_results(study: Study, calibration: Calibration, new_runs: int, observer: Observer) -> Outcome:
    """Write every result whole or not at all, the summary last: where it stands, the rest does too."""
    observer.stage("report")
    begun = time.perf_counter()
    attributes = {"study": study.name, "strandline_version": __version__}
    tree = to_datatree(
        calibration.posterior,
        seed=study.settings.seed,
        attrs=attributes,
        observed=calibration.problem.observations,
    )
    write(tree, study.folder / "posterior.nc")
    summary = summarise(study, calibration, new_runs=new_runs, reused_runs=len(calibration.records) - new_runs)
    report = write_report(calibration, summary, study_text=study.text, truth=study.truth, folder=study.folder)
    summary["seconds"]["report"] = time.perf_counter() - begun
    with _whole_file(study.folder / "summary.json") as path:
        path.write_text(json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    return Outcome(calibration, summary, report)


@contextmanager
def _whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name and move the finished file to `path`."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


class _Counter:
    """Counts the forward runs that were made."""

    def __init__(self) -> None:
        self.number = 0

    def listening(self, observer: Observer) -> Observer:
        def run(record: RunRecord, progress: Progress) -> None:
            self.number += 1
            observer.run(record, progress)

        return replace(observer, run=run)
