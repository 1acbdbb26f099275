"""Other assumptions → a new study beside the present one, which takes over its runs."""

import re
import shutil
from pathlib import Path
from typing import Any

import yaml

from strandline.errors import InvalidInput, InvalidStudy
from strandline.interface import GaussianNoise, PointErrors
from strandline.studies import folder as files
from strandline.studies.folder import STUDY, told_if_unwritable
from strandline.studies.study import Study, load_study
from strandline.studies.yaml_text import load_yaml
from strandline.view.assumptions import Asked

__all__ = ["save_as"]

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}")
TO_UM = 1e3
RESULTS = {value for name, value in vars(files).items() if name.isupper() and isinstance(value, str)} - {STUDY}
"""Names of result files, which are not copied."""
LEFT_OUT = ("figures", "runs", "slurm", "comparison", "__pycache__")
"""Folders of results."""
SUFFIXES = (".lock", "-wal", "-shm", ".html", ".log", ".sqlite")


def save_as(study: Study, name: str, asked: Asked) -> Path:
    """Write a study with other assumptions in a folder beside the present one; return the folder.

    The files that the study needs are copied, its results are not; `reuse` takes over its runs.

    Args:
        study: The study.
        name: Name of the new study and its folder.
        asked: The assumptions.

    Raises:
        InvalidInput: The name cannot be used, there is such a folder, or the assumptions cannot be written.
        InvalidStudy: The folder cannot be written to.
    """
    if not NAME.fullmatch(name):
        raise InvalidInput(
            "name of the new study",
            value=name,
            expected="letters, digits, -, _ and . (at most 63)",
            remedy="Choose another one.",
        )
    present = study.folder.resolve()
    target = present.parent / name
    if target.exists():
        raise InvalidInput(
            "name of the new study", value=name, expected="no such folder yet", remedy="Choose another one."
        )
    content = _changed(study, name, asked, present)
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
    with told_if_unwritable(present.parent):
        try:
            shutil.copytree(present, target, ignore=_ignored)
            (target / STUDY).write_text(f"# {name}: {study.name} with other assumptions\n{text}", encoding="utf-8")
            load_study(target)
        except (InvalidStudy, InvalidInput, OSError):
            shutil.rmtree(target, ignore_errors=True)
            raise
    return target


def _ignored(folder: str, names: list[str]) -> set[str]:
    """Return the names of results in a folder."""
    return {name for name in names if name in RESULTS or name in LEFT_OUT or name.endswith(SUFFIXES)}


def _changed(study: Study, name: str, asked: Asked, present: Path) -> dict[str, Any]:
    """Return the content of study.yaml with the assumptions, and with the runs of the present study."""
    content: dict[str, Any] = dict(load_yaml(study.text))
    content["name"] = name
    inputs = {key: dict(value) for key, value in content["inputs"].items()}
    for key, prior in asked.priors.items():
        box = list(study.space[key].interval)
        inputs[key] = {**inputs[key], "prior": dict(prior), "box": inputs[key].get("box", box)}
    fixed = dict(content.get("fixed") or {})
    for key, value in asked.fixed.items():
        inputs.pop(key)
        fixed[key] = value
    content["inputs"] = inputs
    if fixed:
        content["fixed"] = fixed
    if asked.noise != 1 or asked.length_um is not None:
        content["noise"] = _noise(study, asked)
    if asked.measure is not None:
        content["discrepancy"] = _measures(content["discrepancy"], asked.measure)
    others = [str(Path("..") / present.name), *(content.get("reuse") or [])]
    content["reuse"] = list(dict.fromkeys(others))
    return content


def _noise(study: Study, asked: Asked) -> dict[str, Any]:
    """Return the key `noise` with another standard deviation.

    Raises:
        InvalidInput: The points or the conditions have noise of their own.
    """
    noise = study.noise
    if not study.noises and isinstance(noise, GaussianNoise):
        return {"variance": float(f"{asked.noise**2 * noise.variance:.6g}")}
    given = load_yaml(study.text)["noise"]
    if not study.noises and isinstance(noise, PointErrors) and isinstance(given.get("sd"), int | float | str):
        sd = float(f"{asked.noise * TO_UM * noise.sd:.6g}")
        length = TO_UM * noise.length if asked.length_um is None else asked.length_um
        kept = {key: value for key, value in given.items() if key not in ("sd", "length", "unit")}
        if not kept:
            return {"sd": sd, "unit": "um", **({"length": float(f"{length:.6g}")} if length else {})}
    raise InvalidInput(
        "noise of the new study",
        value="other noise for a study whose points or conditions have their own",
        expected="a study with one standard deviation",
        remedy="Change noise in study.yaml by hand.",
    )


def _measures(given: Any, first: str) -> list[Any]:
    """Return the measures with this one first."""
    stated = given if isinstance(given, list) else [given]
    each = [{name: options} for one in stated for name, options in one.items()]
    return sorted(each, key=lambda one: first not in one)
