"""The examples that `strandline init --example` writes."""

import re
from pathlib import Path

from strandline.studies.folder import STUDY, is_result
from strandline.studies.template import Observed, made_folder, study_name, write_template

__all__ = ["EXAMPLES", "OWN", "write_example"]

EXAMPLES = {
    "biofilm": "A biofilm in a flow cell, the built-in simulator.",
    "python": "A Python function: a strip of paper that bends under its weight.",
    "command": "A command with input and result files: a beam that bends far.",
    "calculix": "CalculiX (needs ccx): a gel membrane, inflated.",
    "pendant-drop": "A photograph: the surface tension of a hanging drop.",
    "oct": "Two OCT scans: the stiffness of a biofilm.",
    "creep": "A creep test: stiffness and relaxation time of a biofilm.",
}
"""Name of each example and what it shows."""
OWN = ("biofilm", "python", "command")
"""Examples of a simulator whose observed interface may be replaced."""
FOLDERS = {"python": "strip", "oct": "oct-biofilm"}
"""Folders of the examples that are not called by their names."""
PACKAGE = Path(__file__).parents[1]
OF_OBSERVATION = ("observed.csv", "make_observation.py")
ACTIVE = "\ndesign: {active: {runs: 60}}\nsurrogate: {field: {}}\n"
SUFFIXES = {".yaml", ".py", ".j2", ".csv", ".png"}


def write_example(name: str, folder: Path, observed: Observed | None = None, *, package: Path = PACKAGE) -> Path:
    """Write the files of an example into `folder`, created if needed; return the path of its study.yaml.

    Args:
        name: One of `EXAMPLES`.
        folder: Folder of the study.
        observed: An observed interface in place of the example's, which must be one of `OWN`.
        package: Folder of the installed package.

    Raises:
        InvalidStudy: There is a study or one of the files already, or the folder cannot be created.
    """
    if name == "biofilm":
        return write_template(folder, observed)
    source = _source(name, package)
    files = {path.name: path.read_bytes() for path in source.iterdir() if _belongs(path)}
    text = files.pop(STUDY).decode("utf-8").replace(f"examples/{source.name}", str(folder))
    text = re.sub(r"^name: .*$", f"name: {study_name(folder)}", text, count=1, flags=re.MULTILINE)
    if observed is not None:
        text = _observing(text, observed, folder)
        files = {one: content for one, content in files.items() if one not in OF_OBSERVATION}
    with made_folder(folder):
        for one in (STUDY, *files):
            if (folder / one).exists():
                raise FileExistsError(None, None, str(folder / one))
        for one, content in files.items():
            (folder / one).write_bytes(content)
        (folder / STUDY).write_text(text, encoding="utf-8")
    return folder / STUDY


def _observing(text: str, observed: Observed, folder: Path) -> str:
    """Return the text of an example with another observed interface, and with a design and surrogate that suit it."""
    text = re.sub(r"^(discrepancy|noise|design|surrogate): .*\n", "", text, flags=re.MULTILINE)
    before, after = re.split(r"^observation: .*\n", text, maxsplit=1, flags=re.MULTILINE)
    return f"{before}{observed.section(folder)}{ACTIVE}{after}"


def _source(name: str, package: Path) -> Path:
    """Return the folder of an example: in the installed package, or in the checkout that the package is used from."""
    folder = FOLDERS.get(name, name)
    places = (package / "examples", package.parents[1] / "examples")
    return next(place / folder for place in places if (place / folder / STUDY).is_file())


def _belongs(path: Path) -> bool:
    """Return whether a file is one of the example, not of its results."""
    return path.suffix in SUFFIXES and not is_result(path.name)
