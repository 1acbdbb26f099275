"""`--help` is quick because it loads no numerics; nor do the commands that only look at a ledger."""

import hashlib
import json
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
    found.append((code, shown.getvalue(), sorted({name.partition(".")[0] for name in sys.modules})))
print(json.dumps(found))
"""


def loaded_by(*commands: list[str]) -> list[tuple[int, str, set[str]]]:
    """Return code, output and loaded packages after each of some commands in one process."""
    words = [sys.executable, "-c", PROBE, json.dumps(commands)]
    ended = subprocess.run(words, capture_output=True, text=True, check=True)
    return [(int(code or 0), shown, {*names}) for code, shown, names in json.loads(ended.stdout)]


@pytest.mark.smoke
def test_no_help_loads_numerics() -> None:
    commands = [[], *([name] for name in COMMANDS), ["posterior", "check"]]
    helped = loaded_by(*([*words, "--help"] for words in commands), ["--version"])
    assert helped.pop()[1] == f"strandline, version {__version__}\n"
    for words, (code, shown, names) in zip(commands, helped, strict=True):
        assert code == 0
        assert shown.startswith(f"Usage: strandline {' '.join(words)}".rstrip())
        assert names.isdisjoint(HEAVY), words
    for name, line in COMMANDS.items():
        assert f"  {name}" in helped[0][1]
        assert line in helped[0][1]


@pytest.mark.smoke
def test_status_and_runs_load_no_numerics_once_a_driver_has_noted_the_plan(tmp_path: Path) -> None:
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
        assert names.isdisjoint(HEAVY)
    assert "beam: 1 of 2 runs" in looks[0][1]
    assert began[0] == 0
    assert began[2].isdisjoint(HEAVY)
    assert noticed[0] == 2
    assert {"numpy", "pydantic", "yaml"} <= noticed[2]
