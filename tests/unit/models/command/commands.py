"""A study folder with a template of one number and a simulator that writes it as a deflection."""

from pathlib import Path
from typing import Any

from strandline.models.command.model import CommandModel
from strandline.testing.studies import write_study

ECHO = "cat input.txt; printf 'x,y\\n0,0\\n1,%s\\n' \"$(cat input.txt)\" > out.csv"
OPTIONS: dict[str, Any] = {
    "templates": {"in.j2": "input.txt"},
    "command": ["/bin/sh", "run.sh"],
    "files": ["run.sh"],
    "result": {"file": "out.csv", "unit": "mm"},
}


def filled(folder: Path) -> Path:
    """Write template and simulator."""
    folder.mkdir(exist_ok=True)
    (folder / "in.j2").write_text("{{ a }}")
    (folder / "run.sh").write_text(ECHO)
    return folder


def model(folder: Path, **changes: Any) -> CommandModel:
    """Return the model of a folder; None takes an option away."""
    options = {name: value for name, value in (OPTIONS | changes).items() if value is not None}
    return CommandModel.from_options(folder=folder, **options)


def study(tmp_path: Path, **changes: Any) -> Path:
    """Return a study folder whose model is the command."""
    return filled(
        write_study(
            tmp_path / "s",
            model={"command": OPTIONS | changes},
            fixed={"load": 1.0},
            inputs={"a": {"prior": {"uniform": [1, 2]}, "unit": "Pa"}},
            observation={"synthetic": {"a": 1.5, "load": 1.0}},
        )
    )
