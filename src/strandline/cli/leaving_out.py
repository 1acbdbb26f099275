"""Runs that are left out: excluded by hand with `strandline runs`, or set aside by the analysis."""

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from strandline.errors import InvalidInput

if TYPE_CHECKING:
    from strandline.runs.overview import Run

__all__ = ["as_used", "change", "reasons"]


def as_used(runs: Sequence["Run"], folder: Path) -> list["Run"]:
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


def reasons(run: "Run", folder: Path) -> Iterator[str]:
    """Yield why a run is left out."""
    if run.exclusion is not None:
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(run.exclusion.decided_at))
        yield f"excluded: {when}, {run.exclusion.why}"
    kind, why = _set_aside(folder).get(run.key, ("", ""))
    if kind:
        yield f"set aside by the last analysis: {kind}, {why}"


def change(folder: Path, key: str, why: str | None, *, exclude: bool) -> None:
    """Exclude the run with this key, or include it again, and print what was done.

    Raises:
        InvalidInput: An exclusion has no reason.
        LedgerError: The ledger is locked or cannot be written, or the run is excluded (or included) already.
    """
    from strandline.runs import Ledger
    from strandline.studies.folder import LEDGER

    if exclude and why is None:
        raise InvalidInput(
            "--exclude",
            value="no reason",
            expected="--why REASON too",
            remedy='Add --why "the mesh folded over".',
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
