"""The example whose simulator is a program of its own finds the truth."""

import shutil
from pathlib import Path

from strandline.runs import LocalProcesses
from strandline.studies import load_study, run_study

EXAMPLE = Path(__file__).parents[3] / "examples" / "command"


def test_the_command_example_finds_the_truth(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE, tmp_path / "command")
    text = (EXAMPLE / "study.yaml").read_text("utf-8")
    (tmp_path / "command" / "study.yaml").write_text(text + "\ndraft: true\nreport: none\n", "utf-8")
    study = load_study(tmp_path / "command")
    found = run_study(study, executor=LocalProcesses(workers=1)).summary["inputs"]["E"]
    assert abs(found["mean"] - 400.0) < 3 * found["sd"] < 100.0
