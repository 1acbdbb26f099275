"""`--help` is quick because it loads no numerics."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from strandline import __version__
from strandline.cli.main import COMMANDS
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.plans import Plan

HEAVY = {"numpy", "scipy", "jax", "matplotlib", "ngsolve", "netgen", "pydantic", "yaml", "rich", "xarray", "jinja2"}
PROBE = """
import sys
from strandline.cli import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    code = ended.code
else:
    code = 0
print("LOADED", code, *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def loaded_by(*arguments: str) -> tuple[int, set[str], str]:
    """Return exit code, loaded top-level packages and output of a command line in a process of its own."""
    command = [sys.executable, "-c", PROBE, *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    shown, _, tail = ended.stdout.rpartition("LOADED ")
    code, *names = tail.split()
    return int(code), set(names), shown + ended.stderr


@pytest.mark.parametrize(
    "arguments",
    [(), *((name,) for name in COMMANDS), ("posterior", "check")],
    ids=["strandline", *COMMANDS, "posterior check"],
)
def test_help_loads_no_numerics(arguments: tuple[str, ...]) -> None:
    code, names, shown = loaded_by(*arguments, "--help")
    assert code == 0
    assert shown.startswith(f"Usage: strandline {' '.join(arguments)}".rstrip())
    assert names.isdisjoint(HEAVY)


def test_the_probe_sees_what_is_loaded(tmp_path: object) -> None:
    code, names, _ = loaded_by("check", str(tmp_path))
    assert code == 2
    assert {"numpy", "pydantic", "yaml"} <= names


def test_init_loads_no_numerics(tmp_path: object) -> None:
    code, names, _ = loaded_by("init", f"{tmp_path}/study")
    assert code == 0
    assert names.isdisjoint(HEAVY)


def test_status_and_runs_load_no_numerics_once_a_driver_has_noted_the_plan(tmp_path: Path) -> None:
    """In a folder whose model is not there any more, so that nothing could be loaded if it were tried."""
    folder, path = tmp_path, tmp_path / "ledger.sqlite"
    (folder / "study.yaml").write_text("model: {python: {function: gone:away}}\n")
    digest = hashlib.sha256((folder / "study.yaml").read_bytes()).hexdigest()
    with Ledger.open(path, model="m") as ledger:
        ledger.plan(Plan(digest, "beam", "m", ("E",), False, 2, (("first", "second"),)))
        ledger.started(RunRequest("first", {"E": 2.0}))
        ledger.finished(RunRecord("first", {"E": 2.0}, "failed", {}, {}, 1.5, "stalled", "no end", "the log"))
    for options in ([], ["--json"]):
        code, names, shown = loaded_by("status", str(folder), *options)
        assert (code, "stalled" in shown) == (0, True)
        assert names.isdisjoint(HEAVY)
    assert "beam: 1 of 2 runs" in loaded_by("status", str(folder))[2]
    for arguments in ([], ["--state", "failed"], ["--show", "fir"]):
        code, names, shown = loaded_by("runs", str(folder), *arguments)
        assert (code, "stalled" in shown) == (0, True)
        assert names.isdisjoint(HEAVY)
    (folder / "study.yaml").write_text("model: {python: {function: gone:again}}\n")
    code, names, _ = loaded_by("status", str(folder))
    assert code == 2
    assert {"numpy", "pydantic", "yaml"} <= names


def test_help_names_every_command() -> None:
    _, _, shown = loaded_by("--help")
    for name, line in COMMANDS.items():
        assert f"  {name}" in shown
        assert line in shown


def test_version_and_no_command() -> None:
    assert loaded_by("--version")[2] == f"strandline, version {__version__}\n"
    code, _, shown = loaded_by()
    assert code == 2
    assert shown.startswith("Usage: strandline")
