"""The studies that `strandline init` writes."""

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.foundations import InvalidStudy
from strandline.studies.keys.folder import STUDY, is_result, study_name

MEASURED = """\
# The observed interface: a file with a point x, y per line, in the coordinates of the model.
observation: {observation}

# How a simulated interface is compared with it: by the distances of the observed points, weighed by their errors.
discrepancy: {{normal_offset: {{}}}}

# How far the observed points may be off. sd: standard deviation of one point along the normal; length: over which
# neighbouring points err together; unknown: errors that all points share. The guide "Choose the noise" helps.
noise: {noise}
"""


OF_SEVERAL_FILES = (".pvd", ".pvtu", ".pvtp", ".xdmf", ".xmf")  # suffixes of files that refer to others beside them


@dataclass(frozen=True)
class Observed:
    """An observed interface and how far its points may be off.

    The standard deviations of a point, of the whole interface's position and of a common offset along the normals, and
    the correlation length are in µm, the first and the last None to infer them; `rotation` in degrees, `scale` a share.
    """

    file: Path
    unit: str
    sd: float | None
    length: float | None = 0.0
    shift: float = 0.0
    rotation: float = 0.0
    scale: float = 0.0
    offset: float = 0.0

    def section(self, folder: Path) -> str:
        """Return the part of study.yaml about the observation, for a study in `folder`."""
        from strandline.studies.keys.text import flow  # loads yaml, which `init` needs for nothing else

        names = ("shift", "rotation", "scale", "offset")
        shared = {name: getattr(self, name) for name in names if getattr(self, name) > 0}
        noise: dict[str, Any] = {"sd": "unknown" if self.sd is None else self.sd}
        noise |= {} if self.length == 0 else {"length": "unknown" if self.length is None else self.length}
        noise |= {"unit": "um"} | ({"unknown": shared} if shared else {})
        place = Path(os.path.relpath(self.file.resolve(), folder.resolve())).as_posix()
        place = self.file.name if self._is_copied(folder) else place
        observation = f"{{file: {json.dumps(place, ensure_ascii=False)}, unit: {self.unit}}}"
        return MEASURED.format(observation=observation, noise=flow(noise))

    def put_into(self, folder: Path) -> None:
        """Copy the file into the folder of the study, unless it is there or refers to further files."""
        if self._is_copied(folder):
            with (folder / self.file.name).open("xb") as file:
                file.write(self.file.read_bytes())

    def _is_copied(self, folder: Path) -> bool:
        inside = self.file.resolve().is_relative_to(folder.resolve())
        return not inside and self.file.suffix.lower() not in OF_SEVERAL_FILES


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make the folder of a new study, in which the block creates files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except FileExistsError as error:
        is_study = str(error.filename).endswith(STUDY)
        what = "there is a study already" if is_study else "there is such a file already"
        expected = f"a new folder, or one without {STUDY}" if is_study else "a new folder"
        remedy = "Choose another folder."
        raise InvalidStudy(what, value=str(error.filename), expected=expected, remedy=remedy) from None
    except OSError as error:
        what, expected, remedy = "the folder cannot be made", "a place with write permission", "Choose another folder."
        raise InvalidStudy(what, value=f"{folder}: {error.strerror}", expected=expected, remedy=remedy) from None


EXAMPLES = {
    "biofilm": "A biofilm in a flow cell, the built-in simulator.",
    "python": "A Python function: a strip of paper that bends under its weight.",
    "command": "A command with input and result files: a beam that bends far.",
    "calculix": "CalculiX (needs ccx): a gel membrane, inflated.",
    "pendant-drop": "A photograph: the surface tension of a hanging drop.",
    "oct": "Two OCT scans: the stiffness of a biofilm.",
    "creep": "A creep test: stiffness and relaxation time of a biofilm.",
    "stiffness-field": "A map: the stiffness of a biofilm that varies from place to place.",
}
"""Name of each example and what it shows."""
OWN = ("biofilm", "python", "command")  # examples of a simulator whose observed interface may be replaced
FOLDERS = {"python": "strip", "oct": "oct-biofilm"}  # folders of the examples that are not called by their names
PACKAGE = Path(__file__).parents[2]
OF_OBSERVATION = ("observed.csv", "make_observation.py")
OWN_TITLE = """\
# Your observed interface with the simulator of an example, which yours replaces. Run it with:  strandline run {folder}
"""
SUFFIXES = {".yaml", ".py", ".j2", ".csv", ".png"}


def write_example(name: str, folder: Path, observed: Observed | None = None) -> Path:
    """Write one of `EXAMPLES`, or of `OWN` with an observed interface; return the path of its study.yaml."""
    places = (PACKAGE / "examples", PACKAGE.parents[1] / "examples")  # of the installed package, or of a checkout
    sources = [place / FOLDERS.get(name, name) for place in places]
    source = next(one for one in sources if (one / STUDY).is_file())
    paths = [path for path in source.iterdir() if path.suffix in SUFFIXES and not is_result(path)]
    files = {path.name: path.read_bytes() for path in paths}
    text = files.pop(STUDY).decode("utf-8").replace(f"examples/{source.name}", str(folder))
    text = re.sub(r"^name: .*$", f"name: {study_name(folder)}", text, count=1, flags=re.MULTILINE)
    if observed is not None:
        text = _observing(text, observed, folder)
        text = text if name == "biofilm" else re.sub(r"^(#.*\n)+", OWN_TITLE.format(folder=folder), text)
        files = {one: content for one, content in files.items() if one not in OF_OBSERVATION}
    with made_folder(folder):
        for one in (STUDY, *files):
            if (folder / one).exists():
                raise FileExistsError(None, None, str(folder / one))
        if observed is not None:
            observed.put_into(folder)
        for one, content in files.items():
            (folder / one).write_bytes(content)
        (folder / STUDY).write_text(text, encoding="utf-8")
    return folder / STUDY


def _observing(text: str, observed: Observed, folder: Path) -> str:
    text = re.sub(r"^(?:#.*\n)*(?:discrepancy|noise): .*\n\n?", "", text, flags=re.MULTILINE)
    section = observed.section(folder)
    return re.sub(r"^(?:#.*\n)*observation: .*\n\n?", lambda _: f"{section}\n", text, flags=re.MULTILINE)
