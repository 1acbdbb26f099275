"""`strandline status`, `doctor`, `backup`: how far a study has got, what is wrong with it, a copy of its ledger."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from strandline.studies import RunReported, StudyProgress

from strandline.cli import options
from strandline.foundations import InvalidInput

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
        yield f"  {_driver(state)}"
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


def _driver(state: "StudyProgress") -> str:
    driver = state.driver
    if driver is None:
        return "no driver yet"
    who = f"process {driver.pid} on {driver.host}"
    pace = "" if state.rate is None else f"{_figure(state.rate)} runs a minute"
    if driver.at_work is None:
        return f"driver {who}; strandline cannot see from here whether it is running" + (f"; {pace}" if pace else "")
    if not driver.at_work:
        return "no driver at work" + (f"; the last made {pace}" if pace else "")
    left = (
        "" if not state.seconds_left else f", {'at most' if state.active else 'about'} {_time(state.seconds_left)} left"
    )
    return f"driver at work, {who}" + (f": {pace}{left}" if pace else "")


def _inputs(run: "RunReported") -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in run.inputs.items())


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
@click.argument("file", type=click.Path(path_type=Path))
def backup(study: Path, file: Path) -> None:
    """Copy the ledger of STUDY to FILE, which must not exist; it may be running meanwhile.

    To restore it, copy FILE to ledger.sqlite in the study folder while nothing is running there.
    """
    from strandline.runs import Overview, copied, opened_for_reading
    from strandline.studies import LEDGER

    if file.exists() or not file.parent.is_dir():
        raise click.UsageError(f"FILE: got {file}; expected a file that does not exist, in a folder that does.")
    with Overview(study / LEDGER) as ledger:
        number = len(ledger.runs())
    try:
        with closing(opened_for_reading(study / LEDGER)) as connection:
            copied(connection, file)
    except (OSError, sqlite3.Error) as error:
        raise InvalidInput(
            "FILE of the backup",
            value=f"{file}: {error}",
            expected="a folder that can be written to, with room on the disk, and a sound ledger",
            remedy="Choose another place; `strandline doctor` says whether the ledger is sound.",
        ) from error
    click.echo(f"wrote {file}: {number} runs")
