"""Anchors kept on disk, so that the next campaign with the same cell and box solves none."""

import contextlib
import hashlib
import os
import platform
import tempfile
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from strandline.models.biofilm.anchors.box import Box
from strandline.models.biofilm.anchors.states import States
from strandline.models.biofilm.linear import linear_solver

__all__ = ["file_of", "load", "save"]

FIELDS = ("coordinates", "strains", "solved", "unknowns")
REVISION = 1
"""Raised whenever other anchors are found for a cell and a box."""
PACKAGES = ("ngsolve", "numpy", "scipy", "mkl")


def file_of(geometry: str, box: Box) -> Path:
    """Return the file in the user's cache for a cell and a box; its name tells all that their bits depend on.

    Args:
        geometry: Text that identifies the cell.
        box: The box.
    """
    parts = [str(REVISION), geometry, repr(box), linear_solver(), platform.machine(), *map(_installed, PACKAGES)]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "strandline" / "anchors"
    return folder / f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"


def save(states: States, path: Path) -> None:
    """Write a file, or none where the disk refuses it; another process never sees half of it."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, **{field: getattr(states, field) for field in FIELDS})
            Path(name).replace(path)
        finally:
            Path(name).unlink(missing_ok=True)


def load(path: Path) -> States | None:
    """Return the states of a file; None if there is none, or a damaged one."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            return States(**{field: content[field] for field in FIELDS})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""
