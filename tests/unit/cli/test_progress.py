"""What is told while a study runs: progress as plain lines, none when quiet, details, and `strandline status`."""

from dataclasses import replace

import pytest

from strandline.calibration import problem
from strandline.cli.progress import SECONDS_BETWEEN_LINES, detailed, observing, set_aside_lines
from strandline.cli.runs import lines_of
from strandline.design.active import BatchReport
from strandline.runs import InProcess, RunRecord
from strandline.runs import Progress as Runs
from strandline.runs.ledger.overview import Driver
from strandline.smc import StepInfo
from strandline.studies import load_study
from strandline.studies.load.progress import FailedRuns, RunReported, StudyProgress
from strandline.testing.studies import write_study

RECORD = RunRecord("key", {"E": 1.0}, "ok")
FIRST, LAST = StepInfo(0.5, 1000.0, 0.3, False, 0.0, 1.0), StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0)


def state(finished, *, elapsed=1.0):
    return Runs(total=100, finished=finished, ok=finished - 1, failed=1, reused=0, elapsed=elapsed)


def test_a_stage_has_a_line_now_and_then_and_one_at_its_end(capsys):
    now = [0.0]
    with observing(clock=lambda: now[0]) as observer:
        observer.stage("forward")
        now[0] += SECONDS_BETWEEN_LINES - 1
        observer.run(RECORD, state(1))
        now[0] += 1
        observer.run(RECORD, state(50, elapsed=70.0))
        observer.run(RECORD, replace(state(51), waiting=True))
        observer.run(RECORD, state(100))
        observer.stage("sampling")
        observer.step(FIRST)
        observer.step(LAST)
        observer.part(state(100))
        for wait in (0.0, SECONDS_BETWEEN_LINES + 1):  # a choice that takes long says how far it is
            observer.stage("choice")
            now[0] += wait
            observer.step(FIRST)
            observer.step(LAST)
        observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "forward runs …",
        "  50/100 49 ok, 1 failed, 1 min 10 s left",
        "  51/100 50 ok, 1 failed, waiting for the model's server",
        "  100/100 99 ok, 1 failed",
        "sampling …",
        "  tempering exponent 1.0000, ESS 1234, accepted 25%",
        "  100 of 100",
        "next batch …",
        "next batch …",
        "  tempering exponent 0.5000, ESS 1000, accepted 30%",
        "  batch 3: E 396 ± 31, moved 0.05 sd; next: check",
    ]


def test_durations():
    told = {0.4: "0 s", 59.4: "59 s", 60.0: "1 min 00 s", 3599.9: "1 h 00 min", 7265.0: "2 h 01 min"}
    assert {seconds: problem._duration(seconds) for seconds in told} == told


def test_details_of_runs_name_folders_origins_and_reasons(tmp_path):
    study, lines = load_study(write_study(tmp_path)), list[str]()
    for attempt in (1, 2, 10):
        (tmp_path / "runs" / f"{'a' * 12}-{attempt}").mkdir(parents=True)
    observer, now = detailed(study, InProcess(), lines.append), state(3)
    observer.stage("forward")
    observer.run(RunRecord("a" * 64, {"E": 400.0}, "ok", seconds=1.25, origin="../other/ledger.sqlite"), now)
    why = "too long\nits folder: /kept/b-1"
    observer.run(RunRecord("b" * 64, {}, "timeout", failure_kind="timeout", message=why), now)
    observer.run(RunRecord("c" * 64, {}, "failed", failure_kind="bent"), now)
    observer.stage("forward")
    observer.step(LAST)
    kept = tmp_path / "runs" / f"{'a' * 12}-10"
    assert lines == [
        "  64 runs by InProcess",
        f"  run aaaaaaaaaaaa ok in 1.25 s at E = 400; its folder: {kept}; taken over from ../other/ledger.sqlite",
        "  run bbbbbbbbbbbb timeout (timeout) in 0 s at ; its folder: /kept/b-1",
        "    too long",
        "  run cccccccccccc failed (bent) in 0 s at ; no folder is kept",
        "  step to tempering exponent 1.0000: ESS 1234, accepted 25%",
    ]
    one = {"key": "c" * 64, "kind": "flipped", "why": "the other way"}
    assert set_aside_lines({"set_aside": [one]}) == ["  run cccccccccccc set aside (flipped): the other way"]


AT_WORK, GONE, UNSEEN = (Driver(3, 4711, "desk", 1e9, at_work) for at_work in (True, False, None))


def test_the_status_of_a_study_under_way():
    run = RunReported("k" * 64, {"E": 397.5, "tilt": 0.015}, 9.0, "no convergence", ("step 7", 300 * "c"))
    counts = {"ok": 30, "failed": 2, "open": 4, "failures": {"stalled": FailedRuns(2, run)}, "slowest": run}
    pace = {"rate": 4.8, "seconds_left": 600.0, "median_seconds": 2.0, "driver": AT_WORK}
    assert list(lines_of(StudyProgress("bent", 80, **counts, **pace))) == [
        "bent: 32 of 80 runs of the design done",
        "  ok 30, failed 2, under way 4, to do 44",
        "  driver at work, process 4711 on desk: 4.8 runs a minute, about 10 min left",
        "  2 × stalled; e.g. E = 397.5, tilt = 0.015: no convergence",
        "    | step 7",
        "    | " + 159 * "c" + "…",
        "  median 2.00 s a run, slowest 9.00 s at E = 397.5, tilt = 0.015",
        "  results: not yet",
    ]


@pytest.mark.stand_in
def test_the_status_has_a_line_for_each_fact():
    unseen = "  driver process 4711 on desk; strandline cannot see from here whether it is running"
    work = "  driver at work, process 4711 on desk: 6 runs a minute"
    for options, line in (
        ({"lost": 3}, "  ok 0, failed 0, under way 0, to do 80, 3 of them lost with their driver"),
        ({"driver": GONE, "rate": 240.4}, "  no driver at work; the last made 240 runs a minute"),
        ({"driver": UNSEEN, "open": 1}, "  ok 0, failed 0, under way (or lost) 1, to do 79"),
        ({"driver": UNSEEN}, unseen),
        ({"driver": AT_WORK, "rate": 6, "seconds_left": 9600.0}, f"{work}, about 2.7 h left"),
        ({"driver": AT_WORK, "rate": 6, "seconds_left": 8, "active": True}, f"{work}, at most 8 s left"),
        ({"active": True}, "bent: 0 of at most 80 runs of the design done"),
        ({"results": "outdated"}, "  results: of an earlier study.yaml"),
    ):
        assert line in list(lines_of(StudyProgress("bent", 80, **options))), options
