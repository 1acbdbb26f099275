"""Hyperelastic laws in mixed form, plane strain; a new law is one file and one line in `LAWS`.

A law takes the displacement d, the solid pressure pₛ, Young's modulus E, Poisson's ratio ν and its own parameters, if
any, and returns the second Piola–Kirchhoff stress and the residual of the constitutive constraint that defines pₛ.
"""

import re
from typing import Any, cast

from strandline.errors import InvalidInput
from strandline.models.biofilm.materials.fung import Fung
from strandline.models.biofilm.materials.isotropic import IsotropicLaw, flaw
from strandline.models.biofilm.materials.law import (
    Law,
    MixedStress,
    deformation_gradient,
    further_parameters,
    typical_value,
)
from strandline.models.biofilm.materials.mooney_rivlin import MooneyRivlin
from strandline.models.biofilm.materials.neo_hookean import NeoHookean
from strandline.models.biofilm.materials.saint_venant_kirchhoff import SaintVenantKirchhoff
from strandline.models.biofilm.materials.yeoh import Yeoh
from strandline.models.protocol import ModelInput
from strandline.registry import lookup

__all__ = [
    "LAWS",
    "IsotropicLaw",
    "Law",
    "MixedStress",
    "deformation_gradient",
    "further_parameters",
    "law_named",
    "typical_value",
]

LAWS: dict[str, Law] = {
    "saint_venant_kirchhoff": SaintVenantKirchhoff(),
    "neo_hookean": NeoHookean(),
    "mooney_rivlin": MooneyRivlin(),
    "yeoh": Yeoh(),
    "fung": Fung(),
}
"""Names in study files → laws."""


def law_named(name: str) -> Law:
    """Return a law by its name in `LAWS`, or a third party's by ``module:name``.

    Raises:
        InvalidInput: There is no such law, or it is not one.
    """
    found = lookup(LAWS, name, "material of the biofilm model")
    if name in LAWS:
        return cast(Law, found)
    law: Any = _made(name, found) if isinstance(found, type) else found
    parameters = further_parameters(law) if callable(law) else ()
    if not callable(law) or not all(_is_parameter(item) for item in parameters):
        raise _refused(
            name,
            _shown(law) if not callable(law) else ", ".join(map(_name_of, parameters)),
            "an IsotropicLaw or a function of NGSolve forms; `parameters`, if any, are a tuple of ModelInput in Pa or "
            "of unit 1, whose names are words without digits, not E, nu or V_in",
        )
    if isinstance(law, IsotropicLaw) and (wrong := flaw(law)):
        raise _refused(name, wrong, "coefficients of a solid without stress at rest, with E and nu at small strains")
    return cast(Law, law)


def _made(name: str, kind: type) -> Any:
    try:
        return kind()
    except Exception as error:
        raise _refused(name, f"{type(error).__name__}: {error}", "a class that is made without arguments") from None


def _refused(name: str, value: Any, expected: str) -> InvalidInput:
    return InvalidInput(
        f"material {name} of the biofilm model",
        value=value,
        expected=expected,
        remedy="Correct the law; strandline.models.biofilm.materials.fung is an example.",
    )


def _shown(thing: object) -> str:
    text = repr(thing)
    return f"an object of class {type(thing).__name__}" if " object at 0x" in text else text


def _name_of(item: object) -> str:
    return str(getattr(item, "name", repr(item)))


def _is_parameter(item: object) -> bool:
    return (
        isinstance(item, ModelInput)
        and item.unit in ("1", "Pa")
        and re.fullmatch("[A-Za-z_]+", item.name) is not None
        and item.name not in ("E", "nu", "V_in")
    )
