"""`strandline status`: what it prints of a state."""

import json
from pathlib import Path
from typing import Any

from tests.unit.cli.command_line import Shown, printed

from strandline.cli.status import lines_of
from strandline.runs import Ledger, RunRecord, RunRequest
from strandline.runs.overview import Driver
from strandline.studies import load_study
from strandline.studies.progress import Failures, RunReported, StudyProgress
from strandline.testing.studies import write_study

RUN = RunReported("k" * 64, {"E": 397.5, "tilt": 0.015}, 9.0, "no convergence", ("step 7", "stopped"))
AT_WORK = "  driver at work, process 4711 on desk"


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
        f"{AT_WORK}: 4.8 runs a minute, about 10 min left",
        "  2 × stalled; e.g. E = 397.5, tilt = 0.015: no convergence",
        "    | step 7",
        "    | stopped",
        "  median 2.00 s a run, slowest 9.00 s at E = 397.5, tilt = 0.015",
        "  results: not yet",
    ]
    assert len(list(lines_of(StudyProgress("bent", 80)))) == 3


LINES: list[tuple[dict[str, Any], str]] = [
    ({"lost": 3}, "  ok 0, failed 0, under way 0, to do 80, 3 of them lost with their driver"),
    ({"driver": driver(False), "rate": 240.4}, "  no driver at work; the last made 240 runs a minute"),
    ({"driver": driver(False)}, "  no driver at work"),
    ({"driver": driver(True)}, AT_WORK),
    ({"driver": driver(None), "open": 1}, "  ok 0, failed 0, under way (or lost) 1, to do 79"),
    ({"driver": driver(None)}, "  driver process 4711 on desk; strandline cannot see from here whether it is running"),
    ({"driver": driver(True), "rate": 60.0, "seconds_left": 80.0}, f"{AT_WORK}: 60 runs a minute, about 80 s left"),
    ({"driver": driver(True), "rate": 10.0, "seconds_left": 90.0}, f"{AT_WORK}: 10 runs a minute, about 2 min left"),
    ({"driver": driver(True), "rate": 0.5, "seconds_left": 9600.0}, f"{AT_WORK}: 0.5 runs a minute, about 2.7 h left"),
    (
        {"driver": driver(True), "rate": 60.0, "seconds_left": 80.0, "active": True},
        f"{AT_WORK}: 60 runs a minute, at most 80 s left",
    ),
    ({"active": True}, "bent: 0 of at most 80 runs of the design done"),
    ({"last_batch": "batch 3: E 396 ± 31; next: check"}, "  batch 3: E 396 ± 31; next: check"),
    ({"results": "outdated"}, "  results: of an earlier study.yaml"),
    ({"results": "current"}, "  results: written"),
]


def test_a_line_for_each_fact() -> None:
    for options, line in LINES:
        assert line in list(lines_of(StudyProgress("bent", 80, **options))), options


def test_a_failure_is_told_with_the_end_of_its_log(tmp_path: Path, capsys: Shown) -> None:
    study = load_study(write_study(tmp_path / "beam", design={"sobol": {"runs": 4}}))
    assert "0 of 4 runs of the design done" in printed(capsys, "status", str(study.folder))
    plan = study.runs.plan
    inputs = {"E": 300.0, "tilt": 0.0, "load": 1e-5}
    with Ledger.open(study.ledger_path, model=plan.model) as ledger:
        ledger.plan(plan)
        ledger.started(RunRequest(plan.keys[0], inputs))
        log = "a\nb\n" + 300 * "c"
        ledger.finished(RunRecord(plan.keys[0], inputs, "failed", {}, {}, 1.0, "stalled", "why\nmore", log))
        assert "driver at work, process " in printed(capsys, "status", str(study.folder))
    shown = printed(capsys, "status", str(study.folder)).splitlines()
    assert shown[1] == "  ok 0, failed 1, under way 0, to do 3"
    place = shown.index("  1 × stalled; e.g. E = 300, tilt = 0: why")
    assert shown[place + 1 : place + 3] == ["    | b", "    | " + 159 * "c" + "…"]
    found = json.loads(printed(capsys, "status", str(study.folder), "--json"))
    assert (found["name"], found["planned"], found["done"], found["to_do"]) == ("beam", 4, 1, 3)
    assert (found["ok"], found["failed"], found["open"], found["lost"]) == (0, 1, 0, 0)
    assert (found["results"], found["seconds_left"], found["driver"]["at_work"]) == ("none", None, False)
    assert found["slowest"]["inputs"] == {"E": 300.0, "tilt": 0.0}
    assert found["failures"]["stalled"]["count"] == 1
    assert found["failures"]["stalled"]["example"]["message"] == "why"
