"""Anchors kept on disk, so that the next campaign with the same cell and box solves none."""

import contextlib
import hashlib
import os
import platform
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
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
                arrays = {field: getattr(states, field) for field in FIELDS}
                np.savez(file, **arrays, digest=np.array(_digest(path, arrays)))
            Path(name).replace(path)
        finally:
            Path(name).unlink(missing_ok=True)


def load(path: Path) -> States | None:
    """Return the states of a file; None if there is none, a damaged one, or one written under another name."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            arrays = {field: content[field] for field in FIELDS}
            return States(**arrays) if str(content["digest"]) == _digest(path, arrays) else None
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        return None


def _digest(path: Path, arrays: Mapping[str, np.ndarray]) -> str:
    """Return a digest of a file's name and of what it holds."""
    found = hashlib.sha256(path.stem.encode())
    for field in FIELDS:
        found.update(f"{field}{arrays[field].shape}{arrays[field].dtype}".encode() + arrays[field].tobytes())
    return found.hexdigest()


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""
