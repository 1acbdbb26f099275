"""Run folders that are kept in the study on request."""

import contextlib
import shutil
from pathlib import Path

from strandline.errors import InvalidInput

__all__ = ["KEPT", "RUNS", "kept_folder", "require_keep"]

KEPT = ("all", "failed", "none")
RUNS = "runs"


def require_keep(keep: object) -> None:
    """Refuse any word except all, failed and none.

    Raises:
        InvalidInput: It is another word; the message shows it.
    """
    if keep not in KEPT:
        raise InvalidInput("keep", value=keep, expected=f"one of {', '.join(KEPT)}", remedy="Choose one of them.")


def kept_folder(workdir: Path, study: Path, key: str) -> Path:
    """Move the contents of a run's folder into a new folder runs/KEY-ATTEMPT of the study, and return its path."""
    parent = study / RUNS
    parent.mkdir(exist_ok=True)
    attempt = 1
    while True:
        target = parent / f"{key[:12] or 'trial'}-{attempt}"
        try:
            target.mkdir()
        except FileExistsError:
            attempt += 1
            continue
        for item in workdir.iterdir():
            with contextlib.suppress(shutil.SpecialFileError):  # a pipe or a socket, useless without its process
                shutil.move(item, target / item.name)
        return target
