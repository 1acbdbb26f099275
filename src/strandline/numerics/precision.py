"""Double precision of JAX."""

from strandline.errors import InvalidInput
from strandline.numerics.threads import double

__all__ = ["use_double"]


def use_double() -> None:
    """Switch JAX to double precision for the whole process, unless it already uses it.

    Raises:
        InvalidInput: JAX stays in single precision, for example inside ``with jax.enable_x64(False)``.
    """
    import jax

    if double():
        return
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]
    if not double():
        raise InvalidInput(
            "precision of JAX",
            value="float32",
            expected="float64",
            remedy='Leave `with jax.enable_x64(False)`, or call jax.config.update("jax_enable_x64", True) first.',
        )
