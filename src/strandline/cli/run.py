"""`strandline run`, `retry`, `report`: the whole study, failed runs again, the results again."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click
from click.shell_completion import CompletionItem

if TYPE_CHECKING:
    from strandline.calibration import Observer
    from strandline.runs import Executor, Progress, RunRecord
    from strandline.studies import Study

from strandline.cli import options
from strandline.foundations import ResultsNotWritten, with_sd


def _keys(context: click.Context, option: click.Parameter, start: str) -> list[CompletionItem]:
    """Return the keys of study.yaml that begin with what was typed, for the shell, with their meanings."""
    from strandline.studies import StudyFile, listed

    known = (key for key in listed(StudyFile) if key.name.startswith(start) and ".NAME" not in key.name)
    return [CompletionItem(f"{key.name}=", help=key.meaning) for key in known]


@click.command("run")
@options.study
@options.repeatable(
    "--set",
    "settings",
    "KEY=VALUE",
    "Run a copy of the study with another value, e.g. noise.sd=3; can be repeated.",
    shell_complete=_keys,
)
@click.option("--into", type=click.Path(path_type=Path, file_okay=False), help="Folder of that copy.")
@options.workers
@options.device
@click.option("--detach", is_flag=True, help="Submit the runs of a SLURM array and leave; `run` again collects them.")
@click.option("--json", "as_json", is_flag=True, help="Print the content of summary.json as one JSON object.")
@click.option("--log", type=click.File("a", encoding="utf-8"), help="Add the progress, with times, to a file.")
@click.option("--verbose", is_flag=True, help="Also show each run and step as it ends, and the settings of each stage.")
@options.quiet
def run(
    study: Path,
    settings: tuple[str, ...],
    into: Path | None,
    workers: int | None,
    device: str | None,
    detach: bool,
    as_json: bool,
    log: TextIO | None,
    verbose: bool,
    quiet: bool,
) -> None:
    """Do the whole of STUDY (a folder): forward runs, surrogate, posterior, figures, report.

    Finished runs are kept: started again, it goes on where it was stopped. A finished study is computed again only if
    its study.yaml, model, observation or runs have changed.

    With --set it leaves STUDY as it is and runs a copy beside it, named after the settings, which takes over all runs
    that fit; the same command again goes on there.
    """
    if verbose and quiet:
        raise click.UsageError("--verbose shows more, --quiet less: leave one out; --log FILE keeps the progress.")
    options.use_device(device)
    from strandline.cli.progress import detailed, observing, say_journal, set_aside_lines
    from strandline.runs import with_workers
    from strandline.studies import REPORT, load_study, results_at_hand, run_study

    study = _with_settings(study, settings, into, quiet=quiet)
    loaded = load_study(study)
    if (found := results_at_hand(loaded)) is not None:
        show(found, loaded.folder / REPORT if loaded.with_report else None, as_json=as_json)
        if not quiet and not as_json:
            click.echo(f"Nothing has changed since. To write the results again: strandline report {study}")
        return
    say_journal(loaded, quiet=quiet)
    executor = with_workers(loaded.executor, workers)
    details = partial(detailed, loaded, executor) if verbose else None
    with shown_also_if_incomplete(as_json=as_json), observing(quiet=quiet, log=log, details=details) as observer:
        if detach:
            _submit(loaded, executor, observer)
            return
        with _told_what_goes_on(loaded, executor), _doubting(loaded, executor, observer) as told:
            outcome = run_study(loaded, executor=executor, observer=told)
        if verbose:
            for line in set_aside_lines(outcome.summary):
                observer.note(line)
    show(outcome.summary, outcome.report, as_json=as_json)


@contextmanager
def _doubting(study: "Study", executor: "Executor", observer: "Observer") -> Iterator["Observer"]:
    """Yield the observer, which also says what the first run that succeeds shows to be wrong, and if none ends."""
    from strandline.cli.forward import told_if_slow
    from strandline.studies import early_doubts

    first = True
    endless = all(getattr(one, "timeout", None) is None for one in (executor, study.model))

    def _stage(name: str) -> None:
        observer.stage(name)
        waiting.close()
        if first and endless and name in ("observation", "forward"):
            waiting.enter_context(told_if_slow("the first run to end", observer.note))

    def _run(record: "RunRecord", progress: "Progress") -> None:
        nonlocal first
        waiting.close()
        if first and record.ok:
            first = False
            for line in early_doubts(study, record):
                observer.note(line)
        observer.run(record, progress)

    with ExitStack() as waiting:
        yield replace(observer, stage=_stage, run=_run)


def _with_settings(study: Path, settings: tuple[str, ...], into: Path | None, *, quiet: bool) -> Path:
    """Return the folder of the study with other values, or `study` itself if there are none."""
    from strandline.studies import changed_study

    if settings:
        folder, here = changed_study(study, settings, into), Path.cwd()
        if folder.is_relative_to(here) and folder != here:
            folder = folder.relative_to(here)
        if not quiet:
            click.echo(f"{', '.join(settings)}: the study in {folder}", err=True)
        return folder
    if into is not None:
        raise click.UsageError("--into is the folder of a copy with other values: add --set KEY=VALUE, or omit it.")
    return study


def _submit(study: "Study", executor: "Executor", observer: "Observer") -> None:
    """Submit all runs that `study` is known to need, and print what to do next."""
    from strandline.runs import Detached, SlurmArray
    from strandline.studies import submit_study

    if not isinstance(executor, SlurmArray):
        expected = "runs that go on without a driver, `executor: {slurm_array: …}` in study.yaml."
        raise click.UsageError(f"--detach: got the executor {type(executor).__name__}; expected {expected}")
    try:
        submit_study(study, executor=replace(executor, detach=True), observer=observer)
    except Detached as detached:
        click.echo(
            f"{detached.number} runs are with SLURM (`squeue --me`), their batches in {executor.folder}.\n"
            f"They go on by themselves. `strandline run {study.folder}` collects them and does the rest."
        )
    else:
        click.echo(f"every run of the design is done. `strandline run {study.folder}` makes the results.")


@contextmanager
def _told_what_goes_on(study: "Study", executor: "Executor") -> Iterator[None]:
    """Report the runs that continue in SLURM if the driver is interrupted."""
    from strandline.runs import SlurmArray, known_batches

    try:
        yield
    except KeyboardInterrupt:
        number = study.runs.open_attempts
        if number and isinstance(executor, SlurmArray):
            names = ",".join(batch.name for batch in known_batches(executor.folder))
            click.echo(f"runs that go on in SLURM: {number} (`scancel --name={names}` would end them)", err=True)
        raise


@click.command("retry")
@options.study
@options.repeatable(
    "--kind",
    "kinds",
    "KIND",
    "Kind of failure, or a state: failed, timeout, killed, invalid. May be given several times.",
    required=True,
)
@options.workers
@options.quiet
def retry(study: Path, kinds: tuple[str, ...], workers: int | None, quiet: bool) -> None:
    """Make the runs of STUDY that failed with KIND again, then the runs still missing, then the results.

    The earlier outcomes stay in the ledger; the last one of each run counts.
    """
    from strandline.cli.progress import say_journal
    from strandline.runs import require_kinds, with_workers
    from strandline.studies import load_study

    loaded = load_study(study)
    require_kinds(kinds, loaded.runs.failure_kinds)
    say_journal(loaded, quiet=quiet)
    policy = replace(loaded.settings.failures, again=frozenset(kinds))
    loaded = replace(loaded, settings=replace(loaded.settings, failures=policy))
    _run(loaded, with_workers(loaded.executor, workers), quiet=quiet)


@click.command("report")
@options.study
@options.device
@options.quiet
def report(study: Path, device: str | None, quiet: bool) -> None:
    """Write posterior, figures and report of STUDY again from its ledger.

    An active design samples again after each of its batches. No forward run is made, unless it learns from runs that
    ended after its last batch was chosen.
    """
    options.use_device(device)
    from strandline.studies import load_study

    loaded = load_study(study)
    loaded.runs.require_finished()
    _run(loaded, loaded.executor, quiet=quiet)


def _run(study: "Study", executor: "Executor", *, quiet: bool) -> None:
    from strandline.cli.progress import observing
    from strandline.studies import run_study

    with shown_also_if_incomplete(), observing(quiet=quiet) as observer:
        outcome = run_study(study, executor=executor, observer=observer)
    show(outcome.summary, outcome.report)


@contextmanager
def shown_also_if_incomplete(*, as_json: bool = False) -> Iterator[None]:
    """Print the results even if the command ends with an error because some result files could not be written."""
    try:
        yield
    except ResultsNotWritten as error:
        show(error.outcome.summary, error.outcome.report, as_json=as_json)
        raise


def show(summary: Mapping[str, Any], report: Path | None, *, as_json: bool = False) -> None:
    """Print the posterior, the checks and the warnings, or the content of summary.json."""
    if as_json:
        click.echo(json.dumps(summary))
        return
    from strandline.runs import counted

    runs, check, certificate = summary["runs"], summary["quadrature_check"], summary["certificate"]
    kinds = f"({counted(runs['by_kind'])}) " if runs["by_kind"] else ""
    click.echo(
        f"\n{summary['study']}: {runs['ok']} forward runs ok, {runs['failed']} failed {kinds}"
        f"({runs['new']} new, {runs['reused']} reused)"
    )
    head = f"{'input':>10} {'unit':>7} {'mean':>10} {'sd':>9} {'median':>10} {'5 %':>10} {'95 %':>10} {'MAP':>10}"
    if summary["inputs"]:
        click.echo(head)
    for name, item in summary["inputs"].items():
        click.echo(_row(name, item, "" if item["unit"] == "1" else item["unit"]))
    for name, one in summary.get("fields", {}).items():
        mean, unit = one["functionals"]["mean"], "" if one["unit"] == "1" else f" {one['unit']}"
        shown = f"field of {one['modes']} modes, mean {with_sd(mean['mean'], mean['sd'])}{unit}"
        click.echo(f"{name}: {shown}\n{one['statement']}")
    for reading, content in (summary["under_uncertainty"] or {}).items():
        click.echo(f"under uncertainty, {reading} reading (MAP: fullest of {content['map_bins']} bins per input):")
        for name, item in content["inputs"].items():
            click.echo(_row(name, item))
    click.echo(f"log-evidence {summary['log_evidence']:.3f}; effective samples {summary['sampler']['ess']:.0f}")
    if check is not None:
        click.echo(
            f"sampler against quadrature: means differ by {check['max_mean_error_sd']:.3f} sd, "
            f"standard deviations by {check['max_sd_ratio_error']:.1%}"
        )
    halves = summary["sampler_check"]
    if halves is not None and halves["agree"]:
        click.echo(halves["verdict"])
    if certificate is not None and certificate["converged"]:
        click.echo(f"{_certified(certificate)}\n{certificate['statement']}")
        if certificate.get("fidelities"):
            click.echo(certificate["fidelities"]["statement"])
    for warning in summary["warnings"]:
        line = f"warning: {warning}"
        click.echo(line if os.environ.get("NO_COLOR") else click.style(line, fg="yellow"))  # no-color.org
    seconds = ", ".join(f"{stage} {value:.1f}" for stage, value in summary["seconds"].items())
    click.echo(f"seconds: {seconds}")
    if summary.get("draft"):
        click.echo("a draft: remove `draft: true` from study.yaml for the result")
    if report is not None and report.name not in summary["missing"]:
        click.echo(f"report: {report}")
    if summary["nearest"]["message"]:
        click.echo(summary["nearest"]["message"])


def _certified(certificate: Mapping[str, Any]) -> str:
    """Return a line on the last check of an active design."""
    if certificate.get("exact"):
        return f"converged: {certificate['exact']}"
    check = certificate["check"]
    if check["effective"] is None:
        return (
            f"converged: at {check['draws']} draws of the posterior the logarithm of the true over the predicted "
            f"likelihood has sd {check['ratio_sd']:.2g}; a shift of a mean by {check['bound']:.2g} sd stays possible"
        )
    shift = max(map(abs, (*check["shift"].values(), check.get("largest_shift", 0.0))))
    if check["by"] == "left-out runs":
        return (
            f"converged: {check['draws']} runs at hand, each predicted from the others, give {check['effective']:.0%} "
            "effective weights by the true model; no new run was needed"
        )
    both = certificate.get("fidelities")
    who = "the true model" if not both or both["dropped"] else "the corrected cheaper model"
    earlier = f"{check['left_out']} earlier run{'s' if check['left_out'] != 1 else ''}"
    besides = f" and {earlier}, each predicted from the others," if check["left_out"] else ""
    return (
        f"converged: at {check['draws']} {check['by']}{besides} {who} gives {check['effective']:.0%} "
        f"effective draws and moves means by at most {shift:.2f} sd"
    )


def _row(name: str, item: Mapping[str, Any], unit: str = "") -> str:
    mean, sd, *rest = (f"{item[key]:.4g}" for key in ("mean", "sd", "median", "q05", "q95", "map"))
    return f"{name:>10} {unit:>7} {mean:>10} {sd:>9} " + " ".join(f"{text:>10}" for text in rest)
