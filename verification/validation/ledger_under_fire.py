"""What the ledger survives: a full disk, torn and corrupted files, two drivers, a read-only folder, clocks, size.

Each line reports what was done, what happened, and whether that is right. Mounting a small disk requires root; without
it, that line only reports that the disk was not tried.

Run it with:  python -m verification.validation.ledger_under_fire [RECORDS]
"""

import os
import random
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.models.fingerprint import fingerprint
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest, run_campaign
from strandline.testing.models import Cantilever

MODEL = Cantilever()
RECORDS = 100_000


@dataclass(frozen=True)
class Finding:
    """What was done to a ledger, what happened then, and whether that is correct."""

    what: str
    happened: str
    right: bool


def design(number: int) -> list[dict[str, float]]:
    """Return inputs at which the beam runs."""
    return [{"E": 300.0 + 0.01 * k, "load": 1e-5} for k in range(number)]


def campaign(path: Path, number: int) -> tuple[RunRecord, ...]:
    """Make the runs that the ledger does not have."""
    with Ledger.open(path, model=MODEL) as ledger:
        return run_campaign(MODEL, design(number), ledger=ledger, executor=InProcess())


def finished(path: Path) -> dict[str, bytes]:
    """Return the points of every successful run, by key."""
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return {record.key: record.interface.points.tobytes() for record in ledger if record.interface is not None}


def repeated(path: Path) -> int:
    """Return how many runs have more than one outcome."""
    with sqlite3.connect(path) as connection:
        sql = "SELECT key FROM starts JOIN outcomes USING (attempt) GROUP BY key HAVING count(*) > 1"
        return len(connection.execute(sql).fetchall())


def full_disk(base: Path) -> Finding:
    """Fill a small disk with runs until it is full; then make room."""
    disk = base / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)], capture_output=True)
    if mounted.returncode:
        return Finding("full disk", "not tried: a small disk could not be mounted", right=True)
    try:
        path = disk / "ledger.sqlite"
        try:
            campaign(path, 4000)
            return Finding("full disk", "the disk did not become full", right=False)
        except LedgerError as error:
            said = str(error)
        kept = finished(path)
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        campaign(path, 4000)
        now = finished(path)
        lost = sum(now.get(key) != points for key, points in kept.items())
        right = len(now) == 4000 and not lost and not repeated(path) and "\n" not in said
        text = f"“{said}” {len(kept)} kept, {len(now)} at the end, {lost} lost"
        return Finding("full disk (1 MB), then room", text, right)
    finally:
        subprocess.run(["umount", "--lazy", str(disk)], check=True)


def torn_log(base: Path, rng: random.Random) -> Finding:
    """Cut the write-ahead log of a living ledger at 40 places, as a power cut would, and go on from there."""
    path = base / "living" / "ledger.sqlite"
    path.parent.mkdir()
    with Ledger.open(path, model=MODEL) as ledger:
        run_campaign(MODEL, design(60), ledger=ledger, executor=InProcess())
        whole = {name: (path.parent / name).read_bytes() for name in ("ledger.sqlite", "ledger.sqlite-wal")}
    complete, wrong, kept = finished(path), 0, []
    for number in range(40):
        copy = base / f"torn-{number}" / "ledger.sqlite"
        copy.parent.mkdir()
        copy.write_bytes(whole["ledger.sqlite"])
        cut = rng.randrange(len(whole["ledger.sqlite-wal"]))
        copy.with_name("ledger.sqlite-wal").write_bytes(whole["ledger.sqlite-wal"][:cut])
        campaign(copy, 0)
        before = finished(copy)
        campaign(copy, 60)
        kept.append(len(before))
        wrong += any(complete[key] != points for key, points in before.items()) or finished(copy) != complete
        wrong += repeated(copy) > 0
    text = f"{min(kept)} to {max(kept)} of 60 runs kept, the rest made again; {wrong} of 40 ended otherwise"
    return Finding("log torn at 40 places", text, not wrong)


def corrupted(base: Path, rng: random.Random) -> Finding:
    """Overwrite 64 bytes of the file at 200 places; the ledger must read correctly or be refused."""
    path = base / "sound.sqlite"
    campaign(path, 60)
    sound, complete = path.read_bytes(), finished(path)
    refused = unhurt = wrong = other = 0
    for _ in range(200):
        spoilt = bytearray(sound)
        place = rng.randrange(len(sound) - 64)
        spoilt[place : place + 64] = rng.randbytes(64)
        copy = base / "spoilt.sqlite"
        for stale in copy.parent.glob(f"{copy.name}-*"):
            stale.unlink()
        copy.write_bytes(spoilt)
        try:
            Ledger.open(copy, model=MODEL).close()
            found = finished(copy)
        except LedgerError:
            refused += 1
        except Exception:
            other += 1
        else:
            unhurt += found == complete
            wrong += any(complete.get(key) != points for key, points in found.items())
            wrong += len(found) < len(complete)
    text = f"{refused} refused, {unhurt} unhurt (an index or free space), {wrong} read wrongly, {other} other errors"
    return Finding("64 bytes overwritten, 200 times", text, wrong == 0 and other == 0)


def two_drivers(base: Path) -> Finding:
    """Open a ledger twice for writing, the second time in another process."""
    path = base / "twice.sqlite"
    code = (
        "import sys; from pathlib import Path; from strandline.runs import Ledger\n"
        f"Ledger.open(Path(sys.argv[1]), model={fingerprint(MODEL)!r})"
    )
    with Ledger.open(path, model=MODEL):
        second = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    said = second.stderr.strip().splitlines()[-1]
    return Finding("two drivers at once", said, second.returncode != 0 and "is locked" in said)


def read_only_folder(base: Path) -> Finding:
    """Read and write a ledger in a folder without write permission, as a user who is not root."""
    folder = base / "protected"
    folder.mkdir()
    campaign(folder / "ledger.sqlite", 5)
    code = (
        "import os, sys; from pathlib import Path; from strandline.runs import Ledger; from strandline.errors import "
        "LedgerError\nif os.geteuid() == 0: os.setgid(65534); os.setuid(65534)\n"
        "path = Path(sys.argv[1])\n"
        "with Ledger.open(path, model=None, read_only=True) as ledger: print(ledger.counts().ok, 'read')\n"
        f"try: Ledger.open(path, model={fingerprint(MODEL)!r})\n"
        "except LedgerError as error: print(error)\n"
    )
    command = [sys.executable, "-c", code, str(folder / "ledger.sqlite")]
    with _traversable(base), _protected(folder):
        ended = subprocess.run(command, capture_output=True, text=True)
    said = " | ".join(ended.stdout.split("\n")).strip(" |") or ended.stderr.strip()[-300:]
    return Finding("folder without write permission", said, said.startswith("5 read") and "got" in said)


@contextmanager
def _traversable(base: Path) -> Iterator[None]:
    base.chmod(0o755)
    yield
    base.chmod(0o700)


@contextmanager
def _protected(folder: Path) -> Iterator[None]:
    folder.chmod(0o555)
    try:
        yield
    finally:
        folder.chmod(0o755)


def clock_jumps(base: Path, rng: random.Random) -> Finding:
    """Let the clock jump by up to a year, both ways, each time it is read."""
    path = base / "clock.sqlite"
    real = time.time
    with mock.patch("time.time", side_effect=lambda: real() + rng.uniform(-3e7, 3e7)):
        campaign(path, 30)
        campaign(path, 60)
    calm = base / "calm.sqlite"
    campaign(calm, 60)
    same, again = finished(path) == finished(calm), repeated(path)
    text = f"60 runs, {again} repeated, same interfaces: {same}"
    return Finding("clock jumping by up to a year", text, same and not again)


def many_records(base: Path, number: int) -> list[Finding]:
    """Append, open, count and read many records, each with an interface of 66 nodes."""
    path = base / "large.sqlite"
    rng = np.random.default_rng(0)
    outline = Interface.polyline(np.cumsum(rng.random((66, 2)), axis=0))
    keys = [f"{k:064x}" for k in range(number)]
    begun = time.perf_counter()
    with Ledger.open(path, model="large") as ledger:
        for key in keys:
            request = RunRequest(key, {"E": 400.0, "nu": 0.3})
            ledger.started(request)
            ledger.finished(RunRecord(key, request.inputs, "ok", {"": outline}, {"load": 1.0}, 0.1))
        appended = time.perf_counter() - begun
    size = path.stat().st_size / 2**20
    opened = _timed(lambda: Ledger.open(path, model="large").close())
    with Ledger.open(path, model="large") as ledger:
        counted = _timed(ledger.counts)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        read = _timed(lambda: ledger.latest(keys))
        memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return [
        Finding(f"{number} records: append", f"{1e3 * appended / number:.2f} ms each, on the disk", right=True),
        Finding(f"{number} records: file", f"{size:.0f} MiB", right=True),
        Finding(
            f"{number} records: open", f"{opened:.3f} s, all of the file being checked", opened < 1.0 + 1e-4 * number
        ),
        Finding(f"{number} records: counts by state", f"{counted:.2f} s", counted < 1.0),
        Finding(f"{number} records: read all", f"{read:.1f} s, {memory:.0f} MiB", right=True),
    ]


def _timed(task: Callable[[], object]) -> float:
    begun = time.perf_counter()
    task()
    return time.perf_counter() - begun


def main(records: int = RECORDS) -> None:
    """Print what happened; end with an error if something is not right."""
    rng = random.Random(0)
    base = Path(tempfile.mkdtemp(prefix="strandline-fire-"))
    wrong = 0
    try:
        tasks: list[Callable[[], Finding | list[Finding]]] = [
            lambda: full_disk(base),
            lambda: torn_log(base, rng),
            lambda: corrupted(base, rng),
            lambda: two_drivers(base),
            lambda: read_only_folder(base),
            lambda: clock_jumps(base, rng),
            lambda: many_records(base, records),
        ]
        for task in tasks:
            found = task()
            for finding in found if isinstance(found, list) else [found]:
                wrong += not finding.right
                print(f"{'ok   ' if finding.right else 'WRONG'} {finding.what:<36} {finding.happened}", flush=True)
    finally:
        shutil.rmtree(base, ignore_errors=True)
    if wrong:
        raise SystemExit(f"{wrong} not as it should be")


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main(*(int(argument) for argument in sys.argv[1:2]))
