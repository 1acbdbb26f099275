"""What all commands share: signals, completion of folders, colours."""

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from tests.unit.cli.command_line import Shown, ends

from strandline.cli import main, results, signals
from strandline.cli.study_folder import STUDY
from strandline.errors import InvalidInput, NumericsError
from strandline.testing.studies import write_study


@pytest.fixture
def handlers() -> Iterator[None]:
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    for number in numbers:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_the_first_signal_counts(handlers: None) -> None:
    signals.end_as_ctrl_c()
    with pytest.raises(KeyboardInterrupt) as caught:
        signal.raise_signal(signal.SIGHUP)
    assert isinstance(caught.value, signals.Ended)
    assert caught.value.number == signal.SIGHUP
    signal.raise_signal(signal.SIGTERM)  # while everything is put in order


def test_nohup_is_heeded(handlers: None) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals.end_as_ctrl_c()
    signal.raise_signal(signal.SIGHUP)
    with pytest.raises(signals.Ended):
        signal.raise_signal(signal.SIGTERM)


def test_how_a_command_ends(handlers: None, capsys: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = NumericsError("the sum is nan")
    interrupted = "; what is finished is kept; run the same command again to go on"
    endings: list[tuple[BaseException, int, str]] = [
        (failed, 1, str(failed)),
        (KeyboardInterrupt(), 130, f"interrupted{interrupted}"),
        (click.Abort(), 130, f"interrupted{interrupted}"),
        (InvalidInput("x", value=1, expected="2", remedy="Go."), 2, "x: got 1; expected 2. Go."),
        (signals.Ended(signal.SIGTERM), 143, f"interrupted by SIGTERM{interrupted}"),
    ]
    for error, code, told in endings:

        @click.command("doctor")
        def command(error: BaseException = error) -> None:
            raise error

        monkeypatch.setattr("strandline.cli.doctor.command", command)
        with pytest.raises(SystemExit) as ended:
            main(["doctor"])
        assert ended.value.code == code
        assert capsys.readouterr().err == f"strandline: {told}\n"


def test_no_command_is_a_question_for_help(capsys: Shown) -> None:
    assert ends() == 2
    assert capsys.readouterr().err.startswith("Usage: strandline")


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


def test_warnings_are_coloured_unless_the_user_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    warned: Any = results._warned
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert warned("warning: look out") == "\x1b[33mwarning: look out\x1b[0m"
    monkeypatch.setenv("NO_COLOR", "1")
    assert warned("warning: look out") == "warning: look out"
