"""`strandline run` and `strandline retry`, with all runs in this process."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from tests.study.conftest import SAMPLER
from tests.unit.cli.command_line import Shown, ends, refused

from strandline.cli import main
from strandline.runs import Ledger
from strandline.testing.studies import write_study

SMALL: dict[str, Any] = {
    "design": {"sobol": {"runs": 32}},
    "sampler": SAMPLER,
    "executor": {"in_process": {}},
    "draft": True,
    "report": "none",
}
LICENSED = """
from pathlib import Path
from strandline.errors import ForwardModelError
from strandline.testing.studies import undeclared_beam

HERE = Path(__file__).parent

def simulate(inputs, workdir):
    with (HERE / "calls").open("a") as file:
        file.write("call\\n")
    if inputs["E"] > float((HERE / "licence").read_text()):
        raise ForwardModelError("licence", "no licence to be had\\nthe server is down")
    return undeclared_beam(inputs, workdir)
"""
"""A beam that is not computed if it is stiffer than the licence says."""


def beams(low: float, high: float) -> dict[str, Any]:
    """Return inputs with E in this range; soft beams bend too far."""
    return {"E": {"prior": {"uniform": [low, high]}, "unit": "Pa"}, "tilt": {"prior": {"uniform": [0.0, 0.04]}}}


def test_each_run_and_step_is_shown_and_logged(tmp_path: Path, capsys: Shown) -> None:
    folder, log = write_study(tmp_path / "beam", **SMALL, inputs=beams(30, 560)), tmp_path / "run.log"
    log.write_text("before\n")
    main(["run", str(folder), "--verbose", "--log", str(log)])
    shown, runs = capsys.readouterr(), json.loads((folder / "summary.json").read_text("utf-8"))["runs"]
    counts = f"{runs['ok']} forward runs ok, {runs['failed']} failed ({runs['failed']} × large_deflection)"
    assert f"\nbeam: {counts} (32 new, 0 reused)\n" in shown.out
    assert "report: " not in shown.out
    lines = shown.err.splitlines()
    stages = ["observation …", "forward runs …", "surrogate …", "sampling …", "checks …"]
    assert [line for line in lines if line in stages] == stages
    told = re.findall(r"^  run [0-9a-f]{12} (\S+)(?: \(\S+\))? in \S+ s at ", shown.err, re.MULTILINE)
    assert len(told) == 32
    assert {*told} == {"ok", "failed"}
    assert re.search(r"failed \(large_deflection\) in .*; no folder is kept\n    the tip would move by", shown.err)
    assert "  32 runs by InProcess" in lines
    assert "  of the log-likelihood, kernel matern32" in lines
    assert "  1000 particles, seed 1, SMCSettings: " in shown.err
    assert len(re.findall(r"^  step to tempering exponent \S+: ESS \d+, accepted ", shown.err, re.MULTILINE)) >= 2
    first, *logged = log.read_text("utf-8").splitlines()
    found = [re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d (.*)", line) for line in logged]
    assert first == "before"
    assert [one[1] for one in found if one is not None] == lines


class TestRunsThatFail:
    @pytest.fixture
    def home(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        (tmp_path / "licensed.py").write_text(LICENSED)
        monkeypatch.syspath_prepend(tmp_path)
        return tmp_path

    def licence(self, home: Path, limit: float) -> None:
        (home / "licence").write_text(str(limit))

    def calls(self, home: Path) -> int:
        return len((home / "calls").read_text().splitlines())

    def study(self, home: Path, **changes: Any) -> Path:
        return write_study(
            home / "study", **{**SMALL, "model": {"python": {"function": "licensed:simulate"}}, **changes}
        )

    def test_they_are_made_once_more_and_the_results_anew(self, home: Path, capsys: Shown) -> None:
        """At first even the synthetic observation fails, then nearly all beams, and at last none."""
        truth = {"synthetic": {"E": 305, "tilt": 0.02, "load": 1e-5}}
        folder = self.study(home, observation=truth, failures={"stop": "never"})
        self.licence(home, 250.0)
        for _ in range(2):
            line = refused(capsys, "run", str(folder), "--quiet")
            assert "synthetic observation could not be made: got licence at E = 305" in line
            assert f"strandline retry {folder} --kind licence" in line
        assert self.calls(home) == 1
        self.licence(home, 310.0)
        assert "too few successful" in refused(capsys, "retry", str(folder), "--kind", "licence", "--quiet")
        with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
            made, missing = ledger.counts().total, ledger.counts().failed
        assert (self.calls(home), made) == (34, 33)
        assert "timeout" in refused(capsys, "retry", str(folder), "--kind", "timeout")
        self.licence(home, 1000.0)
        main(["retry", str(folder), "--kind", "licence", "--quiet"])
        assert capsys.readouterr().err == ""
        runs = json.loads((folder / "summary.json").read_text())["runs"]
        assert (runs["ok"], runs["failed"], runs["new"]) == (32, 0, missing)
        assert self.calls(home) == 34 + missing

    @pytest.mark.parametrize(
        ("failures", "made", "told"),
        [
            ({}, 21, ["stopped because 20 of 20 runs failed (20 × licence)", "the server is down"]),
            ({"kinds": {"licence": "abort"}}, 2, ["a run ended with licence", "E = "]),
        ],
    )
    def test_a_study_ends_early(
        self, failures: dict[str, Any], made: int, told: list[str], home: Path, capsys: Shown
    ) -> None:
        """If all of its runs fail, with the end of a log; or at the first failure, if it says so."""
        truth = {"synthetic": {"E": 100, "tilt": 0.02, "load": 1e-5}}
        folder = self.study(home, observation=truth, failures=failures)
        self.licence(home, 200.0)
        assert ends("run", str(folder), "--quiet") == 1
        said = capsys.readouterr().err
        assert [words for words in told if words not in said] == []
        assert "Traceback" not in said
        assert self.calls(home) == made
        assert sorted(path.name for path in folder.iterdir()) == ["ledger.lock", "ledger.sqlite", "study.yaml"]
