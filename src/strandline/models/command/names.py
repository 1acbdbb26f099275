"""File names in study.yaml: none may lead out of the study folder, or out of the folder of a run."""

import hashlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from strandline.errors import ForwardModelError, InvalidInput

__all__ = ["SourceFile", "file_in", "relative_name"]


@dataclass(frozen=True)
class SourceFile:
    """A file in the study folder that is copied for each run.

    Args:
        name: Name in the study folder and in the folder of the run.
        path: Path of the file.
        digest: Digest of its contents when the study was loaded.
        stamp: Its size and modification time when the study was loaded.
    """

    name: str
    path: Path
    digest: str
    stamp: tuple[int, int]

    @classmethod
    def of(cls, folder: Path, name: object, place: str) -> "SourceFile":
        """Return the file `name` of the study folder.

        Raises:
            InvalidInput: there is none, or it lies outside the folder.
        """
        path = file_in(folder, name, place)
        return cls(str(name), path, _digest(path), _stamp(path))

    def require_unchanged(self) -> None:
        """Refuse a file that has changed since then: its runs would belong to another model.

        Raises:
            ForwardModelError: ``file_changed``.
        """
        try:
            same = _stamp(self.path) == self.stamp or _digest(self.path) == self.digest
        except OSError as error:
            raise ForwardModelError("file_changed", f"{self.name} cannot be read any more: {error}") from None
        if not same:
            raise ForwardModelError("file_changed", f"{self.name} has changed since the study was loaded")


def relative_name(name: object, place: str) -> str:
    """Return `name` as a relative path that stays inside its folder.

    Raises:
        InvalidInput: an absolute name, one with ``..``, or none at all.
    """
    fits = isinstance(name, str) and name.isprintable() and "\\" not in name and name.strip() == name
    parts = PurePosixPath(name).parts if fits and isinstance(name, str) else ()
    if not parts or parts[0] == "/" or ".." in parts or str(name).endswith("/"):
        raise InvalidInput(
            place,
            value=name,
            expected="the name of a file in the folder or below it: not absolute, without `..`",
            remedy="Put the file there and give its name relative to the folder.",
        )
    return str(PurePosixPath(*parts))


def file_in(folder: Path, name: object, place: str) -> Path:
    """Return the path of a file in the study folder.

    Raises:
        InvalidInput: a name or a link that leads out of the folder, or no such file.
    """
    path = folder / relative_name(name, place)
    if not path.is_file():
        raise InvalidInput(
            f"{place}: no such file", value=str(path), expected="a file in the study folder", remedy="Correct the name."
        )
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InvalidInput(
            f"{place}: a link that leads out of the study folder",
            value=f"{name} -> {path.resolve()}",
            expected="a file of the study folder itself",
            remedy="Copy the file into the folder.",
        )
    return path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _stamp(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_size, found.st_mtime_ns
