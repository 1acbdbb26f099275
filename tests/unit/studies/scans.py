"""A study that observes a sphere in a stack of pictures."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from verification.validation.rendered_stacks import Blob, Microscope

from strandline.studies import Study, load_study
from strandline.testing.studies import write_study

V, RADIUS = 1e-3, 0.014
CENTRE = (0.0202, 0.0195, 0.0198)
ORIGIN = [20.2, 19.5, 19.8]
PLANES = 40
CUBES = Microscope((V, V, V), (PLANES,) * 3, (1.5 * V,) * 3)
VOXEL = {"x": 1, "y": 1, "z": 1, "unit": "um"}


@lru_cache(maxsize=1)
def grey() -> np.ndarray:
    """Return the stack of a sphere in 16 bits."""
    stack = CUBES(Blob(CENTRE, (RADIUS,) * 3), np.random.default_rng(1)).values
    return np.clip(np.round(1000 + 1000 * stack), 0, 65535).astype(np.uint16)


def written(folder: Path, *, noise: Any = None, study: dict[str, Any] | None = None, **changes: Any) -> Path:
    """Write a study whose observation is the stack; None removes a key of it."""
    folder.mkdir(exist_ok=True)
    np.save(folder / "cells.npy", grey())
    frame = {"frame": {"origin": ORIGIN}, "voxel": VOXEL}
    stack: dict[str, Any] = {"file": "cells.npy", **frame, "solid": "bright", "triangles": 800, **changes}
    stack = {key: value for key, value in stack.items() if value is not None}
    stated = noise or {"sd": "image", "unit": "um"}
    base = {"discrepancy": {"closest_point": {}}, "noise": stated, **(study or {})}
    return write_study(folder, observation={"stack": stack}, **base)


def loaded(folder: Path, **changes: Any) -> Study:
    return load_study(written(folder, **changes))
