"""Particles spread over the devices of JAX: accelerators, or the cores of a CPU if JAX is set up to see several."""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

__all__ = ["spread"]


def spread(positions: Float[Array, "particle dim"]) -> Float[Array, "particle dim"]:
    """Return the particles in equal parts on as many devices as divide them evenly; jitted functions then run there.

    A CPU is one device unless `jax_num_cpu_devices` is set before JAX is first used; the command line sets it.
    """
    devices = jax.devices()
    count = max(n for n in range(1, len(devices) + 1) if len(positions) % n == 0)
    if count == 1:
        return positions
    parts: Any = PartitionSpec("particle")  # type: ignore[no-untyped-call]
    spreading = NamedSharding(Mesh(np.array(devices[:count]), ("particle",)), parts)
    spread_out: Array = jax.device_put(positions, spreading)
    return spread_out
