"""A study folder with a template of one number and a simulator that writes it as a deflection."""

from strandline.models.command.model import CommandModel
from strandline.studies.keys.parse import made
from strandline.testing.studies import write_study

ECHO = "cat input.txt; printf 'x,y\\n0,0\\n1,%s\\n' \"$(cat input.txt)\" > out.csv"
RESULT = {"file": "out.csv", "unit": "mm"}
OPTIONS = {
    "templates": {"in.j2": "input.txt"},
    "command": ["/bin/sh", "run.sh"],
    "files": ["run.sh"],
    "result": RESULT,
}


def filled(folder):
    folder.mkdir(exist_ok=True)
    (folder / "in.j2").write_text("{{ a }}")
    (folder / "run.sh").write_text(ECHO)
    return folder


def model(folder, **changes):
    """Return the model of a folder; None takes an option away."""
    options = {name: value for name, value in (OPTIONS | changes).items() if value is not None}
    return made(CommandModel, options, "model.command", folder=folder)


def study(tmp_path, executor=None, **changes):
    """Return a study folder whose model is the command."""
    inputs = {"a": {"prior": {"uniform": [1, 2]}, "unit": "Pa"}}
    given = {"fixed": {"load": 1.0}, "inputs": inputs, "observation": {"synthetic": {"a": 1.5, "load": 1.0}}}
    given |= {"executor": executor} if executor else {}
    return filled(write_study(tmp_path / "s", model={"command": OPTIONS | changes}, **given))
