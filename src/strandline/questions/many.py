"""The posteriors of many specimens, shared by several processes; each is the same to the bit in any of them.

A process that helps is a fresh interpreter: it reads the surrogate and its share of the specimens from its input, and
writes one posterior after the other to its output.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from strandline.discrepancy import Discrepancy
from strandline.foundations import InvalidInput, NumericsError, one_thread, use_double
from strandline.interface import Observation
from strandline.questions.specimen import SpecimenPosterior, Start, posterior_of
from strandline.runs import usable_cores

__all__ = ["RefusedSpecimen", "Task", "posteriors_of"]

WORTH_HELP = 60  # specimens per process from which it is worth the seconds that its start takes
MOST_PROCESSES = 8


@dataclass(frozen=True, eq=False)
class Task:
    """A specimen to analyse: its outline with its noise, and its known inputs by name."""

    name: str
    observations: tuple[Observation, ...]
    given: Mapping[str, float]


@dataclass(frozen=True)
class RefusedSpecimen:
    """A specimen that cannot be analysed, and why, on one line."""

    name: str
    why: str


def posteriors_of(
    begin: Start, measure: Discrepancy, tasks: Sequence[Task], *, seed: int = 1, processes: int | None = None
) -> Iterator[SpecimenPosterior | RefusedSpecimen]:
    """Yield the posterior of each specimen in turn; no forward run is made.

    By default, one process per core shares them, fewer for few specimens.
    """
    number = min(processes or min(usable_cores(), len(tasks) // WORTH_HELP, MOST_PROCESSES), len(tasks))
    packed = _packed(begin, measure, seed) if number > 1 else None
    if packed is not None:
        yield from _by_helpers(packed, tasks, number)
        return
    use_double()
    with one_thread():
        yield from (_answered(begin, measure, task, seed) for task in tasks)


def _answered(begin: Start, measure: Discrepancy, task: Task, seed: int) -> SpecimenPosterior | RefusedSpecimen:
    try:
        return posterior_of(begin.with_given(task.given), task.observations, measure, name=task.name, seed=seed)
    except (InvalidInput, NumericsError) as error:
        return RefusedSpecimen(task.name, " ".join(str(error).split()))


def _packed(begin: Start, measure: Discrepancy, seed: int) -> bytes | None:
    """Return what a helper needs; None if it cannot be sent to another interpreter."""
    try:
        packed = pickle.dumps((begin, measure, seed))
    except Exception:  # a measure or a prior of the user may hold anything
        return None
    return None if b"__main__" in packed else packed


def _by_helpers(packed: bytes, tasks: Sequence[Task], number: int) -> Iterator[SpecimenPosterior | RefusedSpecimen]:
    """Yield the answers of so many processes, which take turns: none waits for another one, as pipes hold many."""
    helpers = [_launched() for _ in range(number)]
    try:
        for k, helper in enumerate(helpers):
            with helper.stdin as to:
                pickle.dump((packed, tasks[k::number]), to)
        for k in range(len(tasks)):
            yield pickle.load(helpers[k % number].stdout)
    except Exception as error:  # whatever it is, a process ended too early
        message = "a process that analyses specimens ended early. Run the command again: what is finished is kept."
        raise NumericsError(f"{message} ({type(error).__name__})") from error
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()
            for pipe in (helper.stdin, helper.stdout):
                with suppress(BrokenPipeError):  # what an ended process did not read is lost
                    pipe.close()


def _launched() -> Any:
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "JAX_NUM_CPU_DEVICES": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", "from strandline.questions.many import serve; serve()"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)


def serve() -> None:
    """Answer the specimens that come in on standard input; what a helper process runs."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever else prints must not reach the answers
    use_double()
    packed, share = pickle.load(sys.stdin.buffer)
    begin, measure, seed = pickle.loads(packed)
    with one_thread(), output:
        for task in share:
            pickle.dump(_answered(begin, measure, task, seed), output)
            output.flush()
