"""The option `--device` of the commands that sample: where JAX computes."""

import os

import click

from strandline.errors import InvalidInput

__all__ = ["option", "use"]

option = click.option(
    "--device", type=click.Choice(["cpu", "gpu"]), help="Where to sample; the CPU if JAX_PLATFORMS is not set."
)


def use(device: str | None) -> None:
    """Make JAX compute on `device`; call this before anything imports JAX. None keeps the environment's setting.

    Raises:
        InvalidInput: JAX finds no such device.
    """
    if device is None:
        return
    os.environ["JAX_PLATFORMS"] = "cpu" if device == "cpu" else ""  # empty: the best device available
    import jax

    try:
        found = jax.devices(device)
    except RuntimeError:
        found = []
    if not found or jax.default_backend() != device:
        raise InvalidInput(
            "--device",
            value=device,
            expected=f"a device that JAX has; here it is {jax.default_backend()}",
            remedy='For an NVIDIA GPU: pip install "jax[cuda12]".' if device == "gpu" else "Leave the option out.",
        )
