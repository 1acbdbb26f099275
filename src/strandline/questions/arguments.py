"""Arguments that several questions take, checked."""

from strandline.errors import InvalidInput
from strandline.studies.study import Study

__all__ = ["chosen_measure", "require_seed"]


def chosen_measure(study: Study, name: str | None, of: str) -> str:
    """Return the name of the measure that a question is asked with: by default the study's first.

    Args:
        study: The study.
        name: Name of one of its measures.
        of: What the measure is for, for the message.

    Raises:
        InvalidInput: The study has no such measure.
    """
    if name is not None and name not in study.discrepancies:
        raise InvalidInput(
            f"measure of {of}",
            value=name,
            expected=f"one of the study's: {', '.join(study.discrepancies)}",
            remedy="Name one of them, or add it to study.yaml under discrepancy.",
        )
    return next(iter(study.discrepancies)) if name is None else name


def require_seed(seed: int, of: str) -> None:
    """Refuse a negative seed.

    Args:
        seed: The seed.
        of: What it is for, for the message.

    Raises:
        InvalidInput: It is negative.
    """
    if seed < 0:
        raise InvalidInput(f"seed of {of}", value=seed, expected="0 or above", remedy="Choose another one.")
