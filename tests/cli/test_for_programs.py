"""Output for programs, logs, suggestions and completion: what a script, a cluster job and a shell get."""

import json
import re
from pathlib import Path

import click
import pytest

import strandline as sl
from strandline.cli import main
from strandline.cli.study_folder import STUDY
from strandline.testing.studies import write_study

QUICK = {"design": {"sobol": {"runs": 24}}, "sampler": {"smc": {"particles": 500, "rejuvenation_steps": 2}}}


def without_figures(*given: object, folder: Path, **others: object) -> Path:
    (folder / "figures").mkdir(exist_ok=True)
    (folder / "report.html").write_text("a report")
    return folder / "report.html"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("strandline.studies.run.write_report", without_figures)
    return write_study(tmp_path / "beam", **QUICK)


def test_run_prints_its_summary_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["run", str(folder), "--json", "--workers", "1", "--quiet"])
    first = capsys.readouterr()
    assert json.loads(first.out) == json.loads((folder / "summary.json").read_text("utf-8"))
    assert first.err == ""
    main(["run", str(folder), "--json"])
    again = json.loads(capsys.readouterr().out)
    assert again["inputs"] == json.loads(first.out)["inputs"]
    assert again["runs"]["new"] == 0


def test_the_log_has_the_time_of_each_step(folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("before\n")
    main(["run", str(folder), "--log", str(log), "--quiet"])
    first, *lines = log.read_text("utf-8").splitlines()
    assert first == "before"
    found = [re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d (.*)", line) for line in lines]
    assert all(found)
    told = [one[1] for one in found if one is not None]
    assert told[:2] == ["observation …", "forward runs …"]
    assert "  24/24 24 ok, 0 failed" in told
    assert "figures and report …" in told


def test_a_log_that_cannot_be_written_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", str(folder), "--log", str(tmp_path / "none" / "run.log")])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--log: got " in line
    assert [path.name for path in folder.iterdir()] == ["study.yaml"]


def test_runs_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    main(["runs", str(folder), "--json", "--state", "ok", "--limit", "3"])
    found = json.loads(capsys.readouterr().out)
    assert len(found) == 3
    with sl.Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        last = list(ledger)[-1]
    assert found[-1]["key"] == last.key
    assert found[-1]["inputs"] == dict(last.inputs)
    assert found[-1]["state"] == "ok"
    for others, words in (
        (["--export", "runs.csv"], "--json prints"),
        (["--show", found[0]["key"]], "--show KEY alone"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["runs", str(folder), "--json", *others])
        assert ended.value.code == 2
        assert words in capsys.readouterr().err


def test_check_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", str(folder), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["run"]["inputs"]["E"] == pytest.approx(430.0)
    assert found["inputs"]["tilt"] == {"unit": "1", "box": [0.0, 0.04], "nuisance": False}
    assert (found["planned"], found["known"]) == (24, 0)
    main(["check", str(folder)])
    shown = capsys.readouterr().out.splitlines()
    plain = [re.sub(r"in [\d.]+ s", "", line) for line in found["lines"]]
    assert [re.sub(r"in [\d.]+ s", "", line.removeprefix("  ")) for line in shown[1 : 1 + len(plain)]] == plain


@pytest.mark.parametrize(("typed", "meant"), [("rum", "run"), ("stauts", "status"), ("what_if", "what-if")])
def test_the_nearest_command_is_suggested(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([typed, "study"])
    assert ended.value.code == 2
    assert f"No such command {typed!r}. Did you mean {meant}? See `strandline --help`." in capsys.readouterr().err


def test_no_command_is_suggested_if_none_is_near(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["xyzzy"])
    assert capsys.readouterr().err == "strandline: No such command 'xyzzy'. See `strandline --help`.\n"


def test_the_shell_completes_folders_with_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("beam", "bubble", "studies/inner"):
        write_study(tmp_path / name)
    (tmp_path / "bare").mkdir()
    monkeypatch.chdir(tmp_path)

    def completed(text: str) -> list[tuple[str, str]]:
        context = click.Context(click.Command("run"))
        return [(one.value, one.type) for one in STUDY.shell_complete(context, click.Argument(["study"]), text)]

    assert completed("b") == [("beam", "plain"), ("bubble", "plain")]
    assert completed("bu") == [("bubble", "plain")]
    assert completed("studies/") == [("studies/inner", "plain")]
    assert completed("ba") == [("ba", "dir")]
    assert completed("nowhere/") == [("nowhere/", "dir")]


def test_warnings_are_coloured_unless_the_user_objects(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from strandline.cli.results import show

    outcome = sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    summary = {**outcome.summary, "warnings": ["look out"]}
    monkeypatch.setattr("click.utils.should_strip_ansi", lambda *given: False)
    show(summary, outcome.report)
    assert "\x1b[33mwarning: look out\x1b[0m" in capsys.readouterr().out
    monkeypatch.setenv("NO_COLOR", "1")
    show(summary, outcome.report)
    assert "\nwarning: look out\n" in capsys.readouterr().out
