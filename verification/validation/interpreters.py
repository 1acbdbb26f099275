"""The Pythons of this machine: those on PATH and those that pyenv and uv have installed."""

import os
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["OVERRIDE", "Interpreter", "find_interpreters"]

OVERRIDE = "STRANDLINE_PYTHONS"
"""Environment variable that lists the interpreters to use instead, separated as in PATH."""
OLDEST = (3, 11)
NAME = re.compile(r"python3(\.\d+)?")
VERSION = "import sys, ensurepip, venv; print(sys.implementation.name, *sys.version_info[:4])"


@dataclass(frozen=True, order=True)
class Interpreter:
    """A Python that can make virtual environments, and its version."""

    version: tuple[int, int, int]
    path: Path

    @property
    def name(self) -> str:
        """The version as text, e.g. ``3.13.0``."""
        return ".".join(map(str, self.version))


def find_interpreters(environment: Mapping[str, str], home: Path) -> Sequence[Interpreter]:
    """Return one released CPython of each minor version from 3.11 on, the newest first.

    Args:
        environment: environment variables.
        home: the user's folder.
    """
    if override := environment.get(OVERRIDE):
        candidates = iter([Path(item) for item in override.split(os.pathsep) if item])
    else:
        candidates = _candidates(environment, home)
    found: dict[tuple[int, int], Interpreter] = {}
    for interpreter in sorted(filter(None, map(_asked, dict.fromkeys(candidates))), reverse=True):
        found.setdefault(interpreter.version[:2], interpreter)
    return list(found.values())


def _candidates(environment: Mapping[str, str], home: Path) -> Iterator[Path]:
    pyenv = Path(environment.get("PYENV_ROOT") or home / ".pyenv")
    uv = Path(environment.get("UV_PYTHON_INSTALL_DIR") or home / ".local" / "share" / "uv" / "python")
    folders = [Path(item) for item in environment.get("PATH", "").split(os.pathsep) if item]
    folders += [*pyenv.glob("versions/*/bin"), *uv.glob("*/bin")]
    for folder in folders:
        if folder.is_dir():
            yield from (path for path in sorted(folder.iterdir()) if NAME.fullmatch(path.name))


def _asked(path: Path) -> Interpreter | None:
    """Return the interpreter at a path; None if it does not run or is not suitable."""
    try:
        done = subprocess.run([path, "-c", VERSION], capture_output=True, text=True, timeout=30, check=True)
        kind, *version, level = done.stdout.split()
        major, minor, micro = map(int, version)
    except (OSError, ValueError, subprocess.SubprocessError):
        return None
    good = kind == "cpython" and level == "final" and (major, minor) >= OLDEST
    return Interpreter((major, minor, micro), path) if good else None
