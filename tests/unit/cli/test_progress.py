"""Progress as plain lines, and none when quiet."""

import re
from pathlib import Path

from tests.unit.cli.command_line import Shown

from strandline.calibration import progress_text
from strandline.cli.details import detailed, set_aside_lines
from strandline.cli.progress import SECONDS_BETWEEN_LINES, observing
from strandline.design.active import BatchReport
from strandline.runs import InProcess, RunRecord
from strandline.runs import Progress as Runs
from strandline.smc import StepInfo
from strandline.studies import load_study
from strandline.testing.studies import write_study

RECORD = RunRecord("key", {"E": 1.0}, "ok")
FIRST, LAST = StepInfo(0.5, 1000.0, 0.3, False, 0.0, 1.0), StepInfo(1.0, 1234.5, 0.25, False, 0.0, 1.0)


class Clock:
    """A clock that others set."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def state(finished: int, *, reused: int = 0, elapsed: float = 1.0) -> Runs:
    return Runs(total=100, finished=finished, ok=finished - 1, failed=1, reused=reused, elapsed=elapsed)


def test_a_stage_has_a_line_now_and_then_and_one_at_its_end(capsys: Shown) -> None:
    clock = Clock()
    with observing(clock=clock) as observer:
        observer.stage("forward")
        clock.now += SECONDS_BETWEEN_LINES - 1
        observer.run(RECORD, state(1))
        clock.now += 1
        observer.run(RECORD, state(50, elapsed=70.0))
        observer.run(RECORD, state(51))
        observer.run(RECORD, state(100))
        observer.stage("sampling")
        observer.step(FIRST)
        observer.step(LAST)
        observer.stage("replicates")
        observer.part(state(10))
        clock.now += SECONDS_BETWEEN_LINES + 1
        observer.part(state(50, elapsed=70.0))
        observer.part(state(100))
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "forward runs …",
        "  50/100 49 ok, 1 failed, 1 min 10 s left",
        "  100/100 99 ok, 1 failed",
        "sampling …",
        "  tempering exponent 1.0000, ESS 1234, accepted 25%",
        "replicates …",
        "  50 of 100, 1 min 10 s left",
        "  100 of 100",
    ]


def test_a_choice_that_takes_long_says_how_far_it_is(capsys: Shown) -> None:
    clock = Clock()
    with observing(clock=clock) as observer:
        for wait in (0.0, SECONDS_BETWEEN_LINES + 1):
            observer.stage("choice")
            clock.now += wait
            observer.step(FIRST)
            observer.step(LAST)
        observer.batch(BatchReport(3, ("E 396 ± 31",), 0.05, "check"))
    assert capsys.readouterr().err.splitlines() == [
        "next batch …",
        "next batch …",
        "  tempering exponent 0.5000, ESS 1000, accepted 30%",
        "  batch 3: E 396 ± 31, moved 0.05 sd; next: check",
    ]


def test_a_log_has_the_time_of_each_line_also_when_quiet(tmp_path: Path, capsys: Shown) -> None:
    log = tmp_path / "run.log"
    log.write_text("before\n")
    with observing(quiet=True, log=log) as observer:
        observer.stage("forward")
        observer.run(RECORD, state(100))
        observer.note("look [here]")
    assert capsys.readouterr() == ("", "")
    first, *lines = log.read_text("utf-8").splitlines()
    assert first == "before"
    found = [re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d (.*)", line) for line in lines]
    told = [one[1] for one in found if one is not None]
    assert told == ["forward runs …", "  100/100 99 ok, 1 failed", "look [here]"]


def test_durations() -> None:
    told = {0.4: "0 s", 59.4: "59 s", 60.0: "1 min 00 s", 3599.9: "1 h 00 min", 7265.0: "2 h 01 min"}
    assert {seconds: progress_text._duration(seconds) for seconds in told} == told


def test_details_of_runs_name_folders_origins_and_reasons(tmp_path: Path) -> None:
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
    one = {"key": "c" * 64, "kind": "flipped", "why": "the points run the other way"}
    assert set_aside_lines({"set_aside": [one]}) == [
        "  run cccccccccccc set aside (flipped): the points run the other way"
    ]
