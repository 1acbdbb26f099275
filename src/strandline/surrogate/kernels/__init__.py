"""Correlation functions of the Gaussian processes: one file each, and a line in `KERNELS`."""

from strandline.errors import InvalidInput
from strandline.surrogate.kernels.matern32 import MATERN32
from strandline.surrogate.kernels.matern32_ard import MATERN32_ARD
from strandline.surrogate.kernels.matern32_product import MATERN32_PRODUCT
from strandline.surrogate.kernels.matern52 import MATERN52
from strandline.surrogate.kernels.matern52_ard import MATERN52_ARD
from strandline.surrogate.kernels.matern52_product import MATERN52_PRODUCT
from strandline.surrogate.kernels.protocol import Kernel, LengthScale, as_length_scale, as_lengths
from strandline.surrogate.kernels.squared_exponential import SQUARED_EXPONENTIAL
from strandline.surrogate.kernels.squared_exponential_ard import SQUARED_EXPONENTIAL_ARD

__all__ = ["KERNELS", "Kernel", "LengthScale", "as_length_scale", "as_lengths", "kernel_named"]

KERNELS: dict[str, Kernel] = {
    "matern32": MATERN32,
    "matern32_ard": MATERN32_ARD,
    "matern32_product": MATERN32_PRODUCT,
    "matern52": MATERN52,
    "matern52_ard": MATERN52_ARD,
    "matern52_product": MATERN52_PRODUCT,
    "squared_exponential": SQUARED_EXPONENTIAL,
    "squared_exponential_ard": SQUARED_EXPONENTIAL_ARD,
}


def kernel_named(name: str) -> Kernel:
    """Return the kernel of that name.

    Raises:
        InvalidInput: no such kernel.
    """
    if name not in KERNELS:
        raise InvalidInput(
            "name of the kernel",
            value=name,
            expected=f"one of {', '.join(KERNELS)}",
            remedy="Choose one of these or add a line to strandline.surrogate.kernels.KERNELS.",
        )
    return KERNELS[name]
