"""A finished study is not computed again unless something that its results depend on has changed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.studies.conftest import Finished

from strandline.cli import main
from strandline.runs import InProcess
from strandline.studies import load_study, run_study
from strandline.studies.unchanged import results_at_hand
from strandline.testing.studies import beam, write_study

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
Change = Callable[[Path], object]


@pytest.fixture
def folder(finished: Finished, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished.folder, tmp_path / "beam"))


def stamps(folder: Path) -> dict[str, int]:
    return {
        str(path): path.stat().st_mtime_ns for path in folder.rglob("*") if path.suffix in (".html", ".nc", ".json")
    }


def test_a_finished_study_is_not_computed_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = stamps(folder)
    main(["run", str(folder)])
    assert stamps(folder) == before
    said = capsys.readouterr().out
    assert "64 forward runs ok, 0 failed (0 new, 64 reused)" in said
    assert said.splitlines()[-1] == f"Nothing has changed since. To write the results again: strandline report {folder}"
    main(["run", "--quiet", str(folder)])
    assert "Nothing has changed" not in capsys.readouterr().out


def test_the_report_is_always_written_again(folder: Path) -> None:
    before = stamps(folder)
    main(["report", "--quiet", str(folder)])
    assert all(stamps(folder)[name] > before[name] for name in before)


def reworded(key: str, value: object) -> Change:
    """Return a change of one entry of summary.json."""

    def change(folder: Path) -> None:
        path = folder / "summary.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))

    return change


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "posterior.nc").unlink(),
        lambda folder: (folder / "report.html").unlink(),
        lambda folder: shutil.rmtree(folder / "figures"),
        lambda folder: (folder / "summary.json").unlink(),
        lambda folder: (folder / "summary.json").write_text("[]"),
        lambda folder: (folder / "summary.json").write_text("{"),
        lambda folder: (folder / "ledger.sqlite").unlink(),
        lambda folder: write_study(folder, seed=2),
        lambda folder: write_study(folder, design={"sobol": {"runs": 65}}),
        lambda folder: main(["runs", str(folder), "--exclude", load_study(folder).runs.design_keys[0], "--why", "odd"]),
        reworded("version", "0.0.1"),
        reworded("versions", {"numpy": "1.0"}),
        reworded("model", "another"),
        reworded("missing", {"figures": "no room"}),
    ],
    ids=[
        *("posterior", "report", "figures", "summary", "list", "half", "ledger", "seed", "runs", "excluded"),
        *("version", "versions", "model", "missing"),
    ],
)
def test_what_has_changed_is_noticed(folder: Path, change: Change) -> None:
    assert results_at_hand(load_study(folder)) is not None
    change(folder)
    assert results_at_hand(load_study(folder)) is None


def test_another_observation_is_noticed(tmp_path: Path) -> None:
    points = beam(TRUTH, tmp_path).interface.points
    np.savetxt(tmp_path / "seen.csv", points, delimiter=",", header="x,y", comments="")
    folder = write_study(
        tmp_path / "beam", observation={"file": "../seen.csv", "unit": "mm"}, design={"sobol": {"runs": 20}}
    )
    run_study(load_study(folder), executor=InProcess())
    assert results_at_hand(load_study(folder)) is not None
    points[5, 1] += 1e-6
    np.savetxt(tmp_path / "seen.csv", points, delimiter=",", header="x,y", comments="", fmt="%.12g")
    assert results_at_hand(load_study(folder)) is None
