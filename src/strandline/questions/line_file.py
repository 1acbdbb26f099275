"""A file of results, one a line, each written as soon as it is known, so that a stopped command can go on."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from strandline.errors import InvalidStudy
from strandline.studies.folder import told_if_unwritable

__all__ = ["LineFile"]


@dataclass(frozen=True)
class LineFile:
    """A file with one JSON object in each line.

    Args:
        path: The file; it need not exist.
    """

    path: Path

    def entries(self) -> list[dict[str, Any]]:
        """Return the objects in their order; remove a last line that was not written to its end."""
        if not self.path.is_file():
            return []
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            with self.path.open("r+b") as file:
                file.truncate(len(whole))
        return [_parsed(line) for line in whole.splitlines()]

    def append(self, entry: Mapping[str, Any]) -> None:
        """Add an object."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    @contextmanager
    def held(self, command: str, results: str) -> Iterator[None]:
        """Keep other commands from writing to the file.

        Args:
            command: The command that writes it, e.g. `strandline coverage`, for the message.
            results: What the lines are, a plural noun for the message.

        Raises:
            InvalidStudy: Another command holds the file, or its folder cannot be written to.
        """
        lock = FileLock(self.path.with_suffix(f"{self.path.suffix}.lock"))
        with told_if_unwritable(self.path.parent):
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise InvalidStudy(
                    f"{self.path} is in use",
                    value=f"another `{command}` of this study",
                    expected="one at a time",
                    remedy=f"Wait for the other one to end, or stop it; its {results} are kept.",
                ) from None
        try:
            yield
        finally:
            lock.release()


def _parsed(line: bytes) -> dict[str, Any]:
    """Return the content of a line; empty if it is not one of ours."""
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
