"""Studies that cannot be loaded: rows of changes to a sound study.yaml, each with words of its refusal."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput
from strandline.studies import load_study
from strandline.testing.studies import write_study

Row = tuple[Any, ...]


def message_of(folder: Path) -> str:
    """Return the one line with which the study is refused; empty if it is not."""
    before, message = sorted(folder.iterdir()), ""
    try:
        load_study(folder)
    except InvalidInput as error:
        message = str(error)
    assert sorted(folder.iterdir()) == before
    assert "\n" not in message
    return message


def not_refused(folder: Path, rows: Iterable[Row], **base: Any) -> list[str]:
    """Return the rows whose study is not refused with all of their words."""
    messages = [(row, message_of(write_study(folder, **{**base, **row[0]}))) for row in rows]
    return [f"{row}\n  {message}" for row, message in messages if not message or any(w not in message for w in row[1:])]
