"""Programs in their own processes and environments: started with a task, called in turns, with the same cores."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from verification.benchmarks.comparison import Comparison, NotMeasured, summarised
from verification.benchmarks.peers.install import not_installed
from verification.benchmarks.peers.worker import CORES

PEERS = Path(__file__).parent / "peers"
PEERS_PYTHON = PEERS / ".venv" / "bin" / "python"
REPEATS = 5


@dataclass(frozen=True)
class Reply:
    """One answer, with its wall seconds and the seconds of all cores together."""

    wall: float
    cpu: float
    answer: list[float]


class Worker:
    """A program that has its task and has answered it once; see ``peers/worker.py``.

    Raises:
        NotMeasured: It could not be started, or it ended.
    """

    def __init__(self, script: Path, python: Path, task: Path, *, cores: int) -> None:
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", CORES), str(cores))
        self._complaints = task.with_name(f"{script.stem}.txt")
        if not python.exists():
            raise NotMeasured("the environment of the peers does not exist (`make bench-env`)")
        with self._complaints.open("w") as complaints:
            self._process = subprocess.Popen(
                [python, "-W", "ignore", script, task],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=complaints,
                env={**os.environ, **threads},
                text=True,
            )
        try:
            self.versions: dict[str, str] = self._read()["ready"]
        except NotMeasured:
            self.__exit__()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def ask(self) -> Reply:
        """Return the program's answer to its task, computed once more."""
        assert self._process.stdin is not None
        self._process.stdin.write("again\n")
        self._process.stdin.flush()
        return Reply(**self._read())

    def _read(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line:
            return json.loads(line)
        self._process.wait()
        said = self._complaints.read_text("utf-8").strip().splitlines()
        why = said[-1] if said else f"the program ended with status {self._process.returncode}"
        raise NotMeasured("; ".join(filter(None, [why, not_installed()])) if "ModuleNotFound" in why else why)


def our_worker(script: Path, task: Path, *, cores: int) -> Worker:
    try:
        return Worker(script, Path(sys.executable), task, cores=cores)
    except NotMeasured as why:
        raise RuntimeError(f"strandline's own side of the comparison: {why}") from why


def versus(
    what: str,
    peer_name: str,
    scripts: tuple[str, str],
    content: Mapping[str, Any],
    *,
    cores: int,
    python: Path = PEERS_PYTHON,
    rtol: float = 1e-6,
    repeats: int = REPEATS,
    folder: Path = PEERS,
) -> Comparison:
    """Compare two scripts of a folder, the first in this environment, on the same task in turns.

    Their answers, a value and its gradient, must agree: the value to `rtol`, the gradient to `rtol` times its largest
    entry.

    Raises:
        NotMeasured: The peer's program could not be started, or it ended.
    """
    with ExitStack() as stack:
        task = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "task.npz"
        np.savez(task, **content)
        theirs = stack.enter_context(Worker(folder / scripts[1], python, task, cores=cores))
        mine = stack.enter_context(our_worker(folder / scripts[0], task, cores=cores))
        pairs = [(mine.ask(), theirs.ask()) for _ in range(repeats)]
    for one, other in pairs:
        np.testing.assert_allclose(one.answer[0], other.answer[0], rtol=rtol)
        np.testing.assert_allclose(one.answer, other.answer, rtol=0.0, atol=rtol * np.max(np.abs(other.answer[1:])))
    return summarised(
        what,
        peer_name,
        [(one.wall, other.wall) for one, other in pairs],
        cpu=[(one.cpu, other.cpu) for one, other in pairs],
        case=cores_case(cores),
        remark=", ".join(f"{package} {version}" for package, version in theirs.versions.items()),
    )


def core_counts(available: int | None = None) -> Sequence[int]:
    """Return the numbers of cores to compare on: one and all."""
    return sorted({1, available or os.cpu_count() or 1})


def cores_case(cores: int) -> str:
    return "1 core" if cores == 1 else f"{cores} cores"
