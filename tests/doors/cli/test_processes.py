"""Commands as processes: Ctrl-C, folders that cannot be written to, a terminal, what is imported."""

import hashlib
import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys

import httpx
import pytest
from tests.doors.models.waiting import until
from tests.unit.cli.command_line import ALL_SET, contents, one_line, printed

from strandline import __version__
from strandline.cli import main
from strandline.cli.main import COMMANDS
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.plans import Plan
from strandline.testing.studies import write_study

STRANDLINE = [sys.executable, "-m", "strandline"]
PIPES = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
SLOW_MODEL = """
import time
from pathlib import Path
from strandline.testing.studies import undeclared_beam

def slow(inputs, workdir):
    time.sleep(0.0 if Path(__file__).with_name("hurry").exists() else 0.3)
    return undeclared_beam(inputs, workdir)
"""


def finished_runs(folder):
    path = folder / "ledger.sqlite"
    if not path.is_file():
        return 0
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts().ok


def test_a_run_that_was_interrupted_goes_on(tmp_path, capsys, monkeypatch):
    (tmp_path / "slow_beam.py").write_text(SLOW_MODEL)
    monkeypatch.syspath_prepend(tmp_path)
    folder = write_study(
        tmp_path / "study",
        model={"python": {"function": "slow_beam:slow"}},
        design={"sobol": {"runs": 32}},
        sampler={"smc": {"particles": 1000, "rejuvenation_steps": 4, "zeta": 0.5}},
        draft=True,
        report="none",
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [*STRANDLINE, "run", str(folder), "--quiet"]
    driver = subprocess.Popen(command, **PIPES, env=environment, start_new_session=True)
    until(lambda: finished_runs(folder) >= 4)
    os.killpg(driver.pid, signal.SIGINT)
    out, err = driver.communicate(timeout=30)
    message = "strandline: interrupted; what is finished is kept; run the same command again to go on\n"
    assert (driver.returncode, out, err) == (130, "", message)
    kept = finished_runs(folder) - 1  # one run is the synthetic observation
    assert 3 <= kept < 32
    assert f"{kept} of 32 runs" in printed(capsys, "status", str(folder))
    (tmp_path / "hurry").touch()
    main(["run", str(folder), "--workers", "1", "--json"])
    shown = capsys.readouterr()
    runs = json.loads(shown.out)["runs"]
    assert (runs["ok"], runs["new"], runs["reused"]) == (32, 32 - kept, kept)
    assert "  32/32 32 ok, 0 failed" in shown.err


def denied(*arguments):
    """Return the line with which a process refuses that permissions bind, the superuser's too."""
    command = [*STRANDLINE, *arguments]
    if os.geteuid() == 0:
        tool = shutil.which("setpriv")
        if tool is None:
            pytest.skip("the superuser passes all permissions, and there is no setpriv to drop that right")
        command = [tool, "--bounding-set=-dac_override", "--inh-caps=-dac_override", *command]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    return one_line(ended.stderr)


@pytest.mark.smoke
def test_a_folder_that_cannot_be_written_to(tmp_path):
    """A table is found before the run: the load would fail the run, which would be told instead had it been made."""
    folder, closed = write_study(tmp_path / "study"), tmp_path / "closed"
    closed.mkdir(mode=0o555)
    line = denied("forward", str(folder), *ALL_SET, "--set", "load=1", "--csv", str(closed / "a.csv"))
    assert "without write permission" in line
    before = contents(folder)
    folder.chmod(0o555)
    try:
        line = denied("run", str(folder))
    finally:
        folder.chmod(0o755)
    assert f"the study folder cannot be written to: got {folder}: Permission denied" in line
    assert "copy the study elsewhere" in line
    assert contents(folder) == before


BARS = """
from strandline.cli.progress import observing
from strandline.design.active import BatchReport
from strandline.runs import Progress, RunRecord
from strandline.smc import StepInfo
with observing() as observer:
    observer.stage("forward")
    for i in range(1, 4):
        observer.run(RunRecord("key", {}, "ok"), Progress(3, i, i, 0, 0, float(i)))
    observer.stage("sampling")
    observer.step(StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0))
    observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
    observer.stage("replicates")
    observer.part(Progress(100, 40, 40, 0, 0, 1.0))
    observer.note("a note [that stays]")
"""


@pytest.mark.smoke
def test_bars_fit_a_terminal_of_80_columns():
    ours, theirs = pty.openpty()
    environment = {**os.environ, "COLUMNS": "80", "TERM": "xterm"}
    environment.pop("NO_COLOR", None)
    process = subprocess.Popen([sys.executable, "-c", BARS], stderr=theirs, env=environment)
    os.close(theirs)
    shown = b""
    try:
        while part := os.read(ours, 4096):
            shown += part
    except OSError:  # how Linux tells that the other end is closed
        pass
    os.close(ours)
    assert process.wait(30) == 0
    text = shown.decode()
    for words in (
        "forward runs",
        "3 ok, 0 failed",
        "ESS 1234",
        "batch 3: E 396",
        "40 of 100",
        "[that stays]",
        "0:00:0",
    ):
        assert words in text
    assert "…" not in text.partition("sampling")[0]


@pytest.mark.smoke
def test_view_prints_its_address_and_ends_with_ctrl_c(tmp_path):
    folder = write_study(tmp_path / "beam")
    with subprocess.Popen([*STRANDLINE, "view", str(folder), "--no-browser"], **PIPES) as process:
        line = process.stdout.readline()
        found = re.fullmatch(rf"{re.escape(str(folder))}: (http://127\.0\.0\.1:(\d+)/[\w-]+/)\n", line)
        assert f"ssh -L {found[2]}:localhost:{found[2]} THIS_MACHINE" in process.stdout.readline()
        assert httpx.get(found[1]).status_code == 200
        assert httpx.get(f"{found[1]}api/study").json()["name"] == "beam"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr.read() == "stopped\n"
    assert sorted(path.name for path in folder.iterdir()) == ["study.yaml"]


HEAVY = {"numpy", "scipy", "jax", "matplotlib", "ngsolve", "netgen", "pydantic", "yaml", "rich", "xarray", "jinja2"}
PROBE = """
import contextlib, io, json, sys
from strandline.cli import main
found = []
for words in json.loads(sys.argv[1]):
    shown = io.StringIO()
    with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(shown):
        try:
            main(words)
            code = 0
        except SystemExit as ended:
            code = ended.code
    found.append((code or 0, shown.getvalue(), sorted({name.partition(".")[0] for name in sys.modules})))
print(json.dumps(found))
"""


def loaded_by(*commands):
    """Return code, output and loaded packages after each of some commands in one process."""
    words = [sys.executable, "-c", PROBE, json.dumps(commands)]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


@pytest.mark.smoke
def test_no_help_loads_numerics():
    commands = [[], *([name] for name in COMMANDS), ["posterior", "check"]]
    helped = loaded_by(*([*words, "--help"] for words in commands), ["--version"])
    assert helped.pop()[1] == f"strandline, version {__version__}\n"
    for words, (code, shown, names) in zip(commands, helped, strict=True):
        assert code == 0
        assert shown.startswith(f"Usage: strandline {' '.join(words)}".rstrip())
        assert HEAVY.isdisjoint(names), words
    for name, line in COMMANDS.items():
        assert f"  {name}" in helped[0][1]
        assert line in helped[0][1]


@pytest.mark.smoke
def test_status_and_runs_load_no_numerics_once_a_driver_has_noted_the_plan(tmp_path):
    """In a folder whose model is not there any more, so that nothing could be loaded if it were tried."""
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.yaml").write_text("model: {python: {function: gone:away}}\n")
    digest = hashlib.sha256((folder / "study.yaml").read_bytes()).hexdigest()
    with Ledger.open(folder / "ledger.sqlite", model="m") as ledger:
        ledger.plan(Plan(digest, "beam", "m", ("E",), False, 2, (("first", "second"),)))
        ledger.started(RunRequest("first", {"E": 2.0}))
        ledger.finished(RunRecord("first", {"E": 2.0}, "failed", {}, {}, 1.5, "stalled", "no end", "the log"))
    status, runs = ["status", str(folder)], ["runs", str(folder)]
    quick = [status, [*status, "--json"], runs, [*runs, "--state", "failed"], [*runs, "--show", "fir"]]
    *looks, began, noticed = loaded_by(*quick, ["init", str(tmp_path / "new")], ["check", str(tmp_path)])
    for code, shown, names in looks:
        assert (code, "stalled" in shown) == (0, True)
        assert HEAVY.isdisjoint(names)
    assert "beam: 1 of 2 runs" in looks[0][1]
    assert began[0] == 0
    assert HEAVY.isdisjoint(began[2])
    assert noticed[0] == 2
    assert {"numpy", "pydantic", "yaml"} <= set(noticed[2])
