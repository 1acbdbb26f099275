"""A private SLURM for tests: three virtual nodes on this machine, started in seconds and removed afterwards.

It needs the programs of the Debian packages ``slurmctld slurmd slurm-client munge`` and no special rights. Its
daemons have their own ports, socket and key; they are stopped through their pid files.
"""

import contextlib
import getpass
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "sinfo", "scancel", "scontrol")
NODES = ("n1", "n2", "n3")
CPUS = 2
SAVING = 0.5
"""Longest time in seconds that the controller takes to write its state after copying it."""
NODE_TIMEOUT = 30
"""Seconds after which a silent node is down. A node registers every 20 pings, of which there are three in this time; a
controller that comes back may take runs that have ended for running ones until then (by default for 33 minutes)."""
SETTINGS = """
ClusterName=strandline
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={base}/munge.sock
CredType=cred/munge
StateSaveLocation={base}/ctld
SlurmdSpoolDir={base}/d-%n
SlurmctldPidFile={base}/c.pid
SlurmdPidFile={base}/d-%n.pid
SlurmctldLogFile={base}/log/c.log
SlurmdLogFile={base}/log/d-%n.log
SlurmctldPort={port}
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
ReturnToService=2
SwitchType=switch/none
KillWait=2
SlurmdTimeout={timeout}
SchedulerParameters=sched_interval=1,bf_interval=1
PartitionName=debug Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
NODE = "NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cpus} RealMemory=1000 State=UNKNOWN\n"


@dataclass(frozen=True)
class TemporarySlurm:
    """A running SLURM; its commands find it through the environment variable SLURM_CONF."""

    base: Path

    @property
    def conf(self) -> Path:
        """The file that the environment variable SLURM_CONF must name."""
        return self.base / "slurm.conf"

    def command(self, *words: str, check: bool = True) -> str:
        """Return what a command of SLURM prints."""
        environment = {**os.environ, "SLURM_CONF": str(self.conf)}
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60, check=False)
        if check and done.returncode:
            raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
        return done.stdout

    def start_controller(self) -> None:
        """Start the controller; it takes over the jobs of one that was killed."""
        self.command("slurmctld", "-f", str(self.conf))

    def kill_controller(self, *, saved_after: float) -> None:
        """Kill the controller as a crash of its machine would, but only after it has saved its state.

        slurmctld saves every five seconds. If it dies before, it forgets the jobs submitted since, gives their numbers
        to new jobs, and the nodes that still run the old ones refuse the new ones. `saved_after` is the time, in
        seconds since the epoch, of the last job that the saved state must include.
        """
        saved = self.base / "ctld" / "job_state"
        if not _wait_until(lambda: saved.exists() and saved.stat().st_mtime > saved_after + SAVING, 15.0):
            raise RuntimeError(f"slurmctld has not written {saved} within 15 s; see {self.base / 'log' / 'c.log'}")
        _end(self.base / "c.pid", signal.SIGKILL)

    def quiet(self) -> None:
        """End all jobs and take all nodes back into service."""
        self.command("scancel", f"--user={getpass.getuser()}")
        for node in NODES:
            self.command("scontrol", "update", f"nodename={node}", "state=resume", check=False)
        _wait_until(lambda: not self.command("squeue", "--noheader"), 30.0)
        _wait_until(self.idle, 30.0)

    def idle(self) -> bool:
        """Return whether all nodes wait for jobs."""
        words = self.command("sinfo", "--noheader", "--Node", "--format=%T", check=False).split()
        return len(words) == len(NODES) and set(words) == {"idle"}


def missing_programs() -> list[str]:
    """Return the required programs that are missing."""
    return [name for name in PROGRAMS if shutil.which(name) is None]


@contextlib.contextmanager
def temporary_slurm() -> Iterator[TemporarySlurm]:
    """Yield a SLURM of three nodes with two CPUs each, and make it the one of this process and its children."""
    with tempfile.TemporaryDirectory(prefix="strandline-slurm-", ignore_cleanup_errors=True) as folder:
        slurm = TemporarySlurm(Path(folder))
        _write_settings(slurm)
        try:
            _start(slurm)
            with patch.dict(os.environ, {"SLURM_CONF": str(slurm.conf)}):
                yield slurm
        finally:
            _stop(slurm)


def _write_settings(slurm: TemporarySlurm) -> None:
    base, host = slurm.base, socket.gethostname().partition(".")[0]
    base.chmod(0o755)  # munge refuses other modes
    for name in ("ctld", "log"):
        (base / name).mkdir()
    (base / "munge.key").write_bytes(os.urandom(1024))
    (base / "munge.key").chmod(0o600)
    port, *ports = _free_ports(1 + len(NODES))
    text = SETTINGS.format(timeout=NODE_TIMEOUT, host=host, user=getpass.getuser(), base=base, port=port).lstrip()
    nodes = (NODE.format(node=node, host=host, port=one, cpus=CPUS) for node, one in zip(NODES, ports, strict=True))
    slurm.conf.write_text(text + "".join(nodes), encoding="utf-8")


def _start(slurm: TemporarySlurm) -> None:
    files = {"key-file": "munge.key", "socket": "munge.sock", "pid-file": "m.pid", "log-file": "log/m.log"}
    files |= {"seed-file": "munge.seed"}
    slurm.command("munged", *(f"--{name}={slurm.base / file}" for name, file in files.items()))
    slurm.start_controller()
    for node in NODES:
        slurm.command("slurmd", "-N", node, "-f", str(slurm.conf))
    if not _wait_until(slurm.idle, 30.0):
        raise RuntimeError(f"SLURM does not start:\n{(slurm.base / 'log' / 'c.log').read_text()[-2000:]}")


def _stop(slurm: TemporarySlurm) -> None:
    with contextlib.suppress(RuntimeError, subprocess.TimeoutExpired):
        slurm.command("scancel", f"--user={getpass.getuser()}")
        _wait_until(lambda: not slurm.command("squeue", "--noheader"), 15.0)
    for name in ("c.pid", *(f"d-{node}.pid" for node in NODES), "m.pid"):
        _end(slurm.base / name, signal.SIGTERM)


def _end(pid_file: Path, number: signal.Signals) -> None:
    """End the daemon whose pid file this is, and wait for it."""
    try:
        pid = int(pid_file.read_text())
        os.kill(pid, number)
    except (OSError, ValueError):
        return
    if not _wait_until(lambda: not Path(f"/proc/{pid}").exists(), 10.0):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _free_ports(number: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(number)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def _wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not (done := condition()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return done
