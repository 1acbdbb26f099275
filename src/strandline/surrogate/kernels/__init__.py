"""Correlation functions of the Gaussian processes: one file each, and a line in `KERNELS`."""

from typing import Any

from strandline.errors import InvalidInput
from strandline.registry import lookup
from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.matern32 import MATERN32
from strandline.surrogate.kernels.matern32_ard import MATERN32_ARD
from strandline.surrogate.kernels.matern32_product import MATERN32_PRODUCT
from strandline.surrogate.kernels.matern52 import MATERN52
from strandline.surrogate.kernels.matern52_ard import MATERN52_ARD
from strandline.surrogate.kernels.matern52_product import MATERN52_PRODUCT
from strandline.surrogate.kernels.protocol import Kernel, LengthScale, as_length_scale, as_lengths, exp
from strandline.surrogate.kernels.squared_exponential import SQUARED_EXPONENTIAL
from strandline.surrogate.kernels.squared_exponential_ard import SQUARED_EXPONENTIAL_ARD

__all__ = ["KERNELS", "Isotropic", "Kernel", "LengthScale", "as_length_scale", "as_lengths", "exp", "kernel_named"]

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


def kernel_named(name: str, *, what: str = "name of the kernel") -> Kernel:
    """Return the kernel of that name in `KERNELS`, or the object ``module:name``; `what` names it in messages.

    Raises:
        InvalidInput: There is no such kernel, or the object is not a kernel.
    """
    found: Any = lookup(KERNELS, name, what)
    if not isinstance(found, Kernel):
        raise InvalidInput(
            what,
            value=name,
            expected="an object with the methods of strandline.surrogate.kernels.Kernel",
            remedy="Check it with strandline.testing.kernels.",
        )
    return found
