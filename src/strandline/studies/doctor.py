"""What is wrong with a study folder, and what to do about it; nothing is changed."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.foundations import StrandlineError, __version__, read_json
from strandline.runs import outcome_digest, unsound
from strandline.studies.keys import folder as files
from strandline.studies.load.load import load_study
from strandline.studies.load.progress import StudyProgress, progress_of
from strandline.studies.load.provenance import versions
from strandline.studies.load.study import Study

LEDGERS = (files.LEDGER, files.CHECK_LEDGER, files.NEXT_LEDGER, files.SPECIMENS_LEDGER)
LEFTOVERS = ("*.partial", ".*.partial", "*.sqlite.new", "*.sqlite.new-*")


@dataclass(frozen=True)
class Finding:
    """Something that is wrong, or has changed, in one sentence, and what to do about it."""

    what: str
    remedy: str


def examine(folder: Path) -> list[Finding]:
    """Return everything that is wrong in the study folder, nothing if it is sound; refuse one without study.yaml."""
    found = list(_ledgers(folder))
    damaged = bool(found)
    try:
        study = load_study(folder)
        found += _other_ledgers(study)
    except StrandlineError as error:
        if not (folder / files.STUDY).exists():
            raise
        return [*found, Finding(f"study.yaml cannot be used: {' '.join(str(error).split())}", "Correct it.")]
    if damaged:
        return [*found, *_files(folder, at_work=False)]
    try:
        state = progress_of(study)
        found += [*_gaps(study, state), *_files(folder, at_work=bool(state.driver and state.driver.at_work))]
        found += _results(study)
    except StrandlineError as error:
        found.append(Finding(" ".join(str(error).split()), "Do what it says; the other checks come after that."))
    return found


def _ledgers(folder: Path) -> Iterator[Finding]:
    for name in LEDGERS:
        if (folder / name).is_file():
            remedy = f"Restore {name} from a backup (`strandline backup` makes one), or move it away and run again."
            yield from (Finding(f"{name}: {what}", remedy) for what in unsound(folder / name))


def _other_ledgers(study: Study) -> Iterator[Finding]:
    for path in study.reuse:
        if not path.is_file():
            yield Finding(f"the reused ledger {path} is not there", "Run that study first, or remove it from `reuse`.")
            continue
        for what in unsound(path):
            yield Finding(f"the reused ledger {path}: {what}", "Restore it from a backup, or remove it from `reuse`.")


def _gaps(study: Study, state: StudyProgress) -> Iterator[Finding]:
    """Yield planned runs without an outcome; none while a driver is at work on them."""
    at_work = state.detached or (state.driver is not None and state.driver.at_work is not False and state.open > 0)
    missing = state.planned - state.done
    if missing > 0 and not at_work:
        lost = f"; {state.lost} of them were started and lost with their driver" if state.lost else ""
        what = f"{missing} of {state.planned} planned runs have no outcome{lost}"
        yield Finding(what, f"Make them: strandline run {study.folder}")


def _files(folder: Path, *, at_work: bool) -> Iterator[Finding]:
    """Yield what a killed process has left behind; the lock file itself stays and is harmless."""
    if at_work:
        return
    left = sorted({path.name for pattern in LEFTOVERS for path in folder.glob(pattern)})
    if left:
        yield Finding(f"left by a process that was killed: {', '.join(left)}", "Delete them.")
    for name in LEDGERS:
        if (folder / f"{name}-wal").exists() and (folder / f"{name}-wal").stat().st_size > 0:
            remedy = f"Leave it where it is, next to {name}: the next command that opens it recovers its content."
            yield Finding(f"{name}-wal: the last driver of {name} did not end by itself", remedy)
    if any((folder / "slurm").glob("*/batch.json")):
        yield Finding("results of a SLURM array are not collected", f"Collect them: strandline run {folder}")


def _results(study: Study) -> Iterator[Finding]:
    """Yield how the results differ from what study.yaml, ledger, model and packages would give now."""
    report = f"Make them again: strandline report {study.folder}"
    summary = read_json(study.folder / files.SUMMARY)
    if not summary:
        there = [name for name in (files.POSTERIOR, "report.html") if (study.folder / name).exists()]
        if there:
            what = f"{', '.join(there)} without a readable {files.SUMMARY}: the last analysis did not end"
            yield Finding(what, report)
        return
    if summary.get("study_sha256") != study.text_digest:
        yield Finding("the results are of another study.yaml", f"Make them again: strandline run {study.folder}")
        return
    missing = [name for name in (files.POSTERIOR, "report.html", "figures") if not (study.folder / name).exists()]
    if missing:
        yield Finding(f"missing next to {files.SUMMARY}: {', '.join(missing)}", report)
    if summary.get("model") != study.runs.identity:
        yield Finding(f"the results were made with the model {summary.get('model')}", report)
    digest = summary.get("ledger_sha256")
    if digest is not None and digest != outcome_digest(study.ledger_path, frozenset(study.runs.needed_keys)):
        yield Finding("the ledger has changed since the results were made (runs made again, or excluded)", report)
    yield from _environment(summary, report)
    for path in sorted({*study.folder.glob("*.json")} - {study.folder / files.REFINEMENT}):
        if read_json(path).get(files.OF_STUDY, study.text_digest) != study.text_digest:
            command = "posterior check" if path.name == files.CHECK else path.stem
            yield Finding(f"{path.name} is of another study.yaml", f"Ask again: strandline {command} {study.folder}")


def _environment(summary: Mapping[str, Any], report: str) -> Iterator[Finding]:
    then = {"strandline": summary.get("version"), **summary.get("versions", {})}
    now = {"strandline": __version__, **versions()}
    names = [name for name in dict.fromkeys([*then, *now]) if then.get(name) != now.get(name)]
    if names:
        changes = ", ".join(f"{name} {then.get(name) or 'none'} → {now.get(name) or 'none'}" for name in names)
        remedy = f"Install those to get the same bits, or leave the results as they are. {report}"
        yield Finding(f"the results were made with other versions: {changes}", remedy)
