"""The energies of the material laws, differentiated independently of the model's stresses.

An energy is written once, from invariants, and differentiated in two ways: by complex steps in NumPy, exact to
round-off, and symbolically in NGSolve. The stress of the volume, pₛ, is left out: its derivative is added by hand.
"""

from collections.abc import Callable
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float

Tensor = Float[np.ndarray, "2 2"]
Energy = Callable[..., Any]

FURTHER = {"saint_venant_kirchhoff": (), "neo_hookean": (), "mooney_rivlin": (0.4,), "yeoh": (0.6, 0.8), "fung": (1.5,)}
"""Values of each law's further parameters in the verification."""
STEP = 1e-30


def saint_venant_kirchhoff(mu: float, I1: Any, I2: Any, log: Any, exp: Any) -> Any:
    """Return μ E:E, where 4 E:E = tr C² - 2 tr C + 3 and tr C² = I₁² - 2 I₂."""
    return 0.25 * mu * (I1 * I1 - 2 * I2 - 2 * I1 + 3)


def neo_hookean(mu: float, I1: Any, I2: Any, log: Any, exp: Any) -> Any:
    """Return ½ μ (I₁ - 3 - 2 ln J)."""
    return 0.5 * mu * (I1 - 3 - 2 * log)


def mooney_rivlin(mu: float, I1: Any, I2: Any, log: Any, exp: Any, share: float) -> Any:
    """Return c₁ (I₁ - 3) + c₂ (I₂ - 3) - 2 (c₁ + 2 c₂) ln J - 2 c₂ (ln J)²."""
    c2 = 0.5 * mu * share
    c1 = 0.5 * mu - c2
    return c1 * (I1 - 3) + c2 * (I2 - 3) - 2 * (c1 + 2 * c2) * log - 2 * c2 * log * log


def yeoh(mu: float, I1: Any, I2: Any, log: Any, exp: Any, second: float, third: float) -> Any:
    """Return ½ μ (Q + c₂/c₁ Q² + c₃/c₁ Q³)."""
    Q = I1 - 3 - 2 * log
    return 0.5 * mu * (Q + second * Q * Q + third * Q * Q * Q)


def fung(mu: float, I1: Any, I2: Any, log: Any, exp: Any, exponent: float) -> Any:
    """Return μ/(2b) (exp(b Q) - 1)."""
    return 0.5 * mu / exponent * (exp(exponent * (I1 - 3 - 2 * log)) - 1)


ENERGIES: dict[str, Energy] = {
    energy.__name__: energy for energy in (saint_venant_kirchhoff, neo_hookean, mooney_rivlin, yeoh, fung)
}
"""Energies without ½ λ (ln J)², or ½ λ (tr E)², by the law's name."""


def shear_modulus(young: float, poisson: float) -> float:
    """Return μ = E / 2(1+ν)."""
    return 0.5 * young / (1 + poisson)


def isochoric_piola(law: str, F: Tensor, mu: float) -> Tensor:
    """Return dW/dF in the plane by complex steps, for plane strain."""
    result = np.empty((2, 2))
    for i, j in np.ndindex(2, 2):
        moved = F.astype(complex)
        moved[i, j] += 1j * STEP
        C = moved.T @ moved
        J = moved[0, 0] * moved[1, 1] - moved[0, 1] * moved[1, 0]
        trace = C[0, 0] + C[1, 1]
        energy = ENERGIES[law](mu, trace + 1, trace + J * J, np.log(J), np.exp, *FURTHER[law])
        result[i, j] = energy.imag / STEP
    return result


def symbolic_piola(law: str, F: Any, mu: float) -> Any:
    """Return dW/dF in the plane as an NGSolve coefficient function, for plane strain."""
    variable = F.MakeVariable()
    J, trace = ng.Det(variable), ng.InnerProduct(variable, variable)
    return ENERGIES[law](mu, trace + 1, trace + J * J, ng.log(J), ng.exp, *FURTHER[law]).Diff(variable)


def volume_piola(law: str, F: Any, pressure: Any) -> Any:
    """Return the derivative of the volume's energy, pₛ F (Saint-Venant–Kirchhoff) or pₛ F⁻ᵀ."""
    if law == "saint_venant_kirchhoff":
        return pressure * F
    return pressure * (np.linalg.inv(F).T if isinstance(F, np.ndarray) else ng.Inv(F).trans)
