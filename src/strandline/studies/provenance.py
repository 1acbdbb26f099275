"""Results belong to the text of study.yaml that stands beside them."""

from collections.abc import Iterator
from dataclasses import replace

from strandline.errors import InvalidStudy
from strandline.runs import FailurePolicy
from strandline.studies.study import Study

__all__ = ["replaced", "require_its_own_text"]

FREE = frozenset({"folder", "text", "settings", "executor", "reuse", "as_loaded"})
"""Fields that change no result, and those that are looked at by themselves."""


def replaced(study: Study) -> Iterator[str]:
    """Yield the names of the fields that say something else than the study.yaml that `study` was loaded from."""
    loaded = study.as_loaded
    if loaded is None:
        return
    for name in vars(loaded):
        if name not in FREE and not _same(getattr(study, name), getattr(loaded, name)):
            yield name
    now, then = (replace(one.settings, failures=FailurePolicy()) for one in (study, loaded))
    yield from (f"settings.{name}" for name in vars(then) if not _same(getattr(now, name), getattr(then, name)))


def require_its_own_text(study: Study) -> None:
    """Refuse a study that was changed after it was loaded: its results would stand under a text that says otherwise.

    Where forward runs are made, what is done about failed ones and which ledgers are reused may be changed.

    Raises:
        InvalidStudy: With the fields that were changed.
    """
    changed = list(replaced(study))
    if changed and study.as_loaded is not None and study.text == study.as_loaded.text:
        raise InvalidStudy(
            "the study was changed after it was loaded",
            value=", ".join(changed),
            expected="the values of its study.yaml, under which the results would stand",
            remedy="Write the change into a study.yaml, in a folder of its own if both are wanted, and load that.",
        )


def _same(one: object, other: object) -> bool:
    """Return whether two values are the same object or equal; False where they cannot be compared."""
    if one is other:
        return True
    try:
        return bool(one == other)
    except (TypeError, ValueError):
        return False
