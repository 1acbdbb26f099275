"""The studies that `strandline init` writes."""

import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.errors import InvalidStudy
from strandline.studies.folder import STUDY, is_result

TEMPLATE = """\
# A strandline study. Run it with:  strandline run {folder}
version: 1
name: {name}

# The simulator: a biofilm in a flow cell (built in). Meshes: coarse | default | fine.
# Laws of the solid: neo_hookean | saint_venant_kirchhoff (as published) | mooney_rivlin | yeoh | fung.
model: {{biofilm: {{mesh: coarse, material: neo_hookean}}}}

# What is known of the experiment.
fixed: {{V_in: 100}}                # inflow volume rate per depth, mm^2/s

# Unknown: priors. uniform, loguniform [low, high] | normal [mean, sd] | lognormal [mu, sigma] | beta [a, b, low, high].
# A prior without bounds needs a design box, e.g.  E: {{prior: {{lognormal: [5.86, 0.4]}}, box: [100, 800], unit: Pa}}
inputs:
  E:  {{prior: {{uniform: [100, 800]}}, unit: Pa}}       # Young's modulus
  nu: {{prior: {{uniform: [-0.8, 0.5]}}}}               # Poisson's ratio

{observation}
# Which forward runs: one batch after the other where the posterior lies, at most so many; it stops when it is sure.
# What is learnt from them: the interface itself, as a field over the inputs.
# The published way:  design: {{sobol: {{runs: 300}}}}  with  surrogate: {{log_likelihood: {{kernel: matern32}}}}
design: {{active: {{runs: 80}}}}
surrogate: {{field: {{}}}}
sampler: {{smc: {{particles: 2000, rejuvenation_steps: 15, zeta: 0.5}}}}
executor: {{local: {{timeout: 300}}}}   # seconds; one worker process per core
seed: 1
"""

SYNTHETIC = """\
# The observed interface, here one that the model makes. With your own, in a file with a point x, y per line, write
# `strandline init FOLDER --observed FILE` instead: it asks how far its points may be off.
observation: {synthetic: {E: 400, nu: 0.3, V_in: 100}}

# How a simulated interface is compared with the observed one:
# currents (RKHS norm; quadrature: refined | centre) | closest_point | measurement_lines | tracked_points
# normal_offset (best for a measured interface: it weighs the points by their errors)
discrepancy: {currents: {width: 0.005, quadrature: refined}}

# Variance of the noise, in the unit of the squared discrepancy (mm^2), or its standard deviation (sd: ...).
# With a unit, sd is that of an observed point:  noise: {sd: 3, unit: um}   (`strandline noise` estimates it)
noise: {variance: 0.0005}
"""
MEASURED = """\
# The observed interface: a file with a point x, y per line, in the coordinates of the model.
observation: {observation}

# How a simulated interface is compared with it: by the distances of the observed points, weighed by their errors.
discrepancy: {{normal_offset: {{}}}}

# How far the observed points may be off. sd: standard deviation of one point along the normal; length: over which
# neighbouring points err together; unknown: errors that all points share. The guide "Choose the noise" helps.
noise: {noise}
"""


OF_SEVERAL_FILES = (".pvd", ".pvtu", ".pvtp", ".xdmf", ".xmf")
"""Suffixes of files that refer to others beside them."""


@dataclass(frozen=True)
class Observed:
    """An observed interface and how far its points may be off.

    Args:
        file: File with the points.
        unit: Unit of its coordinates.
        sd: Standard deviation of a point, µm; None to infer it.
        length: Correlation length along the interface, µm; None to infer it.
        shift: Standard deviation of the position of the whole interface, µm.
        rotation: Standard deviation of its rotation, degrees.
        scale: Standard deviation of its scale, as a share.
        offset: Standard deviation of a common offset along the normals, µm.
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
        names = ("shift", "rotation", "scale", "offset")
        shared = {name: getattr(self, name) for name in names if getattr(self, name) > 0}
        noise: dict[str, Any] = {"sd": "unknown" if self.sd is None else self.sd}
        noise |= {} if self.length == 0 else {"length": "unknown" if self.length is None else self.length}
        noise |= {"unit": "um"} | ({"unknown": shared} if shared else {})
        place = Path(os.path.relpath(self.file.resolve(), folder.resolve())).as_posix()
        place = self.file.name if self._is_copied(folder) else place
        observation = f"{{file: {json.dumps(place, ensure_ascii=False)}, unit: {self.unit}}}"
        return MEASURED.format(observation=observation, noise=_flow(noise))

    def put_into(self, folder: Path) -> None:
        """Copy the file into the folder of the study, unless it is there or refers to further files."""
        if self._is_copied(folder):
            with (folder / self.file.name).open("xb") as file:
                file.write(self.file.read_bytes())

    def _is_copied(self, folder: Path) -> bool:
        inside = self.file.resolve().is_relative_to(folder.resolve())
        return not inside and self.file.suffix.lower() not in OF_SEVERAL_FILES


def _flow(content: dict[str, Any]) -> str:
    """Return a mapping on one line of YAML."""
    parts = [f"{key}: {_flow(one) if isinstance(one, dict) else one}" for key, one in content.items()]
    return "{" + ", ".join(parts) + "}"


def write_template(folder: Path, observed: Observed | None = None) -> Path:
    """Write a commented study.yaml into `folder`, created if needed, and return its path."""
    path = folder / STUDY
    about = SYNTHETIC if observed is None else observed.section(folder)
    with made_folder(folder):
        if path.exists():
            raise FileExistsError(None, None, str(path))
        if observed is not None:
            observed.put_into(folder)
        path.write_text(TEMPLATE.format(name=study_name(folder), folder=folder, observation=about), encoding="utf-8")
    return path


def study_name(folder: Path) -> str:
    """Return the name of a new study in `folder`."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", folder.resolve().name).strip("-._") or "study"


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make the folder of a new study, in which the block creates files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except FileExistsError as error:
        is_study = str(error.filename).endswith(STUDY)
        raise InvalidStudy(
            "there is a study already" if is_study else "there is such a file already",
            value=str(error.filename),
            expected=f"a new folder, or one without {STUDY}" if is_study else "a new folder",
            remedy="Choose another folder.",
        ) from None
    except OSError as error:
        raise InvalidStudy(
            "the folder cannot be made",
            value=f"{folder}: {error.strerror}",
            expected="a place with write permission",
            remedy="Choose another folder.",
        ) from None


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
OWN_TITLE = """\
# Your observed interface with the simulator of an example, which yours replaces. Run it with:  strandline run {folder}
"""
ACTIVE = "\ndesign: {active: {runs: 60}}\nsurrogate: {field: {}}\n"
SUFFIXES = {".yaml", ".py", ".j2", ".csv", ".png"}


def write_example(name: str, folder: Path, observed: Observed | None = None, *, package: Path = PACKAGE) -> Path:
    """Write the files of an example into `folder`, created if needed; return the path of its study.yaml.

    Args:
        name: One of `EXAMPLES`.
        folder: Folder of the study.
        observed: An observed interface in place of the example's, which must be one of `OWN`.
        package: Folder of the installed package.
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
        if observed is not None:
            observed.put_into(folder)
        for one, content in files.items():
            (folder / one).write_bytes(content)
        (folder / STUDY).write_text(text, encoding="utf-8")
    return folder / STUDY


def _observing(text: str, observed: Observed, folder: Path) -> str:
    """Return the text of an example with another observed interface, and with a design and surrogate that suit it."""
    text = re.sub(r"^(discrepancy|noise|design|surrogate): .*\n", "", text, flags=re.MULTILINE)
    before, after = re.split(r"^observation: .*\n", text, maxsplit=1, flags=re.MULTILINE)
    before = re.sub(r"^(#.*\n)+", OWN_TITLE.format(folder=folder), before)
    return f"{before}{observed.section(folder)}{ACTIVE}{after}"


def _source(name: str, package: Path) -> Path:
    """Return the folder of an example: in the installed package, or in the checkout that the package is used from."""
    folder = FOLDERS.get(name, name)
    places = (package / "examples", package.parents[1] / "examples")
    return next(place / folder for place in places if (place / folder / STUDY).is_file())


def _belongs(path: Path) -> bool:
    """Return whether a file is one of the example, not of its results."""
    return path.suffix in SUFFIXES and not is_result(path.name)
