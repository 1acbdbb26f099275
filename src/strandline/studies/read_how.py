"""How the pictures and stacks of a study were read: sizes, scales, axes, and where each of them came from."""

from collections.abc import Iterator
from typing import Any

from strandline.studies.pictures.frame_note import UNDEFORMED
from strandline.studies.study import Study

__all__ = ["read_how", "read_lines"]


def read_how(study: Study) -> list[dict[str, Any]]:
    """Return condition, file, checksum and notes of each picture and stack, the one of the outline first."""
    first = {} if study.undeformed is None else {UNDEFORMED: study.undeformed.picture}
    found = [(name, one.name, one.picture.sha256, one.notes) for name, one in {**first, **study.pictures}.items()]
    found += [(name, one.name, one.stack.sha256, one.notes) for name, one in study.stacks.items()]
    keys = ("condition", "file", "sha256", "notes")
    return [{**dict(zip(keys, one, strict=True)), "notes": list(one[3])} for one in found]


def read_lines(study: Study) -> Iterator[str]:
    """Yield a line on each picture and stack."""
    for one in read_how(study):
        of = f"{one['condition']}: " if one["condition"] else ""
        yield f"{of}{one['file']}: {'; '.join(one['notes'])}; sha256 {one['sha256'][:12]}…"
