"""Settings shared by functions compiled by JAX: few array lengths, the widest registers."""

__all__ = ["WIDEST", "ample"]

WIDEST = {"xla_cpu_prefer_vector_width": 512}
"""Option of `jax.jit`: 512-bit registers if the processor has them; the compiler's default is 256 bits."""


def ample(length: int) -> int:
    """Return an array length for a compiled function: few different lengths, so that it is rarely recompiled.

    It exceeds `length` by at most a quarter.
    """
    step = 1 << max(length.bit_length() - 3, 0)
    return -(-max(length, 1) // step) * step
