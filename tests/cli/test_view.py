"""`strandline view`: from the command to the page, and back."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

import strandline as sl
from strandline.cli import main
from strandline.testing.studies import write_study
from strandline.view import Shown


def test_it_prints_its_address_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    folder = write_study(tmp_path / "beam")
    command = [sys.executable, "-m", "strandline", "view", str(folder), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.fullmatch(rf"{re.escape(str(folder))}: (http://127\.0\.0\.1:(\d+)/[\w-]+/)\n", line)
        assert found is not None
        assert f"ssh -L {found[2]}:localhost:{found[2]} THIS_MACHINE" in process.stdout.readline()
        assert httpx.get(found[1]).status_code == 200
        assert httpx.get(f"{found[1]}api/study").json()["name"] == "beam"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
        assert process.stderr is not None
        assert process.stderr.read() == "stopped\n"
    assert sorted(path.name for path in folder.iterdir()) == ["study.yaml"]


@pytest.mark.parametrize(
    ("words", "message"),
    [(["nowhere"], "nowhere"), (["beam", "--port", "70000"], "--port"), (["beam", "--port", "BUSY"], "port: got ")],
)
def test_what_is_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    study = sl.load_study(write_study(tmp_path / "beam"))
    monkeypatch.chdir(tmp_path)
    shown: Shown = study.view()
    try:
        with pytest.raises(SystemExit) as ended:
            main(["view", "--no-browser", *[str(shown.server.port) if word == "BUSY" else word for word in words]])
    finally:
        shown.close()
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_a_notebook_shows_the_page(tmp_path: Path) -> None:
    shown: Shown = sl.load_study(write_study(tmp_path / "beam")).view(height=500)
    try:
        found = re.search(r'<iframe src="([^"]+)" title="beam" width="100%" height="500"', shown._repr_html_())
        assert found is not None
        assert httpx.get(found[1]).status_code == 200
        assert found[1] in repr(shown)
    finally:
        shown.close()
