"""The SLURM commands in use, and what they report."""

import re
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

from strandline.errors import InvalidInput

ANSWER_SECONDS = 120.0
DEFAULT_LARGEST_ARRAY = 1001


class SlurmUnreachable(InvalidInput):
    """SLURM did not answer, or refused; it may work later."""


def submit(options: Sequence[str], script: Path) -> str:
    """Submit `script` and return the number of its job.

    Raises:
        SlurmUnreachable: The command sbatch fails; the message contains its output.
    """
    return _said("sbatch", "--parsable", *options, str(script)).strip().partition(";")[0]


def states(names: Iterable[str]) -> dict[tuple[str, int], str]:
    """Return the states of the jobs that SLURM remembers, by name and number in the array.

    Raises:
        SlurmUnreachable: the controller does not answer.
    """
    form = "%j|%K|%T"
    text = _said("squeue", "--noheader", "--array", "--states=all", f"--name={','.join(names)}", f"--format={form}")
    rows = (line.strip().split("|") for line in text.splitlines())
    return {(row[0], int(row[1])): row[2] for row in rows if len(row) == 3 and row[1].isdigit()}


def job_called(name: str) -> str | None:
    """Return the number of the job with this name; None if SLURM knows none.

    Raises:
        SlurmUnreachable: the controller does not answer.
    """
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


def cancel(name: str) -> None:
    """Cancel the jobs with this name."""
    _said("scancel", f"--name={name}")


def _said(*command: str) -> str:
    """Return what a command printed."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=ANSWER_SECONDS, check=True, stdin=subprocess.DEVNULL
        )
    except FileNotFoundError:
        raise InvalidInput(
            "the executor slurm_array",
            value=f"no command {command[0]}",
            expected="the commands of SLURM: sbatch, squeue, scontrol, scancel",
            remedy="Run it where jobs are submitted, or choose another executor.",
        ) from None
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        stderr = error.stderr.decode() if isinstance(error.stderr, bytes) else error.stderr
        raise SlurmUnreachable(
            f"{command[0]} failed",
            value=(stderr or str(error)).strip(),
            expected="SLURM to take the command",
            remedy="Look at partition, account and limits (`sinfo`, `squeue`), then run again: nothing is lost.",
        ) from None
    return done.stdout
