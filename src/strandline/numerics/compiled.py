"""What functions compiled by JAX share: few lengths of arrays, the widest registers."""

__all__ = ["WIDEST", "ample"]

WIDEST = {"xla_cpu_prefer_vector_width": 512}
"""Option of `jax.jit`: registers of 512 bits where the processor has them; the compiler's own choice are 256."""


def ample(length: int) -> int:
    """Return the length of an array to be handed to a compiled function: few different ones, to compile it rarely.

    A quarter longer than `length` at most.
    """
    step = 1 << max(length.bit_length() - 3, 0)
    return -(-max(length, 1) // step) * step
