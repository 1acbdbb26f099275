"""`strandline status`: what it prints of a state, and that both ways to the state print the same."""

import json
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from strandline.cli import main
from strandline.cli.status import lines_of
from strandline.runs import InProcess, Ledger, RunRecord, RunRequest
from strandline.runs.overview import Driver
from strandline.studies import load_study, run_study
from strandline.studies.progress import Failures, RunReported, StudyProgress
from strandline.testing.studies import write_study

RUN = RunReported("k" * 64, {"E": 397.5, "tilt": 0.015}, 9.0, "no convergence", ("step 7", "stopped"))


def driver(at_work: bool | None) -> Driver:
    return Driver(3, 4711, "desk", 1e9, at_work)


def test_a_study_under_way() -> None:
    state = StudyProgress(
        "bent",
        80,
        ok=30,
        failed=2,
        open=4,
        failures={"stalled": Failures(2, RUN)},
        rate=4.8,
        seconds_left=600.0,
        median_seconds=2.0,
        slowest=RUN,
        driver=driver(True),
    )
    assert list(lines_of(state)) == [
        "bent: 32 of 80 runs of the design done",
        "  ok 30, failed 2, under way 4, to do 44",
        "  driver at work, process 4711 on desk: 4.8 runs a minute, about 10 min left",
        "  2 × stalled; e.g. E = 397.5, tilt = 0.015: no convergence",
        "    | step 7",
        "    | stopped",
        "  median 2.00 s a run, slowest 9.00 s at E = 397.5, tilt = 0.015",
        "  results: not yet",
    ]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"lost": 3}, "  ok 0, failed 0, under way 0, to do 80, 3 of them lost with their driver"),
        ({"driver": driver(False), "rate": 240.4}, "  no driver at work; the last made 240 runs a minute"),
        ({"driver": driver(False)}, "  no driver at work"),
        ({"driver": driver(True)}, "  driver at work, process 4711 on desk"),
        ({"driver": driver(None), "open": 1}, "  ok 0, failed 0, under way (or lost) 1, to do 79"),
        (
            {"driver": driver(None)},
            "  driver process 4711 on desk; strandline cannot see from here whether it is running",
        ),
        (
            {"driver": driver(True), "rate": 60.0, "seconds_left": 80.0},
            "  driver at work, process 4711 on desk: 60 runs a minute, about 80 s left",
        ),
        (
            {"driver": driver(True), "rate": 0.5, "seconds_left": 9600.0},
            "  driver at work, process 4711 on desk: 0.5 runs a minute, about 2.7 h left",
        ),
        (
            {"driver": driver(True), "rate": 60.0, "seconds_left": 80.0, "active": True},
            "  driver at work, process 4711 on desk: 60 runs a minute, at most 80 s left",
        ),
        ({"active": True}, "bent: 0 of at most 80 runs of the design done"),
        ({"last_batch": "batch 3: E 396 ± 31; next: check"}, "  batch 3: E 396 ± 31; next: check"),
        ({"results": "outdated"}, "  results: of an earlier study.yaml"),
    ],
)  # fmt: skip
def test_lines(options: dict[str, Any], line: str) -> None:
    assert line in list(lines_of(StudyProgress("bent", 80, **options)))


def test_no_driver_yet() -> None:
    assert len(list(lines_of(StudyProgress("bent", 80)))) == 3


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    main(list(arguments))
    shown = capsys.readouterr()
    assert shown.err == ""
    return shown.out


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of 16 runs, nine of them failures, and one more that is lost."""
    sampler = {"smc": {"particles": 200, "rejuvenation_steps": 2, "zeta": 0.5}}
    folder = write_study(
        tmp_path_factory.mktemp("status") / "beam",
        fixed={"load": 1e-4},
        design={"sobol": {"runs": 16}},
        sampler=sampler,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *a, folder, **o: folder / "report.html")
        run_study(load_study(folder), executor=InProcess())
    return folder


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_both_ways_print_the_same(
    folder: Path, options: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ways = []

    def loaded(path: Path) -> Any:
        ways.append(path)
        return load_study(path)

    monkeypatch.setattr("strandline.studies.study.load_study", loaded)
    quick = printed(capsys, "status", str(folder), *options)
    assert ways == []
    monkeypatch.setattr("strandline.studies.progress.recorded_plan", lambda folder: None)
    assert printed(capsys, "status", str(folder), *options) == quick
    assert ways == [folder]


def test_json_says_what_the_lines_say(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(printed(capsys, "status", str(folder), "--json"))
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        made = [record for record in ledger if record.inputs["load"] == 1e-4]
    bad = [record for record in made if not record.ok]
    assert (found["name"], found["planned"], found["done"], found["to_do"]) == ("beam", 16, 16, 0)
    assert (found["ok"], found["failed"], found["open"], found["lost"]) == (16 - len(bad), len(bad), 0, 0)
    assert found["driver"]["pid"] == os.getpid()
    assert (found["driver"]["host"], found["driver"]["at_work"]) == (socket.gethostname(), False)
    assert (found["results"], found["seconds_left"]) == ("current", None)
    assert found["runs_per_minute"] > 0
    slowest = max(made, key=lambda record: record.seconds)
    assert (found["slowest"]["key"], found["slowest"]["seconds"]) == (slowest.key, slowest.seconds)
    assert found["slowest"]["inputs"] == {name: slowest.inputs[name] for name in ("E", "tilt")}
    (told,) = found["failures"].values()
    assert told["count"] == len(bad) > 0
    assert (told["example"]["key"], told["example"]["message"]) == (bad[0].key, bad[0].message)


def test_the_log_of_a_failure_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = load_study(write_study(tmp_path / "beam", design={"sobol": {"runs": 4}}))

    plan = study.runs.plan
    inputs = {"E": 300.0, "tilt": 0.0, "load": 1e-5}
    with Ledger.open(study.ledger_path, model=plan.model) as ledger:
        ledger.plan(plan)
        ledger.started(RunRequest(plan.keys[0], inputs))
        log = "a\nb\n" + 300 * "c"
        ledger.finished(RunRecord(plan.keys[0], inputs, "failed", {}, {}, 1.0, "stalled", "why\nmore", log))
    shown = printed(capsys, "status", str(study.folder)).splitlines()
    place = shown.index("  1 × stalled; e.g. E = 300, tilt = 0: why")
    assert shown[place + 1 : place + 3] == ["    | b", "    | " + 159 * "c" + "…"]
