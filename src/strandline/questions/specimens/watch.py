"""New outlines are analysed as they appear in the folder, with a surrogate that was learnt once."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from strandline.population import Refused, SpecimenPosterior
from strandline.questions.specimens.lines import lines_of
from strandline.questions.specimens.opened import open_specimens
from strandline.questions.specimens.study_specimens import posteriors_of_files
from strandline.studies.folder import require_writable
from strandline.studies.study import Study

__all__ = ["Arrived", "watch_specimens"]

PAUSE = 0.1
"""Seconds between two looks at the folder; a file that did not change from one to the next is complete."""
PATIENCE = 2.0
"""Seconds without a change after which a file that cannot be read is set aside."""


@dataclass(frozen=True, eq=False)
class Arrived:
    """An outline that was analysed.

    Args:
        answer: Its posterior, or why it was set aside.
        seconds: Time from the completion of its file to the answer, at most one pause between two looks too long.
    """

    answer: SpecimenPosterior | Refused
    seconds: float


@dataclass
class _Seen:
    """A file as it was last seen: its size and time, when it last changed, and whether it is done with."""

    state: tuple[int, int]
    since: float
    done: bool = False


def watch_specimens(
    study: Study,
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
    require_writable(study.folder)
    opened = open_specimens(study, seed=seed, measure=measure)
    template = opened.begin.knowledge.surrogate.layouts[""].template
    with lines_of(study).held():
        seen = {path: _Seen(_state(path), 0.0, done=True) for path in opened.files.paths}
        found = posteriors_of_files(opened, list(seen))
        _warm(lambda: opened.posterior(template))
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


def _warm(task: Callable[[], object]) -> None:
    """Do a task for what it compiles and remembers; it may fail."""
    try:
        task()
    except ValueError:
        return
