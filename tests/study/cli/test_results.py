"""What the commands print of a finished study, and what they write again."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.study.conftest import Finished
from tests.unit.cli.command_line import Shown, contents, printed

from strandline.cli import main
from strandline.runs import Ledger
from strandline.studies import load_study

Copy = Callable[[Finished], Path]


@pytest.fixture
def made(beam: Finished) -> int:
    """The number of runs of its design."""
    return beam.study.settings.runs


def test_a_study_that_has_not_changed_is_shown_and_not_run(beam: Finished, made: int, capsys: Shown) -> None:
    before = contents(beam.folder)
    shown = printed(capsys, "run", str(beam.folder))
    summary = json.loads((beam.folder / "summary.json").read_text())
    assert f"beam: {made} forward runs ok, 0 failed (0 new, {made} reused)" in shown
    for name, item in summary["inputs"].items():
        row = next(line for line in shown.splitlines() if line.split()[:1] == [name])
        for figure in ("mean", "sd", "median", "q05", "q95", "map"):
            assert f"{item[figure]:.4g}" in row
    assert f"log-evidence {summary['log_evidence']:.3f}; effective samples {summary['sampler']['ess']:.0f}" in shown
    assert f"report: {beam.folder}/report.html" in shown
    assert f"Nothing has changed since. To write the results again: strandline report {beam.folder}" in shown
    found = json.loads(printed(capsys, "run", str(beam.folder), "--json"))
    assert (found["inputs"], found["runs"]["new"]) == (summary["inputs"], 0)
    assert "Nothing has changed" not in printed(capsys, "run", str(beam.folder), "--quiet")
    assert contents(beam.folder) == before


def test_both_ways_to_the_status_print_the_same(
    beam: Finished, made: int, capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    ways = []

    def loaded(path: Path) -> object:
        ways.append(path)
        return load_study(path)

    monkeypatch.setattr("strandline.studies.study.load_study", loaded)
    folder = str(beam.folder)
    quick = [printed(capsys, "status", folder, *options) for options in ([], ["--json"])]
    assert ways == []
    monkeypatch.setattr("strandline.studies.progress.recorded_plan", lambda folder: None)
    assert [printed(capsys, "status", folder, *options) for options in ([], ["--json"])] == quick
    assert ways == 2 * [beam.folder]
    assert f"beam: {made} of {made} runs of the design done\n  ok {made}, failed 0, under way 0, to do 0\n" in quick[0]
    assert "results: written" in quick[0]
    found = json.loads(quick[1])
    with Ledger.open(beam.folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        slowest = max(ledger, key=lambda record: record.seconds)
    assert (found["planned"], found["done"], found["results"]) == (made, made, "current")
    assert found["runs_per_minute"] > 0
    assert found["slowest"]["seconds"] <= slowest.seconds


def test_the_list_of_runs_ends_with_the_last(beam: Finished, capsys: Shown) -> None:
    found = json.loads(printed(capsys, "runs", str(beam.folder), "--json", "--state", "ok", "--limit", "3"))
    with Ledger.open(beam.folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        last = list(ledger)[-1]
    assert len(found) == 3
    assert (found[-1]["key"], found[-1]["inputs"], found[-1]["state"]) == (last.key, dict(last.inputs), "ok")


def test_report_writes_the_results_again(beam: Finished, made: int, copy_of: Copy, capsys: Shown) -> None:
    folder = copy_of(beam)
    before = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").unlink()
    text = (folder / "study.yaml").read_text()
    (folder / "study.yaml").write_text(text.replace('"draft": true', '"draft": true, "report": "none"'))
    assert f"(0 new, {made} reused)" in printed(capsys, "report", str(folder), "--quiet")
    assert json.loads((folder / "summary.json").read_text())["inputs"] == before["inputs"]
    assert not (folder / "report.html").exists()


def test_run_with_other_values_runs_a_copy_that_takes_over_all_runs(
    beam: Finished, made: int, copy_of: Copy, capsys: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copy_of(beam)
    before = contents(folder)
    monkeypatch.chdir(folder.parent)
    words = ["run", "study", "--set", "noise.sd=0.006", "--set", "seed=3", "--set", "report=none", "--json"]
    main(words)
    shown = capsys.readouterr()
    second = json.loads(shown.out)
    copy = Path("study-noise.sd-0.006-report-none-seed-3")
    assert f"noise.sd=0.006, seed=3, report=none: the study in {copy}\n" in shown.err
    assert (second["study"], second["runs"]["new"], second["runs"]["reused"]) == (copy.name, 0, made)
    assert second["inputs"]["E"]["sd"] > 1.3 * beam.outcome.summary["inputs"]["E"]["sd"]
    main(words)  # the same again
    assert json.loads(capsys.readouterr().out)["runs"] == second["runs"]
    assert contents(folder) == before
    assert sorted(path.name for path in Path().iterdir()) == ["study", copy.name]


def test_check_draws_what_was_observed(beam: Finished, made: int, copy_of: Copy, capsys: Shown) -> None:
    folder = copy_of(beam)
    shown = printed(capsys, "check", str(folder), "--plot", "--widths")
    assert f"wrote {folder / 'check.png'}" in shown
    assert (folder / "check.png").read_bytes().startswith(b"\x89PNG")
    assert f"{made} forward runs planned, {made} of them known already" in shown
