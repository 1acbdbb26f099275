"""Seeds that a user gives."""

from strandline.errors import InvalidInput

__all__ = ["require_seed"]


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
