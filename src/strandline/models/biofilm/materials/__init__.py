"""Hyperelastic laws in mixed form, plane strain; a new law is one class and one line in `LAWS`.

A law takes the displacement d, the solid pressure pₛ, Young's modulus E, Poisson's ratio ν and its own parameters, if
any, and returns the second Piola–Kirchhoff stress and the residual of the constitutive constraint that defines pₛ.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from strandline.foundations import InvalidInput, lookup, unfit
from strandline.models.biofilm.materials.isotropic import Coefficients, IsotropicLaw, Number, exp, flaw
from strandline.models.biofilm.materials.law import (
    Law,
    MixedStress,
    deformation_gradient,
    further_parameters,
    typical_value,
)
from strandline.models.protocol import ModelInput

__all__ = [
    "LAWS", "IsotropicLaw", "Law", "MixedStress", "SolidInputs", "deformation_gradient", "further_parameters",
    "law_named", "typical_value",
]  # fmt: skip


@dataclass(frozen=True)
class SaintVenantKirchhoff(IsotropicLaw):
    """Energy μ E:E + ½ λ (tr E)² of E = ½ (C - I); Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5."""

    def coefficients(self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /) -> Coefficients:
        """Return those of S = 2 μ E + pₛ I."""
        return pressure - shear, shear, 0.0

    def volume(self, invariant: Number, log_volume: Number) -> Number:
        """Return tr E."""
        return 0.5 * (invariant - 3)


@dataclass(frozen=True)
class NeoHookean(IsotropicLaw):
    """Energy ½ μ (I₁ - 3 - 2 ln J) + ½ λ (ln J)²; Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5."""

    def coefficients(self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /) -> Coefficients:
        """Return those of S = μ (I - C⁻¹) + pₛ C⁻¹."""
        return shear, 0.0, pressure - shear


@dataclass(frozen=True)
class MooneyRivlin(IsotropicLaw):
    """Energy c₁ (I₁ - 3) + c₂ (I₂ - 3) - 2 (c₁ + 2c₂) ln J - 2 c₂ (ln J)² + ½ λ (ln J)².

    With c₁ + c₂ = μ/2, E and ν are those of small strains; `share` is c₂ / (c₁ + c₂). A share of 0 is the neo-Hookean
    law. Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5; the term -2 c₂ (ln J)², which
    vanishes at ν = ½, keeps λ that of small strains.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("share", "1", 0.0, 1.0, meaning="share of the second invariant, c2 / (c1 + c2)"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, share: Number
    ) -> Coefficients:
        """Return those of S = 2 (c₁ + c₂ I₁) I - 2 c₂ C - 2 (c₁ + 2c₂ + 2c₂ ln J) C⁻¹ + pₛ C⁻¹."""
        second = shear * share
        return shear + second * (invariant - 1), -second, pressure - shear - second * (1 + 2 * log_volume)


@dataclass(frozen=True)
class Yeoh(IsotropicLaw):
    """Energy c₁ Q + c₂ Q² + c₃ Q³ + ½ λ (ln J)² with Q = I₁ - 3 - 2 ln J and c₁ = μ/2.

    `second` is c₂/c₁ and `third` c₃/c₁; with both 0 it is the neo-Hookean law. A negative `second` softens the solid
    at moderate strains; without a `third` that stiffens it again, the solid gives way. Source: Yeoh, Rubber Chem.
    Technol. 66 (1993) 754; Q in place of I₁ - 3 keeps the compressible solid free of stress at rest.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("second", "1", -np.inf, np.inf, False, False, "ratio of Yeoh's constants, c2 / c1"),
        ModelInput("third", "1", 0.0, np.inf, True, False, "ratio of Yeoh's constants, c3 / c1"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, second: Number, third: Number
    ) -> Coefficients:
        """Return those of S = μ (1 + 2 c₂/c₁ Q + 3 c₃/c₁ Q²) (I - C⁻¹) + pₛ C⁻¹."""
        Q = invariant - 3 - 2 * log_volume
        stiffness = shear * (1 + 2 * second * Q + 3 * third * Q * Q)
        return stiffness, 0.0, pressure - stiffness


@dataclass(frozen=True)
class Fung(IsotropicLaw):
    """Energy μ/(2b) (exp(b Q) - 1) + ½ λ (ln J)² with Q = I₁ - 3 - 2 ln J.

    `exponent` is b; 0 is the neo-Hookean law. Source: Fung, Biomechanics: Mechanical Properties of Living Tissues
    (1993), in the isotropic form of Demiray, J. Biomech. 5 (1972) 309; Q in place of I₁ - 3 keeps the
    compressible solid free of stress at rest.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("exponent", "1", 0.0, np.inf, True, False, "exponent b of Fung's law"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, exponent: Number
    ) -> Coefficients:
        """Return those of S = μ exp(b Q) (I - C⁻¹) + pₛ C⁻¹."""
        stiffness = shear * exp(exponent * (invariant - 3 - 2 * log_volume))
        return stiffness, 0.0, pressure - stiffness


LAWS: dict[str, Law] = {
    "saint_venant_kirchhoff": SaintVenantKirchhoff(),
    "neo_hookean": NeoHookean(),
    "mooney_rivlin": MooneyRivlin(),
    "yeoh": Yeoh(),
    "fung": Fung(),
}
"""Names in study files → laws."""

SMALL_STRAIN = (
    ModelInput("E", "Pa", 0.0, np.inf, low_included=False, high_included=False, meaning="Young's modulus"),
    ModelInput("nu", "1", -1.0, 0.5, low_included=False, meaning="Poisson's ratio"),
)


@dataclass(frozen=True)
class SolidInputs:
    """Inputs of a law: E, nu and its further parameters, or E1, nu1, …, E2, … of several parts."""

    law: Law
    parts: int

    @property
    def all(self) -> tuple[ModelInput, ...]:
        """Inputs, part by part."""
        return tuple(_of_part(item, number) for number in self._numbers for item in self._parameters)

    @property
    def names(self) -> list[str]:
        """Names, parameter by parameter: E1, E2, …, nu1, …, as `FlowCell.sensitivities` orders them."""
        return [item.name + number for item in self._parameters for number in self._numbers]

    def values(self, inputs: Mapping[str, float]) -> list[list[float]]:
        """Return Young's moduli, Poisson's ratios and further parameters, each for every part."""
        return [[float(inputs[item.name + number]) for number in self._numbers] for item in self._parameters]

    @property
    def _parameters(self) -> tuple[ModelInput, ...]:
        return (*SMALL_STRAIN, *further_parameters(self.law))

    @property
    def _numbers(self) -> list[str]:
        """What names of inputs end with: the number of the part; nothing if there is one."""
        return [""] if self.parts == 1 else [str(k) for k in range(1, self.parts + 1)]


def _of_part(item: ModelInput, number: str) -> ModelInput:
    """Return a parameter of the law as an input of part `number`; empty if there is one part."""
    if not number:
        return item
    return replace(item, name=item.name + number, meaning=f"{item.meaning} of part {number}")


def law_named(name: str) -> Law:
    """Return a law by its name in `LAWS`, or a third party's by ``module:name``."""
    found = lookup(LAWS, name, "material of the biofilm model")
    if name in LAWS:
        return cast(Law, found)
    law: Any = _made(name, found) if isinstance(found, type) else found
    parameters = further_parameters(law) if callable(law) else ()
    if not callable(law) or not all(_is_parameter(item) for item in parameters):
        found = ", ".join(str(getattr(item, "name", repr(item))) for item in parameters) if callable(law) else law
        expected = "an IsotropicLaw or a function of NGSolve forms; `parameters`, if any, are a tuple of ModelInput in "
        expected += "Pa or of unit 1, whose names are words without digits, not E, nu or V_in"
        raise _refused(name, found, expected)
    if isinstance(law, IsotropicLaw) and (wrong := flaw(law)):
        raise _refused(name, wrong, "coefficients of a solid without stress at rest, with E and nu at small strains")
    return cast(Law, law)


def _made(name: str, kind: type) -> Any:
    try:
        return kind()
    except Exception as error:
        raise _refused(name, f"{type(error).__name__}: {error}", "a class that is made without arguments") from None


def _refused(name: str, value: Any, expected: str) -> InvalidInput:
    remedy = "Correct the law; strandline.models.biofilm.materials.Fung is an example."
    return unfit(f"material {name} of the biofilm model", value, expected, remedy)


def _is_parameter(item: object) -> bool:
    if not isinstance(item, ModelInput) or item.unit not in ("1", "Pa") or item.name in ("E", "nu", "V_in"):
        return False
    return re.fullmatch("[A-Za-z_]+", item.name) is not None
