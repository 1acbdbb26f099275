"""Programs in their own processes and environments: started with a task, called in turns, with the same cores."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from verification.benchmarks.figures import Figure, NotMeasured, in_turns
from verification.benchmarks.peers.worker import CORES

PEERS = Path(__file__).parent / "peers"
PEERS_PYTHON = PEERS / ".venv" / "bin" / "python"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", CORES)
REPEATS = 5


@contextmanager
def working(
    python: Path, program: Sequence[str], folder: Path, task: Path, cores: int
) -> Iterator[tuple[dict[str, str], Callable[[], Any]]]:
    """Start a program of a folder, script and arguments, and let it answer its task once; see ``peers/worker.py``.

    Yield the versions of its packages, and a function that returns its next answer with its seconds. `NotMeasured` says
    why it could not be started, or ended.
    """
    if not python.exists():
        raise NotMeasured("the environment of the peers does not exist (`make bench-env`)")
    complaints, environment = task.with_suffix(f".{program[-1]}.txt"), dict.fromkeys(THREADS, str(cores))
    options = {"cwd": folder, "env": {**os.environ, **environment}, "text": True}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    command = [python, "-W", "ignore", *program, task]
    with complaints.open("w") as stream, subprocess.Popen(command, stderr=stream, **pipes, **options) as process:

        def next_line() -> Any:
            line = process.stdout.readline()
            if line:
                return json.loads(line)
            said = complaints.read_text("utf-8").strip().splitlines()
            why = said[-1] if said else f"the program ended with status {process.wait()}"
            raise NotMeasured(why)

        def answer() -> Any:
            process.stdin.write("again\n")
            process.stdin.flush()
            return next_line()

        yield next_line()["ready"], answer


def versus(
    what: str,
    peer_name: str,
    programs: tuple[Sequence[str], Sequence[str]],
    content: Mapping[str, Any],
    *,
    cores: int,
    python: Path = PEERS_PYTHON,
    rtol: float = 1e-6,
    repeats: int = REPEATS,
    folder: Path = PEERS,
) -> Figure:
    """Compare two programs, the first in this environment, on the same task in turns.

    Their answers, a value and its gradient, must agree: the value to `rtol`, the gradient to `rtol` times its largest
    entry. `NotMeasured` says why the peer could not be started, or ended.
    """
    with ExitStack() as stack:
        task = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "task.npz"
        np.savez(task, **content)
        versions, theirs = stack.enter_context(working(python, programs[1], folder, task, cores))
        try:
            _, ours = stack.enter_context(working(Path(sys.executable), programs[0], folder, task, cores))
        except NotMeasured as why:
            raise RuntimeError(f"strandline's own side of the comparison: {why}") from why
        pairs = [(ours(), theirs()) for _ in range(repeats)]
    for one, other in pairs:
        mine, its = one["answer"], other["answer"]
        np.testing.assert_allclose(mine[0], its[0], rtol=rtol)
        np.testing.assert_allclose(mine, its, rtol=0.0, atol=rtol * np.max(np.abs(its[1:])))
    seconds, cpu = ([(one[key], other[key]) for one, other in pairs] for key in ("wall", "cpu"))
    remark = ", ".join(f"{package} {version}" for package, version in versions.items())
    return in_turns(what, peer_name, seconds, cpu=cpu, case=cores_case(cores), remark=remark)


def cores_case(cores: int) -> str:
    """Return a number of cores in words."""
    return "1 core" if cores == 1 else f"{cores} cores"
