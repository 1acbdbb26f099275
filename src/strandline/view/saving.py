"""Other assumptions → a new study beside the present one, which takes over its runs."""

import re
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput
from strandline.interface import GaussianNoise, PointErrors
from strandline.studies.changed_copy import reuse_from, write_copy
from strandline.studies.study import Study
from strandline.studies.yaml_edit import REMOVED, changed_text
from strandline.studies.yaml_text import load_yaml
from strandline.view.assumptions import Asked

__all__ = ["save_as"]

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}")
TO_UM = 1e3


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
    text = changed_text(study.text, _changes(study, name, asked, present, target))
    write_copy(present, target, f"# {name}: {study.name} with other assumptions\n{text}")
    return target


def _changes(study: Study, name: str, asked: Asked, present: Path, target: Path) -> dict[tuple[str, ...], Any]:
    """Return the values that differ in the new study, which takes over the runs of the present one."""
    content = load_yaml(study.text)
    changes: dict[tuple[str, ...], Any] = {("name",): name}
    for key, prior in asked.priors.items():
        changes["inputs", key, "prior"] = dict(prior)
        changes["inputs", key, "box"] = content["inputs"][key].get("box", list(study.space[key].interval))
    for key, value in asked.fixed.items():
        changes["inputs", key] = REMOVED
        changes["fixed", key] = value
    if asked.noise != 1 or asked.length_um is not None:
        changes["noise",] = _noise(study, asked)
    if asked.measure is not None:
        changes["discrepancy",] = _measures(content["discrepancy"], asked.measure)
    changes["reuse",] = reuse_from(present, target, content.get("reuse"))
    return changes


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
