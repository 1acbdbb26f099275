"""The folder of a batch: what an array of jobs must do, what has come back, and which results were taken; SLURM itself.

```
<name>/batch.json     the runs; without it the folder is not a batch, and its jobs do nothing
<name>/job            the number of its job, once SLURM has taken it
<name>/job.sh         what was submitted
<name>/logs/7.txt     what job 7 of the array printed
<name>/results/7.run  the record of its run; 7.taken instead, once the driver has it
```
"""

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import time
import uuid
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from strandline.foundations import InvalidInput, require, unfit, whole_file
from strandline.models import ForwardModel, asks_sensitivities, fingerprint
from strandline.runs.ledger.ledger_rows import inputs_text, record_of, rows_of
from strandline.runs.ledger.ledger_schema import synchronise
from strandline.runs.ledger.record import RunRecord, RunRequest

HEADER = b"strandline run 2 "
BATCH = "batch.json"
VERSION = 1
ANSWER_SECONDS = 120.0
DEFAULT_LARGEST_ARRAY = 1001


def write_run(path: Path, record: RunRecord) -> None:
    """Write `record` to `path`, durably: its rows of a ledger as JSON, after their checksum."""
    outcome, arrays = rows_of(record, None)
    rows = (record.key, inputs_text(record.inputs), *outcome), arrays
    content = json.dumps(rows, default=lambda data: {"base64": base64.b64encode(data).decode()}).encode()
    put_durably(path, HEADER + hashlib.sha256(content).hexdigest().encode() + b"\n" + content)


def read_run(path: Path) -> RunRecord:
    """Return the record in `path`; raise InvalidInput if the content is not what was written."""
    header, _, content = path.read_bytes().partition(b"\n")
    intact, found = header == HEADER + hashlib.sha256(content).hexdigest().encode(), "a checksum that does not match"
    require(intact, f"the result of a run in {path}", found, "what was written", "The run is made again.")
    row, arrays = json.loads(content, object_hook=lambda packed: base64.b64decode(packed["base64"]))
    return record_of(path, tuple(row), [tuple(one) for one in arrays])


def put_durably(path: Path, content: bytes) -> None:
    """Write a file completely or not at all; it is on the disk when this returns."""
    with whole_file(path) as partial, partial.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    synchronise(path.parent)


@dataclass(frozen=True)
class ArrayBatch:
    """One submitted array of runs, by their number in it; the name of the folder of its files is that of the job.

    It was created so many seconds after 1970, for the model with this fingerprint, perhaps asked for sensitivities; a
    run is killed after `timeout` seconds.
    """

    folder: Path
    created: float
    fingerprint: str
    sensitivities: bool
    timeout: float | None
    requests: tuple[RunRequest, ...]

    @classmethod
    def new(
        cls, parent: Path, model: ForwardModel, requests: Sequence[RunRequest], timeout: float | None
    ) -> "ArrayBatch":
        """Write a new batch to its own folder inside `parent`, durably."""
        folder = parent / f"strandline-{time.strftime('%Y%m%d-%H%M%S')}-{uuid.uuid4().hex[:8]}"
        for part in ("logs", "results"):
            (folder / part).mkdir(parents=True)
        batch = cls(folder, time.time(), fingerprint(model), asks_sensitivities(model), timeout, tuple(requests))
        content = {"version": VERSION, **vars(batch), "runs": [vars(request) for request in requests]}
        del content["folder"], content["requests"]
        put_durably(folder / BATCH, json.dumps(content, indent=1).encode())
        return batch

    @classmethod
    def read(cls, folder: Path) -> "ArrayBatch":
        """Return the batch in `folder`; raise FileNotFoundError if there is none, or none any more."""
        content = json.loads((folder / BATCH).read_text(encoding="utf-8"))
        requests = tuple(RunRequest(**run) for run in content.pop("runs"))
        del content["version"]
        return cls(folder, requests=requests, **content)

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def job(self) -> str | None:
        """Number of the job; None if SLURM is not known to have it."""
        try:
            return (self.folder / "job").read_text(encoding="utf-8").strip()
        except FileNotFoundError:
            return None

    def submitted(self, job: str) -> None:
        put_durably(self.folder / "job", job.encode())

    def put(self, index: int, record: RunRecord) -> None:
        """Write the record of a run, unless it has one."""
        if not (self._result(index).exists() or self._result(index, "taken").exists()):
            write_run(self._result(index), record)

    def present(self) -> tuple[dict[int, Path], frozenset[int]]:
        """Return the results not taken yet, by number, and the numbers of those taken."""
        found = list((self.folder / "results").iterdir())
        there = {int(path.stem): path for path in found if path.suffix == ".run" and path.stem.isdigit()}
        taken = frozenset(int(path.stem) for path in found if path.suffix == ".taken")
        return {index: path for index, path in there.items() if index not in taken}, taken

    def take(self, index: int) -> None:
        """Note that the driver has the record of a run."""
        try:
            self._result(index).replace(self._result(index, "taken"))
        except FileNotFoundError:
            self._result(index, "taken").touch()

    def remove(self) -> None:
        """Remove the batch; jobs that start later find nothing to do."""
        (self.folder / BATCH).unlink(missing_ok=True)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _result(self, index: int, ending: str = "run") -> Path:
        return self.folder / "results" / f"{index}.{ending}"


def known_batches(parent: Path) -> Iterable[ArrayBatch]:
    """Yield the batches inside `parent`, the oldest first; what another driver removes meanwhile is left out."""
    batches = []
    for path in parent.glob(f"strandline-*/{BATCH}"):
        with suppress(FileNotFoundError):
            batches.append(ArrayBatch.read(path.parent))
    yield from sorted(batches, key=lambda batch: batch.created)


class SlurmUnreachable(InvalidInput):
    """SLURM did not answer, or refused; it may work later."""


def submit_job(options: Sequence[str], script: Path) -> str:
    """Submit `script` and return the number of its job; raise SlurmUnreachable, with sbatch's output, if that fails."""
    return _said("sbatch", "--parsable", *options, str(script)).strip().partition(";")[0]


def job_states(names: Iterable[str]) -> dict[tuple[str, int], str]:
    """Return the states of the jobs that SLURM remembers, by name and number; SlurmUnreachable if it is silent."""
    form = "%j|%K|%T"
    text = _said("squeue", "--noheader", "--array", "--states=all", f"--name={','.join(names)}", f"--format={form}")
    rows = (line.strip().split("|") for line in text.splitlines())
    return {(row[0], int(row[1])): row[2] for row in rows if len(row) == 3 and row[1].isdigit()}


def job_called(name: str) -> str | None:
    """Return the number of the job with this name, None if there is none; raise SlurmUnreachable if SLURM is silent."""
    text = _said("squeue", "--noheader", "--states=all", f"--name={name}", "--format=%F")
    return text.split()[0] if text.split() else None


def past_state(job: str, index: int) -> str | None:
    """Return the state of a job that the controller has forgotten, if there is accounting."""
    try:
        text = _said("sacct", "--noheader", "--allocations", "--parsable2", f"--jobs={job}_{index}", "--format=State")
    except SlurmUnreachable:
        return None
    return text.split()[0] if text.split() else None


def largest_array() -> int:
    """Return how many jobs an array may have."""
    found = re.search(r"MaxArraySize\s*=\s*(\d+)", _said("scontrol", "show", "config"))
    return max(1, int(found.group(1)) if found else DEFAULT_LARGEST_ARRAY)


def cancel_jobs(name: str) -> None:
    """Cancel the jobs with this name."""
    _said("scancel", f"--name={name}")


def _said(*command: str) -> str:
    """Return what a command printed."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=ANSWER_SECONDS, check=True, stdin=subprocess.DEVNULL
        )
    except FileNotFoundError:
        what = "the executor slurm_array"
        expected = "the commands of SLURM: sbatch, squeue, scontrol, scancel"
        remedy = "Run it where jobs are submitted, or choose another executor."
        raise unfit(what, f"no command {command[0]}", expected, remedy) from None
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        stderr = error.stderr.decode() if isinstance(error.stderr, bytes) else error.stderr
        what = f"{command[0]} failed"
        expected = "SLURM to take the command"
        remedy = "Look at partition, account and limits (`sinfo`, `squeue`), then run again: nothing is lost."
        raise SlurmUnreachable(what, value=(stderr or str(error)).strip(), expected=expected, remedy=remedy) from None
    return done.stdout
