"""Commands as processes, and on a terminal: Ctrl-C, folders that cannot be written to, what is imported."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys

import httpx
import pytest
from tests.doors.models.waiting import until
from tests.unit.cli.command_line import contents, one_line
from tests.unit.runs.fakes import counts

from strandline import __version__
from strandline.cli import main
from strandline.cli.main import COMMANDS
from strandline.cli.progress import observing
from strandline.design.active import BatchReport
from strandline.runs import Ledger, Progress, RunRecord, RunRequest
from strandline.runs.ledger.plans import Plan
from strandline.smc import StepInfo
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
    command, ledger = [*STRANDLINE, "run", str(folder), "--quiet"], folder / "ledger.sqlite"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    driver = subprocess.Popen(command, **PIPES, env=environment, start_new_session=True)
    until(lambda: ledger.is_file() and counts(ledger).ok >= 4)
    os.killpg(driver.pid, signal.SIGINT)
    out, err = driver.communicate(timeout=30)
    assert (driver.returncode, out) == (130, "")
    assert one_line(err).endswith("interrupted; what is finished is kept; run the same command again to go on")
    kept = counts(ledger).ok - 1  # one run is the synthetic observation
    assert 3 <= kept < 32
    (tmp_path / "hurry").touch()
    main(["run", str(folder), "--workers", "1", "--json"])
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert (runs["ok"], runs["new"], runs["reused"]) == (32, 32 - kept, kept)


def test_a_folder_that_cannot_be_written_to(tmp_path):
    """Permissions bind the process, also if it is the superuser's."""
    folder, command = write_study(tmp_path / "study"), [*STRANDLINE, "run", str(tmp_path / "study")]
    before = contents(folder)
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("the superuser passes all permissions, and there is no setpriv to drop that right")
        command = ["setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override", *command]
    folder.chmod(0o555)
    ended = subprocess.run(command, capture_output=True, text=True)
    folder.chmod(0o755)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert f"cannot be written to: got {folder}: Permission denied" in one_line(ended.stderr)
    assert contents(folder) == before


@pytest.mark.smoke
def test_bars_fit_a_terminal_of_80_columns(capsys, monkeypatch):
    for name, value in {"FORCE_COLOR": "1", "COLUMNS": "80", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    with observing() as observer:
        observer.stage("forward")
        observer.run(RunRecord("key", {}, "ok"), Progress(3, 3, 3, 0, 0, 3.0))
        observer.stage("sampling")
        observer.step(StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0))
        observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
        observer.stage("replicates")
        observer.part(Progress(100, 40, 40, 0, 0, 1.0))
        observer.note("a note [that stays]")
    shown = capsys.readouterr().err
    for words in (
        "forward runs",
        "3 ok, 0 failed",
        "ESS 1234",
        "batch 3: E 396",
        "40 of 100",
        "[that stays]",
        "0:00:0",
    ):
        assert words in shown
    assert "…" not in shown.partition("sampling")[0]


def test_view_prints_its_address_and_ends_with_ctrl_c(tmp_path):
    folder = write_study(tmp_path / "beam")
    with subprocess.Popen([*STRANDLINE, "view", str(folder), "--no-browser"], **PIPES) as process:
        line = process.stdout.readline()
        found = re.fullmatch(rf"{re.escape(str(folder))}: (http://127\.0\.0\.1:(\d+)/[\w-]+/)\n", line)
        assert f"ssh -L {found[2]}:localhost:{found[2]} THIS_MACHINE" in process.stdout.readline()
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
    with contextlib.redirect_stdout(shown), contextlib.suppress(SystemExit):
        main(words)
    found.append((shown.getvalue(), sorted({name.partition(".")[0] for name in sys.modules})))
print(json.dumps(found))
"""


@pytest.mark.smoke
def test_help_status_and_runs_load_no_numerics_once_a_driver_has_noted_the_plan(tmp_path):
    """In a folder whose model is not there any more, so that nothing could be loaded if it were tried."""
    study, text = tmp_path / "study", "model: {python: {function: gone:away}}\n"
    study.mkdir()
    (study / "study.yaml").write_text(text)
    with Ledger.open(study / "ledger.sqlite", model="m") as ledger:
        digest = hashlib.sha256(text.encode()).hexdigest()
        ledger.plan(Plan(digest, "beam", "m", ("E",), False, 2, (("first", "second"),)))
        ledger.started(RunRequest("first", {"E": 2.0}))
        ledger.finished(RunRecord("first", {"E": 2.0}, "failed", {}, {}, 1.5, "stalled", "no end", "the log"))
    folder = str(study)
    commands = {("--version",): f"strandline, version {__version__}\n"}
    commands |= {(name, "--help"): f"Usage: strandline {name}" for name in COMMANDS}
    commands |= {("status", folder): "beam: 1 of 2 runs", ("runs", folder): "stalled"}
    commands |= {("runs", folder, "--show", "fir"): "stalled", ("init", f"{folder}-new"): "wrote"}
    words = [sys.executable, "-c", PROBE, json.dumps([*commands, ("check", folder)])]
    *quick, slow = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    for (given, told), (shown, names) in zip(commands.items(), quick, strict=True):
        assert told in shown, given
        assert HEAVY.isdisjoint(names), given
    assert "numpy" in slow[1]
