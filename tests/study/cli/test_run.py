"""What `strandline run` and `retry` do, with all runs in this process, and what commands print of a finished study."""

import json
import re
from pathlib import Path
from unittest.mock import Mock, call

from tests.study.conftest import SAMPLER
from tests.unit.cli.command_line import contents, printed, refused

from strandline.cli import main
from strandline.runs import Ledger
from strandline.studies import load_study
from strandline.testing.studies import BEAM_STUDY, write_study

SMALL = {"design": {"sobol": {"runs": 32}}, "sampler": SAMPLER, "executor": {"in_process": {}}}
SMALL |= {"draft": True, "report": "none"}
STAGES = ["observation", "forward runs", "surrogate", "sampling", "checks", "figures and report"]
LICENSED = """
from pathlib import Path
from strandline.foundations import ForwardModelError
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


def test_each_run_and_step_is_shown_and_logged(tmp_path, capsys):
    """Some beams are so soft that they bend too far."""
    inputs = {**BEAM_STUDY["inputs"], "E": {"prior": {"uniform": [30, 560]}, "unit": "Pa"}}
    folder, log = write_study(tmp_path / "beam", **SMALL, inputs=inputs), tmp_path / "run.log"
    main(["run", str(folder), "--verbose", "--log", str(log)])
    shown, runs = capsys.readouterr(), json.loads((folder / "summary.json").read_text("utf-8"))["runs"]
    counts = f"{runs['ok']} forward runs ok, {runs['failed']} failed ({runs['failed']} × large_deflection)"
    assert f"\nbeam: {counts} (32 new, 0 reused)\n" in shown.out
    assert "report: " not in shown.out
    lines = shown.err.splitlines()
    assert [line for line in lines if line.endswith(" …")] == [f"{stage} …" for stage in STAGES]
    assert len(re.findall(r"^  run [0-9a-f]{12} (?:ok|failed \(\S+\)) in \S+ s at ", shown.err, re.MULTILINE)) == 32
    assert len(re.findall(r"^  step to tempering exponent \S+: ESS \d+, accepted ", shown.err, re.MULTILINE)) >= 2
    assert "  32 runs by InProcess" in lines
    assert [line[20:] for line in log.read_text("utf-8").splitlines()] == lines


def test_runs_that_failed_are_made_once_more_and_the_results_anew(tmp_path, monkeypatch, capsys):
    """At first even the synthetic observation fails, then nearly all beams, and at last none."""
    (tmp_path / "licensed.py").write_text(LICENSED)
    monkeypatch.syspath_prepend(tmp_path)
    content = {**SMALL, "model": {"python": {"function": "licensed:simulate"}}, "failures": {"stop": "never"}}
    content["observation"] = {"synthetic": {"E": 305, "tilt": 0.02, "load": 1e-5}}
    folder, licence = str(write_study(tmp_path / "study", **content)), tmp_path / "licence"
    licence.write_text("250")
    line = refused(capsys, "run", folder, "--quiet")
    assert "run of the synthetic observation failed: got licence at E = 305" in line
    assert f"strandline retry {folder} --kind licence" in line
    licence.write_text("310")
    assert "too few successful" in refused(capsys, "retry", folder, "--kind", "licence", "--quiet")
    with Ledger.open(Path(folder) / "ledger.sqlite", model=None, read_only=True) as ledger:
        made, missing = ledger.counts().total, ledger.counts().failed
    assert made == 33
    licence.write_text("1000")
    printed(capsys, "retry", folder, "--kind", "licence", "--quiet")
    runs = json.loads((Path(folder) / "summary.json").read_text())["runs"]
    assert (runs["ok"], runs["failed"], runs["new"]) == (32, 0, missing)
    assert len((tmp_path / "calls").read_text().splitlines()) == 34 + missing


def test_a_study_that_has_not_changed_is_shown_and_not_run(beam, capsys):
    before = contents(beam.folder)
    shown = printed(capsys, "run", str(beam.folder))
    summary = json.loads((beam.folder / "summary.json").read_text())
    assert "beam: 64 forward runs ok, 0 failed (0 new, 64 reused)" in shown
    for name, item in summary["inputs"].items():
        row = next(line for line in shown.splitlines() if line.split()[:1] == [name])
        assert all(f"{item[figure]:.4g}" in row for figure in ("mean", "sd", "median", "q05", "q95", "map"))
    assert f"log-evidence {summary['log_evidence']:.3f}; effective samples {summary['sampler']['ess']:.0f}" in shown
    assert f"Nothing has changed since. To write the results again: strandline report {beam.folder}" in shown
    found = json.loads(printed(capsys, "run", str(beam.folder), "--json"))
    assert (found["inputs"], found["runs"]["new"]) == (summary["inputs"], 0)
    assert contents(beam.folder) == before


def test_both_ways_to_the_status_print_the_same(beam, capsys, monkeypatch):
    loaded = Mock(side_effect=load_study)
    monkeypatch.setattr("strandline.studies.load.load.load_study", loaded)
    folder = str(beam.folder)
    quick = [printed(capsys, "status", folder, *options) for options in ([], ["--json"])]
    assert not loaded.called
    monkeypatch.setattr("strandline.studies.load.progress.recorded_plan", lambda folder: None)
    assert [printed(capsys, "status", folder, *options) for options in ([], ["--json"])] == quick
    assert loaded.call_args_list == [call(beam.folder)] * 2
    assert "beam: 64 of 64 runs of the design done\n  ok 64, failed 0, under way 0, to do 0\n" in quick[0]
    assert "results: written" in quick[0]
    found = json.loads(quick[1])
    counts = {"planned": 64, "done": 64, "ok": 64, "failed": 0, "open": 0, "lost": 0, "to_do": 0, "results": "current"}
    assert counts.items() <= found.items()


def test_report_writes_the_results_again(beam, copy_of, capsys):
    folder = copy_of(beam)
    before = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").unlink()
    text = (folder / "study.yaml").read_text()
    (folder / "study.yaml").write_text(text.replace('"draft": true', '"draft": true, "report": "none"'))
    assert "(0 new, 64 reused)" in printed(capsys, "report", str(folder), "--quiet")
    assert json.loads((folder / "summary.json").read_text())["inputs"] == before["inputs"]


def test_run_with_other_values_runs_a_copy_that_takes_over_all_runs(beam, copy_of, capsys, monkeypatch):
    folder = copy_of(beam)
    before = contents(folder)
    monkeypatch.chdir(folder.parent)
    main(["run", "study", "--set", "noise.sd=0.006", "--set", "seed=3", "--set", "report=none", "--json"])
    shown = capsys.readouterr()
    second = json.loads(shown.out)
    copy = Path("study-noise.sd-0.006-report-none-seed-3")
    assert f"noise.sd=0.006, seed=3, report=none: the study in {copy}\n" in shown.err
    assert (second["study"], second["runs"]["new"], second["runs"]["reused"]) == (copy.name, 0, 64)
    assert second["inputs"]["E"]["sd"] > 1.3 * beam.outcome.summary["inputs"]["E"]["sd"]
    assert contents(folder) == before
    assert sorted(path.name for path in Path().iterdir()) == ["study", copy.name]
