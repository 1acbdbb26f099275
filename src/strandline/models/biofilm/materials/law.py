"""What a material law is, and the quantities that laws are made of.

Source of notation: Holzapfel, Nonlinear Solid Mechanics (2000), chapters 2 and 6.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from ngsolve import Grad, Id

from strandline.models.protocol import ModelInput

Form = Any  # an NGSolve coefficient function


@dataclass(frozen=True)
class MixedStress:
    """Second Piola–Kirchhoff stress S of a law, a 2 × 2 form, and S_zz, pₛ if None.

    The constraint is a form that vanishes where pₛ is the pressure-like stress of the law.
    """

    second_piola: Form
    constraint: Form
    out_of_plane: Form = None


@runtime_checkable
class Law(Protocol):
    """A hyperelastic law in mixed form, plane strain: a function of these arguments, or an object called with them.

    E and ν are those of small strains. A law with further parameters is an object with `parameters`, a tuple of
    `ModelInput` with unit ``1`` or ``Pa``; their values follow ν in this order. The constraint should be regular for
    every ν in (-1, ½], ν = 0 and ν = ½ included.
    """

    def __call__(self, d: Form, solid_pressure: Form, young: Form, poisson: Form, /, *further: Form) -> MixedStress:
        """Return the stress at displacement d and solid pressure pₛ, as symbolic forms."""


def further_parameters(law: Law) -> tuple[ModelInput, ...]:
    """Return the parameters that a law has in addition to E and ν."""
    return tuple(getattr(law, "parameters", ()))


def typical_value(parameter: ModelInput) -> float:
    """Return a value well inside the range of a law's parameter."""
    low, high = parameter.low, parameter.high
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return low + 1.0 if np.isfinite(low) else min(high - 1.0, 0.0)


def deformation_gradient(d: Form) -> Form:
    """Return F = I + ∇d."""
    return Id(2) + Grad(d)


def compliance(young: Form, poisson: Form) -> Form:
    """Return (1+ν)(1-2ν)/E = ν/λ."""
    return (1 + poisson) * (1 - 2 * poisson) / young


def shear_modulus(young: Form, poisson: Form) -> Form:
    """Return μ = E / 2(1+ν)."""
    return 0.5 * young / (1 + poisson)
