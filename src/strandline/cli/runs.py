"""`strandline status`, `runs`, `doctor`, `backup`: how far a study has got, its runs, what is wrong, a copy."""

import json
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.cli import options
from strandline.foundations import inputs_text, read_json, require, unfit
from strandline.runs import EXCLUDED, LOG_TITLE, STATES, Details, Driver, Overview, Run
from strandline.studies import LEDGER, SUMMARY

if TYPE_CHECKING:
    from strandline.studies import RunReported, StudyProgress

RESULTS = {"none": "not yet", "current": "written", "outdated": "of an earlier study.yaml"}
LINE = 160


@click.command("status")
@options.study
@options.as_json
def status(study: Path, as_json: bool) -> None:
    """Count the runs of STUDY by how they ended; show the pace, the slowest run, and why runs failed.

    It may be running meanwhile.
    """
    from strandline.studies import progress_in

    state = progress_in(study)
    if as_json:
        click.echo(json.dumps(state.as_dict()))
    else:
        click.echo("\n".join(lines_of(state)))


def lines_of(state: "StudyProgress") -> Iterator[str]:
    """Yield the lines that describe `state` to a person."""
    unsure = state.detached or (state.driver is not None and state.driver.at_work is None)
    most = "at most " if state.active else ""
    yield f"{state.name}: {state.done} of {most}{state.planned} runs of the design done"
    lost = f", {state.lost} of them lost with their driver" if state.lost else ""
    under_way = "under way (or lost)" if unsure else "under way"
    reused = f", to reuse {state.reused}" if state.reused else ""
    yield f"  ok {state.ok}, failed {state.failed}, {under_way} {state.open}{reused}, to do {state.to_do}{lost}"
    if state.detached:
        yield "  jobs of a SLURM array are out, which go on without a driver; `strandline run` collects them"
    if state.driver is not None:
        yield f"  {_driver(state.driver, state)}"
    if state.last_batch:
        yield f"  {state.last_batch}"
    for kind, some in state.failures.items():
        example = some.example
        yield f"  {some.count} × {kind}; e.g. {_inputs(example)}: {example.message or 'no message'}"
        for line in example.log:
            yield f"    | {line if len(line) <= LINE else line[: LINE - 1] + '…'}"
    if state.median_seconds is not None and state.slowest is not None:
        slowest = f"slowest {state.slowest.seconds:.2f} s at {_inputs(state.slowest)}"
        yield f"  median {state.median_seconds:.2f} s a run, {slowest}"
    yield f"  results: {RESULTS[state.results]}"


def _driver(driver: Driver, state: "StudyProgress") -> str:
    who = f"process {driver.pid} on {driver.host}"
    pace = "" if state.rate is None else f"{_figure(state.rate)} runs a minute"
    if driver.at_work is None:
        return f"driver {who}; strandline cannot see from here whether it is running" + (f"; {pace}" if pace else "")
    if not driver.at_work:
        return "no driver at work" + (f"; the last made {pace}" if pace else "")
    about = "at most" if state.active else "about"
    left = f", {about} {_time(state.seconds_left)} left" if state.seconds_left else ""
    return f"driver at work, {who}" + (f": {pace}{left}" if pace else "")


def _inputs(run: "RunReported") -> str:
    return inputs_text(run.inputs)


def _figure(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


@click.command("doctor")
@options.study
def doctor(study: Path) -> None:
    """Look for damage, gaps and drift in STUDY, and say what to do about each; change nothing.

    Exit code 0: sound; 1: something was found.
    """
    from strandline.studies import examine

    found = examine(study)
    for finding in found:
        click.echo(f"{finding.what}\n  -> {finding.remedy}")
    click.echo("sound: nothing found" if not found else f"{len(found)} found")
    if found:
        raise SystemExit(1)


@click.command("backup")
@options.study
@click.argument("file", type=options.PATH)
def backup(study: Path, file: Path) -> None:
    """Copy the ledger of STUDY to FILE, which must not exist; it may be running meanwhile.

    To restore it, copy FILE to ledger.sqlite in the study folder while nothing is running there.
    """
    if file.exists() or not file.parent.is_dir():
        raise click.UsageError(f"FILE: got {file}; expected a file that does not exist, in a folder that does.")
    with Overview(study / LEDGER) as ledger:
        number = len(ledger.runs())
        try:
            ledger.copy_to(file)
        except (OSError, sqlite3.Error) as error:
            expected = "a folder that can be written to, with room on the disk, and a sound ledger"
            remedy = "Choose another place; `strandline doctor` says whether the ledger is sound."
            raise unfit("FILE of the backup", f"{file}: {error}", expected, remedy) from error
    click.echo(f"wrote {file}: {number} runs")


MOST_COLUMNS = 12  # inputs in the list, such as coefficients of a field
SHORT = 12
"""Characters of a key in the list; as few of its first characters as are unique identify a run."""


@click.command("runs")
@options.study
@click.option("--state", type=click.Choice([*STATES, EXCLUDED]), help="Only runs of this state.")
@click.option("--kind", help="Only runs that failed for this reason.")
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="At most N, the last to be started.")
@click.option("--show", metavar="KEY", help="Show one run in full; the first characters of its key are enough.")
@click.option("--export", type=options.PATH, metavar="FILE", help="Write them to FILE.csv or FILE.nc instead.")
@click.option("--json", "as_json", is_flag=True, help="Print them as one JSON array.")
@click.option("--exclude", metavar="KEY", help="Use this run no more, and do not make it again; needs --why.")
@click.option("--include", metavar="KEY", help="Use an excluded run again.")
@click.option("--why", metavar="REASON", help="Reason for --exclude or --include, kept in the ledger.")
def list_runs(
    study: Path,
    state: str | None,
    kind: str | None,
    limit: int | None,
    show: str | None,
    export: Path | None,
    as_json: bool,
    exclude: str | None,
    include: str | None,
    why: str | None,
) -> None:
    """List the runs in the ledger of STUDY in the order of their start; it may be running meanwhile.

    State `open`: started and not ended, under way or lost; `excluded`: by --exclude, which needs the ledger for itself.
    FILE.csv has a row per run, FILE.nc the interfaces too.
    """
    one = {"--show": show, "--exclude": exclude, "--include": include}
    others = {"--state": state, "--kind": kind, "--limit": limit, "--export": export, "--json": as_json or None}
    option = _one_run(one, others, why)
    if export is not None and export.suffix not in (".csv", ".nc"):
        raise click.UsageError(f"--export: got {export}; expected a file name that ends with .csv or .nc.")
    with Overview(study / LEDGER) as ledger:
        runs, model = _as_used(ledger.runs(), study), ledger.model
        if option is None:
            _require_kind(kind, runs)
            chosen = [run for run in runs if state in (None, run.last.state) and kind in (None, run.last.kind)]
            chosen = chosen[-limit:] if limit else chosen
            if as_json:
                click.echo(json.dumps([_as_dict(run) for run in chosen]))
            elif export is None:
                click.echo("\n".join((*_table(chosen), f"{len(chosen)} of {len(runs)} runs")))
            else:
                _export(export, chosen, ledger)
            return
        run = _found(one[option] or "", runs, option)
        if show is not None:
            click.echo("\n".join((*_in_full(run, ledger), *_reasons(run, study))))
    if show is None:
        _change(study, run.key, model, why or "", exclude=exclude is not None)


def _one_run(one: Mapping[str, str | None], others: Mapping[str, object], why: str | None) -> str | None:
    """Return the option that names a single run, if one does; refuse options that do not go with it."""
    given = [name for name, key in one.items() if key is not None]
    besides = [name for name, value in others.items() if value is not None]
    if len(given) > 1 or (given and besides):
        raise click.UsageError(f"{' and '.join([*given, *besides])} do not go together: leave out all but one.")
    if given != ["--exclude"] and given != ["--include"] and why is not None:
        raise click.UsageError("--why is the reason for --exclude KEY or --include KEY: add one of them.")
    if given == ["--exclude"] and why is None:
        raise click.UsageError('--exclude needs --why REASON, such as --why "the mesh folded over".')
    if "--json" in besides and "--export" in besides:
        raise click.UsageError("--json prints the runs, --export writes them: give one of the two.")
    return given[0] if given else None


def _require_kind(kind: str | None, runs: Sequence[Run]) -> None:
    present = sorted({attempt.kind for run in runs for attempt in run.attempts if attempt.kind})
    if kind is not None and kind not in present:
        known = f"one of {', '.join(present)}" if present else "a failed run; there is none"
        raise click.UsageError(f"--kind: got {kind}; expected {known}. For states there is --state.")


def _found(key: str, runs: Sequence[Run], option: str) -> Run:
    matching = [run for run in runs if key and run.key.startswith(key)]
    found = key if matching else f"{key}: none of the {len(runs)} keys begins with {key}"
    expected = "the beginning of the key of one run" + (f", not of {len(matching)}" if matching else "")
    remedy = "Give more of its characters." if matching else "See `strandline runs STUDY` for the keys."
    require(len(matching) == 1, option, found, expected, remedy)
    return matching[0]


def _table(runs: Sequence[Run]) -> Iterator[str]:
    inputs = [run.inputs for run in runs]
    names = list(dict.fromkeys(name for some in inputs for name in some))
    names, more = names[:MOST_COLUMNS], names[MOST_COLUMNS:]
    rows = [("key", "state", "kind", "seconds", *names)]
    for run, some in zip(runs, inputs, strict=True):
        seconds = "-" if run.last.seconds is None else f"{run.last.seconds:.3f}"
        values = (f"{some[name]:.6g}" if name in some else "-" for name in names)
        rows.append((run.key[:SHORT], run.last.state, run.last.kind or "-", seconds, *values))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        left, right = row[:3], row[3:]
        cells = [text.ljust(width) for text, width in zip(left, widths, strict=False)]
        yield "  ".join([*cells, *(text.rjust(width) for text, width in zip(right, widths[3:], strict=True))])
    if more:
        yield f"and {len(more)} more inputs, {more[0]} to {more[-1]}: --json or --export tell them"


def _as_dict(run: Run) -> dict[str, Any]:
    last = run.last
    return {
        "key": run.key,
        "state": last.state,
        "kind": last.kind,
        "inputs": dict(run.inputs),
        "seconds": last.seconds,
        "started_at": last.started_at,
        "finished_at": last.finished_at,
        "starts": len(run.attempts),
        "origin": last.origin,
    }


def _in_full(run: Run, ledger: Overview) -> Iterator[str]:
    """Yield everything known about a run except its interface; if it is open again, about its last outcome."""
    ended = run.outcome
    started = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.last.started_at))
    yield f"key: {run.key}"
    yield f"state: {run.last.state}" + (f", {run.last.kind}" if run.last.kind else "")
    yield f"started: {started}" + (f" (start {len(run.attempts)} of this run)" if len(run.attempts) > 1 else "")
    yield from (f"{name} = {value!r}" for name, value in run.inputs.items())
    if ended is None:
        return
    details = ledger.details([ended.number])[ended.number]
    if ended is not run.last:
        yield f"before: {ended.state}" + (f", {ended.kind}" if ended.kind else "")
    yield f"seconds: {ended.seconds:.6g}"
    if ended.origin:
        yield f"copied from: {ended.origin}"
    yield from (f"{name}: {value:.6g}" for name, value in details.diagnostics.items())
    for title, text in (("message", _without_log(details)), ("log", details.log)):
        if text.strip():
            yield f"{title}:"
            yield from (f"  {line}" for line in text.splitlines())


def _without_log(details: Details) -> str:
    """Return the message without the last lines of the log if the whole log is printed after it."""
    message, _, lines = details.message.rpartition(f"\n{LOG_TITLE}\n")
    return message if message and details.log.endswith(lines) else details.message


def _export(path: Path, runs: Sequence[Run], ledger: Overview) -> None:
    from strandline.studies import write_csv, write_netcdf

    if not runs:
        raise click.UsageError("--export: there is no such run; change --state and --kind, or run the study first.")
    note = write_csv(path, runs, ledger) if path.suffix == ".csv" else write_netcdf(path, runs, ledger)
    click.echo(f"wrote {path}: {len(runs)} runs{note}")


def _as_used(runs: Sequence[Run], folder: Path) -> list[Run]:
    """Return the runs with the state that the analysis gives them: excluded by hand, or set aside as invalid."""
    kinds = {key: kind for key, (kind, _) in _set_aside(folder).items()}

    def as_used(run: Run) -> Run:
        if run.exclusion is not None:
            last = run.last._replace(state=EXCLUDED, kind=EXCLUDED)
        elif run.key in kinds and run.last.state == "ok":
            last = run.last._replace(state="invalid", kind=kinds[run.key])
        else:
            return run
        return run._replace(attempts=(*run.attempts[:-1], last))

    return [as_used(run) for run in runs]


def _reasons(run: Run, folder: Path) -> Iterator[str]:
    if run.exclusion is not None:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.exclusion.decided_at))
        yield f"excluded: {when}, {run.exclusion.why}"
    kind, why = _set_aside(folder).get(run.key, ("", ""))
    if kind:
        yield f"set aside by the last analysis: {kind}, {why}"


def _change(folder: Path, key: str, model: str | None, why: str, *, exclude: bool) -> None:
    """Exclude the run with this key, or include it again, and print what was done."""
    from strandline.runs import Ledger

    with Ledger.open(folder / LEDGER, model=model) as ledger:
        ledger.exclude(key, why) if exclude else ledger.include(key, why)
    done = "excluded: it is not used and not made again" if exclude else "included again"
    click.echo(f"run {key[:SHORT]} is {done}; `strandline run {folder}` makes the results again")


def _set_aside(folder: Path) -> dict[str, tuple[str, str]]:
    """Return kind and reason of the runs that the last analysis of study.yaml did not use at all, by key."""
    summary = read_json(folder / SUMMARY)
    try:
        first = summary["likelihood"]["discrepancy"]
        some = [one for one in summary["set_aside"] if one["measure"] in (None, first)]
        return {one["key"]: (one["kind"], one["why"]) for one in some}
    except (KeyError, TypeError):
        return {}
