"""Particles spread over the devices of JAX: the cores of a CPU, where JAX is set up to see several, or accelerators."""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

__all__ = ["COMPILER_OPTIONS", "spread"]

COMPILER_OPTIONS = {"xla_cpu_prefer_vector_width": 512}
"""XLA's own choice of 256 bits leaves half of an AVX-512 unit idle: a sixth of the sampler's time."""


def spread(positions: Float[Array, "particle dim"]) -> Float[Array, "particle dim"]:
    """Return the same particles in equal parts on as many devices as divide them; jitted functions follow them there.

    A CPU is one device unless `jax_num_cpu_devices` says otherwise before JAX is first used; the command line does.
    """
    devices = jax.devices()
    count = max(n for n in range(1, len(devices) + 1) if len(positions) % n == 0)
    if count == 1:
        return positions
    parts: Any = PartitionSpec("particle")  # type: ignore[no-untyped-call]
    spreading = NamedSharding(Mesh(np.array(devices[:count]), ("particle",)), parts)
    spread_out: Array = jax.device_put(positions, spreading)
    return spread_out
