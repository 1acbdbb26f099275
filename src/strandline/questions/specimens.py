"""Many specimens and one study: a posterior of each through the surrogate, its certificate, and the population.

Each posterior is written to specimens.jsonl as it is finished, so that a stopped command goes on where it was stopped.
Further runs for specimens have their own ledger, specimens.sqlite: the study's own results stay as they are.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from strandline import studies
from strandline.calibration import Observer, observer_or_default
from strandline.foundations import InvalidInput, InvalidStudy, NumericsError, one_thread, require
from strandline.questions.answer import Answer
from strandline.questions.many import RefusedSpecimen, Task, posteriors_of
from strandline.questions.opened import Specimens, entry_of, known_posteriors, lines_of, open_specimens, specimen_files
from strandline.questions.population import FEWEST_SPECIMENS, population_of, shrunk
from strandline.questions.specimen import SpecimenPosterior, runs_for
from strandline.questions.specimens_content import SpecimensFound, answer_of, describe_specimens, write_table
from strandline.runs import Executor, Ledger, Progress, run_campaign

__all__ = ["Arrived", "specimens", "watch_specimens"]

BATCH = 4  # fewest further runs that are made before the posteriors are looked at again


def specimens(
    study: studies.Study,
    *,
    refine: int = 0,
    seed: int = 1,
    measure: str | None = None,
    processes: int | None = None,
    executor: Executor | None = None,
    observer: Observer | None = None,
) -> Answer[SpecimensFound]:
    """Analyse all specimens that study.yaml names through the surrogate of a finished study, and their population.

    The posterior of a specimen depends on its file, its known inputs, its name and the seed, and on the runs: not on
    the other specimens, their order or the number of processes. Writes specimens.jsonl, specimens.json, specimens.csv,
    specimens.html and figures.

    Args:
        study: A finished study, from `load_study`, with the key `specimens`.
        refine: Largest number of further runs, made for specimens whose certificate says so.
        seed: Seed of all random numbers, 0 or above.
        measure: Name of a measure of the study; its first by default.
        processes: Processes that share the specimens; one per core by default.
        executor: Where further runs are made; by default where the study says.
        observer: Receives the progress.

    Raises:
        InvalidInput: An argument is out of its range.
        InvalidStudy: The study is not finished, names no specimens, none can be used, or its folder cannot be written
            to.
        LedgerError: A ledger is damaged, or belongs to another model.
        TooFewRuns: Too few runs succeeded to learn the interface.
    """
    studies.require_study(study)
    require(refine >= 0, "further runs", refine, "0 or more")
    require(processes is None or processes >= 1, "processes", processes, "1 or more", "Leave it out to use all cores.")
    tell = observer_or_default(observer)
    studies.require_writable(study.folder)
    files = specimen_files(study)
    paths = files.paths
    missing, remedy = f"no file {files.pattern} in {study.folder}", "Correct specimens in study.yaml, or add the files."
    require(bool(paths), "specimens", missing, "at least one outline", remedy, InvalidStudy)
    tell.stage("surrogate")
    opened = open_specimens(study, seed=seed, measure=measure)
    with lines_of(study).held("strandline specimens", "posteriors"), studies.told_if_unwritable(study.folder):
        tell.stage("specimens")
        found = posteriors_of_files(opened, paths, processes=processes, tell=tell)
        refused = "; ".join(f"{one.name}: {one.why}" for one in found.refused[:1])
        words = "at least one outline", "Correct specimens in study.yaml, or the files."
        require(len(found.posteriors) > 0, "specimens: none of the files can be used", refused, *words, InvalidStudy)
        made = 0
        if refine and any(not one.certified.good for one in found.posteriors):
            opened, made = _refined(opened, paths, found, refine, executor or study.executor, processes, tell)
            found = posteriors_of_files(opened, paths, processes=processes, tell=tell)
        tell.stage("population")
        found = _with_population(found, seed)
        tell.stage("report")
        content = describe_specimens(opened, found, made=made, alike=files.alike(paths))
        answer = answer_of(content, found, study.folder).written(draft=study.settings.draft)
        write_table(study.folder / studies.SPECIMENS_TABLE, content)
    return answer


def posteriors_of_files(
    opened: Specimens,
    paths: Sequence[Path],
    *,
    processes: int | None = None,
    tell: Observer | None = None,
    known: Mapping[str, SpecimenPosterior] | None = None,
) -> SpecimensFound:
    """Return the posteriors of the specimens in these files.

    Those that are `known`, by digest, are not computed again; by default those in specimens.jsonl.
    """
    lines, begun = lines_of(opened.study), time.monotonic()
    known = known_posteriors(opened.study) if known is None else known
    found: list[SpecimenPosterior] = []
    refused: list[RefusedSpecimen] = []
    tasks: list[Task] = []
    digests: dict[str, str] = {}
    for path in paths:
        task = _task(opened, path)
        if isinstance(task, RefusedSpecimen):
            refused.append(task)
        elif (posterior := known.get(task[1])) is not None:
            found.append(posterior)
        else:
            tasks.append(task[0])
            digests[task[0].name] = task[1]
    reused = done = len(found) + len(refused)
    for one in posteriors_of(opened.begin, opened.discrepancy, tasks, seed=opened.seed, processes=processes):
        if isinstance(one, RefusedSpecimen):
            refused.append(one)
        else:
            found.append(one)
            lines.append(entry_of(one, digests[one.name]))
        done += 1
        if tell is not None:
            tell.part(Progress(len(paths), done, done, 0, reused, time.monotonic() - begun))
    by_name = sorted(found, key=lambda one: one.name)
    return SpecimensFound(tuple(by_name), tuple(sorted(refused, key=lambda one: one.name)))


def _task(opened: Specimens, path: Path) -> tuple[Task, str] | RefusedSpecimen:
    try:
        return opened.task(path)
    except (InvalidInput, NumericsError) as error:
        return RefusedSpecimen(opened.files.name(path), " ".join(str(error).split()))


def _refined(
    opened: Specimens,
    paths: Sequence[Path],
    found: SpecimensFound,
    most: int,
    executor: Executor,
    processes: int | None,
    tell: Observer,
) -> tuple[Specimens, int]:
    made, open_ones = 0, [one for one in found.posteriors if not one.certified.good]
    by_name, study = {opened.files.name(path): path for path in paths}, opened.study
    path, text = study.folder / studies.SPECIMENS_LEDGER, f"{study.name}, further runs for specimens"
    while open_ones and made < most:
        left = most - made
        x = runs_for(opened.begin, open_ones, min(left, max(BATCH, -(-left // 2))))
        if not len(x):
            break
        tell.stage("forward")
        inputs = [{**study.fixed, **study.space.as_mapping(row)} for row in x]
        with Ledger.open(path, model=study.runs.identity, description=text) as ledger:
            run_campaign(studies.plain_model(study), inputs, ledger=ledger, executor=executor, on_record=tell.run)
        made += len(inputs)
        opened = open_specimens(opened.study, seed=opened.seed, measure=opened.measure)
        tell.stage("specimens")
        again = posteriors_of_files(opened, [by_name[one.name] for one in open_ones], processes=processes, tell=tell)
        open_ones = [one for one in again.posteriors if not one.certified.good]
    return opened, made


def _with_population(found: SpecimensFound, seed: int) -> SpecimensFound:
    if len(found.posteriors) < FEWEST_SPECIMENS:
        return found
    with one_thread():
        population = population_of(found.posteriors, seed=seed)
        names = tuple(one.name for one in found.posteriors)
        return replace(found, population=population, shrunk=shrunk(population, names, seed=seed))


PAUSE = 0.1  # seconds between two looks at the folder; a file that did not change from one to the next is complete
PATIENCE = 2.0  # seconds without a change after which a file that cannot be read is set aside


@dataclass(frozen=True, eq=False)
class Arrived:
    """An outline that was analysed, with its posterior or why it was set aside.

    The seconds since its file was complete are at most one pause between two looks too many.
    """

    answer: SpecimenPosterior | RefusedSpecimen
    seconds: float


@dataclass
class _Seen:
    """A file as it was last seen: its size and time, when it last changed, and whether it is done with."""

    state: tuple[int, int]
    since: float
    done: bool = False


def watch_specimens(
    study: studies.Study,
    *,
    seed: int = 1,
    measure: str | None = None,
    ready: Callable[[int], None] = lambda known: None,
    going_on: Callable[[], bool] = lambda: True,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[Arrived]:
    """Yield the posterior for each file of the specimens that appears or changes, until it is stopped.

    The files that are already there are analysed first, without being yielded. Each posterior is added to
    specimens.jsonl. A file that is still being written is not read: it must be the same in two looks at the folder, and
    one that cannot be read is looked at again for two seconds.

    Args:
        study: A finished study, from `load_study`, with the key `specimens`.
        seed: Seed of all random numbers, 0 or above.
        measure: Name of a measure of the study; its first by default.
        ready: Function called with the number of known specimens as soon as new ones are awaited.
        going_on: Function that returns whether to look once more.
        clock: Function that returns the seconds since some time.
        wait: Function that waits for so many seconds.

    Raises:
        InvalidInput: As `open_specimens`.
        InvalidStudy: As `open_specimens`, or the folder cannot be written to.
    """
    studies.require_study(study)
    studies.require_writable(study.folder)
    opened = open_specimens(study, seed=seed, measure=measure)
    template = opened.begin.knowledge.surrogate.layouts[""].template
    with lines_of(study).held("strandline specimens", "posteriors"):
        seen = {path: _Seen(_state(path), 0.0, done=True) for path in opened.files.paths}
        found = posteriors_of_files(opened, list(seen))
        with suppress(ValueError):  # for what it compiles and remembers; it may fail
            opened.posterior(template)
        ready(len(found.posteriors))
        while going_on():
            for path in opened.files.paths:
                since = _complete(path, seen, clock())
                if since is None:
                    continue
                begun = clock()
                answered = posteriors_of_files(opened, [path], processes=1, known={})
                answer = answered.posteriors[0] if answered.posteriors else answered.refused[0]
                if isinstance(answer, SpecimenPosterior) or begun - seen[path].since >= PATIENCE:
                    seen[path].done = True
                    yield Arrived(answer, clock() - begun + PAUSE)
            wait(PAUSE)


def _complete(path: Path, seen: dict[Path, _Seen], now: float) -> float | None:
    """Return since when a file has not changed; None if it is done with, or was not looked at twice."""
    state, before = _state(path), seen.get(path)
    if before is None or before.state != state:
        seen[path] = _Seen(state, now)
        return None
    return None if before.done or not state[0] else before.since


def _state(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:  # it has just been removed
        return 0, 0
    return found.st_size, found.st_mtime_ns
