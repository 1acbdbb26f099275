"""The error of a file that yields no interface."""

from typing import Any

from strandline.errors import InvalidInput

__all__ = ["Unreadable", "refused"]


class Unreadable(InvalidInput):
    """A file yields no interface.

    Args:
        what: What is wrong, with the name of the file.
        kind: ``result_missing`` | ``result_unreadable`` | ``non_finite`` | ``invalid_interface``.
        value: Value that was found.
        expected: What would have been correct.
        remedy: What to do next.
    """

    def __init__(
        self, what: str, *, value: object, expected: str, remedy: str, kind: str = "result_unreadable"
    ) -> None:
        self.kind = kind
        super().__init__(what, value=value, expected=expected, remedy=remedy)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.what, self.value, self.expected, self.remedy, self.kind)


def refused(
    what: str,
    value: object,
    expected: str,
    remedy: str = "Correct the name of the file in study.yaml, or the file.",
    *,
    kind: str = "result_unreadable",
) -> Unreadable:
    """Return the error for a file that cannot be used."""
    return Unreadable(what, value=value, expected=expected, remedy=remedy, kind=kind)


def _rebuilt(what: str, value: object, expected: str, remedy: str, kind: str) -> Unreadable:
    return Unreadable(what, value=value, expected=expected, remedy=remedy, kind=kind)
