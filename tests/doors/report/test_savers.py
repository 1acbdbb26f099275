"""Figures that other processes save are the same files, and an error stays with its figure."""

from pathlib import Path

import pytest
from tests.unit.report.test_report_figures import captioned

from strandline.report.plots.style import saved
from strandline.report.savers import Savers


def test_processes_save_what_this_one_would(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    own, lambdas, bad = captioned("own"), captioned("lambdas"), captioned("no/folder")
    lambdas.figure.axes[0].xaxis.set_major_formatter(lambda x, position: f"{x:g}")  # cannot be pickled
    with Savers(there, draft=False) as savers:
        first, second, third = (savers.save(one) for one in (own, bad, lambdas))
        assert len(savers._processes) == 2
    expected = saved(captioned("own"), here)
    assert first.result() == expected
    assert third.result()["name"] == "lambdas"
    with pytest.raises(RuntimeError, match="FileNotFoundError"):
        second.result()
    assert {file.name for file in there.iterdir()} == {"own.png", "own.pdf", "lambdas.png", "lambdas.pdf"}
    for kind in ("png", "pdf"):
        assert (there / f"own.{kind}").read_bytes() == (here / f"own.{kind}").read_bytes()


def test_a_process_that_dies_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with Savers(tmp_path, draft=True) as savers:
        savers.save(captioned("first")).result()
        savers._processes[0].kill()
        savers._processes[0].wait()
        with pytest.raises(RuntimeError, match=r"ended too early\. Give it more memory"):
            savers.save(captioned("second")).result()
