"""`strandline runs`: the runs of a study, one line each, one in full, or as a table for other programs."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from strandline.errors import InvalidInput

if TYPE_CHECKING:
    from strandline.runs.overview import Details, Overview, Run

from strandline.cli import options

SHORT = 12
"""Characters of a key in the list; as few of its first characters as are unique identify a run."""
SUFFIXES = (".csv", ".nc")


@click.command("runs")
@options.study
@click.option("--state", help="Only runs of this state: ok, failed, timeout, killed, invalid, excluded or open.")
@click.option("--kind", help="Only runs that failed for this reason.")
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="At most N, the last to be started.")
@click.option("--show", metavar="KEY", help="Show one run in full; the first characters of its key are enough.")
@click.option(
    "--export", type=click.Path(path_type=Path), metavar="FILE", help="Write them to FILE.csv or FILE.nc instead."
)
@click.option("--json", "as_json", is_flag=True, help="Print them as one JSON array.")
@click.option("--exclude", metavar="KEY", help="Use this run no more, and do not make it again; needs --why.")
@click.option("--include", metavar="KEY", help="Use an excluded run again.")
@click.option("--why", metavar="REASON", help="Reason for --exclude or --include, kept in the ledger.")
def command(
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
    from strandline.runs.overview import Overview
    from strandline.studies.folder import LEDGER

    _require_known(state)
    _require_target(export)
    if as_json and export is not None:
        raise click.UsageError("--json prints the runs, --export writes them: give one of the two.")
    if exclude is not None or include is not None or why is not None:
        option = _require_one_change(exclude, include, state, kind, limit, show, export, as_json or None)
        with Overview(study / LEDGER) as ledger:
            run = _found(exclude or include or "", ledger.runs(), option)
        _change(study, run.key, why, exclude=exclude is not None)
        return
    with Overview(study / LEDGER) as ledger:
        runs = _as_used(ledger.runs(), study)
        if show is not None:
            _require_alone(state, kind, limit, export, as_json or None)
            run = _found(show, runs)
            click.echo("\n".join((*_in_full(run, ledger), *_reasons(run, study))))
            return
        _require_kind(kind, runs)
        chosen = [run for run in runs if state in (None, run.last.state) and kind in (None, run.last.kind)]
        chosen = chosen[-limit:] if limit else chosen
        if as_json:
            click.echo(json.dumps([_as_dict(run) for run in chosen]))
        elif export is None:
            click.echo("\n".join((*_table(chosen), f"{len(chosen)} of {len(runs)} runs")))
        else:
            _export(export, chosen, ledger)


def _require_known(state: str | None) -> None:
    from strandline.runs.ledger_schema import EXCLUDED
    from strandline.runs.overview import STATES

    known = (*STATES, EXCLUDED)
    if state is not None and state not in known:
        raise InvalidInput("--state", value=state, expected=f"one of {', '.join(known)}", remedy="Correct the option.")


def _require_kind(kind: str | None, runs: Sequence["Run"]) -> None:
    """Refuse a kind of failure that no run has had."""
    present = sorted({attempt.kind for run in runs for attempt in run.attempts if attempt.kind})
    if kind is not None and kind not in present:
        raise InvalidInput(
            "--kind",
            value=kind,
            expected=f"one of {', '.join(present)}" if present else "a failed run; there is none",
            remedy="`strandline status` shows the kinds and how many there are; for states there is --state.",
        )


def _require_target(export: Path | None) -> None:
    """Refuse a file that cannot be created, before anything is read."""
    if export is None:
        return
    if export.suffix not in SUFFIXES:
        raise InvalidInput(
            "--export",
            value=str(export),
            expected=f"a file name that ends with {' or '.join(SUFFIXES)}",
            remedy="Choose one of the two formats.",
        )
    if export.is_dir() or not export.parent.is_dir():
        raise InvalidInput(
            "--export",
            value=str(export),
            expected="a file in a folder that exists",
            remedy="Correct the path, or make the folder.",
        )


def _require_alone(*others: object) -> None:
    if any(other is not None for other in others):
        raise InvalidInput(
            "--show",
            value="another option with it",
            expected="--show KEY alone",
            remedy="Leave out --state, --kind, --limit, --export and --json.",
        )


def _require_one_change(exclude: str | None, include: str | None, *others: object) -> str:
    """Return the option that was given; refuse both at once, --why alone, or other options with them."""
    if (exclude is None) == (include is None) or any(other is not None for other in others):
        raise InvalidInput(
            "--exclude, --include and --why",
            value="several options that do not go together, or --why alone",
            expected="either --exclude KEY --why REASON or --include KEY",
            remedy="Give one of the two, without options that list, show or export runs.",
        )
    return "--exclude" if include is None else "--include"


def _found(key: str, runs: Sequence["Run"], option: str = "--show") -> "Run":
    """Return the run whose key begins with `key`."""
    matching = [run for run in runs if key and run.key.startswith(key)]
    if len(matching) != 1:
        raise InvalidInput(
            option,
            value=key if matching else f"{key}: none of the {len(runs)} keys begins with {key}",
            expected="the beginning of the key of one run" + (f", not of {len(matching)}" if matching else ""),
            remedy="Give more of its characters." if matching else "See `strandline runs STUDY` for the keys.",
        )
    return matching[0]


def _table(runs: Sequence["Run"]) -> Iterator[str]:
    """Yield a heading and a line for each run, in columns."""
    inputs = [run.inputs for run in runs]
    names = list(dict.fromkeys(name for some in inputs for name in some))
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


def _as_dict(run: "Run") -> dict[str, Any]:
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


def _in_full(run: "Run", ledger: "Overview") -> Iterator[str]:
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


def _without_log(details: "Details") -> str:
    """Return the message without the last lines of the log if the whole log is printed after it."""
    from strandline.runs.ledger_schema import LOG_TITLE

    message, _, lines = details.message.rpartition(f"\n{LOG_TITLE}\n")
    return message if message and details.log.endswith(lines) else details.message


def _export(path: Path, runs: Sequence["Run"], ledger: "Overview") -> None:
    """Write the runs to `path` and print a line about it."""
    from strandline.studies.export import write_csv, write_netcdf

    if not runs:
        raise InvalidInput(
            "--export", value="no run", expected="at least one run", remedy="Change --state and --kind, or run first."
        )
    note = write_csv(path, runs, ledger) if path.suffix == ".csv" else write_netcdf(path, runs, ledger)
    click.echo(f"wrote {path}: {len(runs)} runs{note}")


def _as_used(runs: Sequence["Run"], folder: Path) -> list["Run"]:
    """Return the runs with the state that the analysis gives them: excluded by hand, or set aside as invalid."""
    from strandline.runs.ledger_schema import EXCLUDED

    kinds = {key: kind for key, (kind, _) in _set_aside(folder).items()}
    out = []
    for run in runs:
        if run.exclusion is not None:
            run = _ending(run, EXCLUDED, EXCLUDED)
        elif run.key in kinds and run.last.state == "ok":
            run = _ending(run, "invalid", kinds[run.key])
        out.append(run)
    return out


def _reasons(run: "Run", folder: Path) -> Iterator[str]:
    """Yield why a run is left out."""
    if run.exclusion is not None:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.exclusion.decided_at))
        yield f"excluded: {when}, {run.exclusion.why}"
    kind, why = _set_aside(folder).get(run.key, ("", ""))
    if kind:
        yield f"set aside by the last analysis: {kind}, {why}"


def _change(folder: Path, key: str, why: str | None, *, exclude: bool) -> None:
    """Exclude the run with this key, or include it again, and print what was done."""
    from strandline.runs import Ledger
    from strandline.studies.folder import LEDGER

    if exclude and why is None:
        raise InvalidInput(
            "--exclude", value="no reason", expected="--why REASON too", remedy='Add --why "the mesh folded over".'
        )
    path = folder / LEDGER
    with Ledger.open(path, model=None, read_only=True) as reader:
        model = reader.model
    with Ledger.open(path, model=model) as ledger:
        ledger.exclude(key, why or "") if exclude else ledger.include(key, why or "")
    done = "excluded: it is not used and not made again" if exclude else "included again"
    click.echo(f"run {key[:12]} is {done}; `strandline run {folder}` makes the results again")


def _ending(run: "Run", state: str, kind: str) -> "Run":
    return run._replace(attempts=(*run.attempts[:-1], run.last._replace(state=state, kind=kind)))


def _set_aside(folder: Path) -> dict[str, tuple[str, str]]:
    """Return kind and reason of the runs that the last analysis of study.yaml did not use at all, by key."""
    from strandline.studies.folder import SUMMARY

    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        first = summary["likelihood"]["discrepancy"]
        some = [one for one in summary["set_aside"] if one["measure"] in (None, first)]
        return {one["key"]: (one["kind"], one["why"]) for one in some}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
