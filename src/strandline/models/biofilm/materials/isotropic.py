"""Isotropic laws: three coefficients, each a function of the first invariant, of ln J and of the solid's pressure.

Every isotropic stress is S = α I + β C + γ C⁻¹ with C = FᵀF (Holzapfel, Nonlinear Solid Mechanics, 2000, section 6.2).
A law written like this is evaluated as NGSolve's form, and also in all elements at once, with exact derivatives.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import ngsolve as ng
import numpy as np

from strandline.models.biofilm.materials.law import (
    Form,
    MixedStress,
    compliance,
    deformation_gradient,
    shear_modulus,
    typical_value,
)
from strandline.models.protocol import ModelInput

Number = Any  # a float, an NGSolve form, or a Jet
Coefficients = tuple[Number, Number, Number]


class IsotropicLaw(ABC):
    """A law given by α, β and γ of S = α I + β C + γ C⁻¹; `parameters` are those besides E and ν."""

    parameters: ClassVar[tuple[ModelInput, ...]] = ()

    @abstractmethod
    def coefficients(self, *measures: Number, **further: Number) -> Coefficients:
        """Return α, β and γ.

        Args:
            measures: I₁ = tr C, with the 1 from across the plane; ln J; the solid's pressure pₛ, which is λ times
                `volume`; the shear modulus μ; and the values of `parameters`. They support + - * / **, `exp` and `log`.
            further: None; a law may give `measures` names of its own.
        """

    def volume(self, invariant: Number, log_volume: Number) -> Number:
        """Return the change of volume that the pressure is proportional to, ln J."""
        return log_volume

    def __call__(self, d: Form, solid_pressure: Form, young: Form, poisson: Form, /, *further: Form) -> MixedStress:
        """Return the stress and the constraint ν volume - (1+ν)(1-2ν)/E pₛ as NGSolve forms."""
        F = deformation_gradient(d)
        C = F.trans * F
        measures = (ng.Trace(C) + 1, ng.log(ng.Det(F)))
        alpha, beta, gamma = self.coefficients(*measures, solid_pressure, shear_modulus(young, poisson), *further)
        terms = ((alpha, ng.Id(2)), (beta, C), (gamma, ng.Inv(C)))
        parts = [number * tensor for number, tensor in terms if not (isinstance(number, float) and number == 0.0)]
        stress = sum(parts[1:], parts[0])
        constraint = poisson * self.volume(*measures) - compliance(young, poisson) * solid_pressure
        return MixedStress(stress, constraint, alpha + beta + gamma)


class Jet:
    """A number at quadrature points with its derivatives by I₁, ln J and pₛ.

    Args:
        value: Value, a number or an array.
        slopes: Derivatives, numbers or arrays.
    """

    __array_ufunc__ = None  # so that an array times a jet is a jet

    def __init__(self, value: Any, slopes: tuple[Any, Any, Any] = (0.0, 0.0, 0.0)) -> None:
        self.value, self.slopes = value, slopes

    @classmethod
    def variables(cls, *values: Any) -> tuple["Jet", ...]:
        """Return I₁, ln J and pₛ."""
        units = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        return tuple(cls(value, unit) for value, unit in zip(values, units, strict=True))

    @classmethod
    def of(cls, number: Any) -> "Jet":
        """Return a number as a jet."""
        return number if isinstance(number, cls) else cls(number)

    def exp(self) -> "Jet":
        """Return the exponential."""
        value = np.exp(self.value)
        return Jet(value, _each(lambda slope: value * slope, self.slopes))

    def log(self) -> "Jet":
        """Return the natural logarithm."""
        return Jet(np.log(self.value), _each(lambda slope: slope / self.value, self.slopes))

    def __pow__(self, exponent: Any) -> "Jet":
        """Return a power whose exponent is a number or an array."""
        factor = exponent * self.value ** (exponent - 1)
        return Jet(self.value**exponent, _each(lambda slope: factor * slope, self.slopes))

    def __add__(self, other: Any) -> "Jet":
        other = Jet.of(other)
        return Jet(self.value + other.value, _each(lambda a, b: a + b, self.slopes, other.slopes))

    def __mul__(self, other: Any) -> "Jet":
        other = Jet.of(other)
        slopes = _each(lambda a, b: a * other.value + self.value * b, self.slopes, other.slopes)
        return Jet(self.value * other.value, slopes)

    def __truediv__(self, other: Any) -> "Jet":
        other = Jet.of(other)
        value = self.value / other.value
        return Jet(value, _each(lambda a, b: (a - value * b) / other.value, self.slopes, other.slopes))

    def __rtruediv__(self, other: Any) -> "Jet":
        return Jet(other) / self

    def __neg__(self) -> "Jet":
        return self * -1.0

    def __sub__(self, other: Any) -> "Jet":
        return self + -Jet.of(other)

    def __rsub__(self, other: Any) -> "Jet":
        return Jet.of(other) + -self

    __radd__, __rmul__ = __add__, __mul__


def flaw(law: IsotropicLaw) -> str | None:
    """Return what is wrong with a law at rest, in words; None if it is as E and ν of small strains require.

    At rest S vanishes, and a small change of C changes it by μ dC, and by the change of pₛ times I.
    """
    rest, shear = Jet.variables(3.0, 0.0, 0.0), 2.0
    typical = [typical_value(item) for item in law.parameters]
    try:
        alpha, beta, gamma = (Jet.of(number) for number in law.coefficients(*rest, shear, *typical))
        total, resistance = alpha + beta + gamma, beta.value - gamma.value
        by_invariant, by_log_volume, by_pressure = total.slopes
        by_volume = by_invariant + 0.5 * by_log_volume
        found = {
            "stress at rest": (total.value, 0.0),
            "beta - gamma at rest": (resistance, shear),
            "change of the stress at rest with the volume, at constant pressure": (by_volume, 0.0),
            "change of the stress at rest with the pressure": (by_pressure, 1.0),
        }
        wrong = {name: pair for name, pair in found.items() if not abs(pair[0] - pair[1]) <= 1e-9}
    except Exception as error:
        return f"coefficients that cannot be computed: {type(error).__name__}: {error}"
    for name, (value, expected) in wrong.items():
        return f"{name}: {value:g} in place of {expected:g}, at a shear modulus of {shear:g}"
    return None


def exp(number: Number) -> Number:
    """Return the exponential of a jet or of an NGSolve form."""
    return number.exp() if isinstance(number, Jet) else ng.exp(number)


def log(number: Number) -> Number:
    """Return the natural logarithm of a jet or of an NGSolve form."""
    return number.log() if isinstance(number, Jet) else ng.log(number)


def _each(change: Any, *slopes: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    first, second, third = (change(*given) for given in zip(*slopes, strict=True))
    return first, second, third
