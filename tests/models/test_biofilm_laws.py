"""Material laws: limits, derivatives, laws of third parties, and the results of earlier versions."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from verification.validation.energies import ENERGIES, FURTHER
from verification.validation.generality import law_inputs, sensitivity_errors

from strandline.errors import InvalidInput
from strandline.models.biofilm.materials import LAWS, law_named
from strandline.models.biofilm.materials.isotropic import flaw
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import fingerprint
from strandline.studies import load_study

NEW = ("mooney_rivlin", "yeoh", "fung")
EARLIER = (
    ({}, 400.0, [[0.045971970618460034, 0.014044939224772457], [0.030339027110091177, -0.006895709740690925]]),
    ({}, 270.0, [[0.06928335391643548, 0.018338161773347295], [0.044889174008244215, -0.011514735697337297]]),
    (
        {"material": "neo_hookean"},
        400.0,
        [[0.04674938375738169, 0.016808254025071634], [0.03172664578316531, -0.006363314447001334]],
    ),
    (
        {"channel": {"inlet": "right", "outlet": "traction_free"}},
        400.0,
        [[-0.030506441510156468, -0.005288268547500585], [-0.03985506553083962, 0.006367603196248184]],
    ),
)
"""Options, E, and displacements of two nodes by revision 2 of the model before it had other laws, fluids or inflows."""
OWN = """
from dataclasses import dataclass
from typing import ClassVar
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.materials.isotropic import IsotropicLaw
from strandline.models.protocol import ModelInput

@dataclass(frozen=True)
class Softer:
    parameters: ClassVar = (ModelInput("modulus", "Pa", 0.0, 1e9, meaning="Young's modulus that is taken away"),)

    def __call__(self, d, solid_pressure, young, poisson, /, modulus):
        return LAWS["neo_hookean"](d, solid_pressure, young - modulus, poisson)

def plain(d, solid_pressure, young, poisson):
    return LAWS["neo_hookean"](d, solid_pressure, young, poisson)

number = 3

class Bent(IsotropicLaw):
    def coefficients(self, invariant, log_volume, pressure, shear):
        return BENT(invariant, log_volume, pressure, shear)

class WithoutCoefficients(IsotropicLaw):
    pass

class Bad(Softer):
    parameters: ClassVar = (ModelInput("k2", "1", 0.0, 1.0),)
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of a third party's module of laws."""
    (tmp_path / "our_laws.py").write_text(OWN, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "our_laws", raising=False)
    return "our_laws"


def moved(model: Biofilm, inputs: dict[str, float]) -> np.ndarray:
    return np.asarray(model(inputs).interface.points - model.undeformed().points)


@pytest.mark.parametrize(("options", "E", "expected"), EARLIER)
def test_results_are_those_of_earlier_versions(options, E, expected):
    model = Biofilm.from_options(mesh="coarse", **options)
    found = moved(model, {"E": E, "nu": 0.3, "V_in": 100.0})[[20, 45]]
    np.testing.assert_allclose(
        found, expected, rtol=0.0, atol=1e-8
    )  # mm; the quadrature of the fluid has changed since


def test_the_fingerprints_of_earlier_versions_stay():
    """Old ledgers stay readable: new options count only where they differ from their defaults."""
    assert Biofilm(mesh="coarse", material="neo_hookean").fingerprint == "biofilm:r2:mesh=coarse:16696130e17337a5"
    parts = Biofilm.from_options(mesh="coarse", partition="three_parts")
    assert parts.fingerprint == "biofilm:r2:mesh=coarse:5ccd804850463b5a"
    other = Biofilm.from_options(mesh="coarse", channel={"inlet": "right", "outlet": "traction_free"})
    assert other.fingerprint == "biofilm:r2:mesh=coarse:7e57dc79f9e323a3"
    rates = Biofilm.from_options(mesh="coarse", inflow_rates={"slow": 50, "fast": 100})
    assert rates.fingerprint == "biofilm:r2:mesh=coarse:eeeb15a0cff228d5"


@pytest.mark.parametrize("law", NEW)
def test_sensitivities_by_each_parameter_of_a_law(law):
    inputs = law_inputs(law)
    model = Biofilm(mesh="coarse", material=law)
    assert [item.name for item in model.inputs] == list(inputs)
    errors = sensitivity_errors(model, inputs)
    assert set(errors) == set(inputs)
    assert max(errors.values()) < 1e-6


def test_laws_agree_for_small_strains_with_linear_elasticity():
    """All laws have the limit of the same E and ν: the displacement is proportional to 1/E there."""
    stiff = {law: moved(Biofilm(mesh="coarse", material=law), law_inputs(law) | {"E": 1e6}) for law in LAWS}
    reference = stiff["saint_venant_kirchhoff"]
    for found in stiff.values():
        np.testing.assert_allclose(found, reference, atol=1e-3 * np.abs(reference).max())
    twice = moved(Biofilm(mesh="coarse", material="fung"), law_inputs("fung") | {"E": 5e5})
    np.testing.assert_allclose(twice, 2 * stiff["fung"], atol=4e-3 * np.abs(reference).max())


@pytest.mark.parametrize("law", NEW)
@pytest.mark.parametrize("nu", [-0.5, 0.3, 0.5])
def test_a_law_whose_further_parameters_are_zero_is_neo_hookean(law, nu):
    inputs = {"E": 400.0, "nu": nu, "V_in": 100.0}
    further = dict.fromkeys(set(law_inputs(law)) - set(inputs), 0.0)
    found = moved(Biofilm(mesh="coarse", material=law), inputs | further)
    np.testing.assert_allclose(found, moved(Biofilm(mesh="coarse", material="neo_hookean"), inputs), atol=1e-9)


@pytest.mark.parametrize("law", ["yeoh", "fung"])
def test_a_stiffening_law_bends_less(law):
    inputs = law_inputs(law)
    soft = {name: inputs[name] for name in ("E", "nu", "V_in")}
    stiffer, softer = (
        np.abs(moved(Biofilm(mesh="coarse", material=name), x)).max()
        for name, x in ((law, inputs), ("neo_hookean", soft))
    )
    assert stiffer < 0.99 * softer


def test_energies_are_those_of_the_registry():
    assert list(ENERGIES) == list(FURTHER) == list(LAWS)


def test_each_part_has_its_own_further_parameters():
    model = Biofilm.from_options(mesh="coarse", material="fung", partition="three_parts")
    names = [item.name for item in model.inputs]
    assert names == ["E1", "nu1", "exponent1", "E2", "nu2", "exponent2", "E3", "nu3", "exponent3", "V_in"]
    values = dict(zip(names, (300.0, 0.3, 0.0) * 3 + (100.0,), strict=True))
    base = moved(model, values)
    changes = [np.abs(moved(model, values | {f"exponent{k}": 5.0}) - base).max() for k in (1, 2, 3)]
    assert min(changes) > 1e-6
    assert len({round(change, 7) for change in changes}) == 3


def test_a_law_of_a_third_party(own):
    model = Biofilm(mesh="coarse", material=f"{own}:Softer", sensitivities=True)
    found = model({"E": 500.0, "nu": 0.3, "modulus": 100.0, "V_in": 100.0})
    neo = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
    expected = Biofilm(mesh="coarse", material="neo_hookean", sensitivities=True)(neo)
    np.testing.assert_allclose(found.interface.points, expected.interface.points, atol=1e-12)
    slopes = found.sensitivities[""]
    np.testing.assert_allclose(slopes["modulus"], -expected.sensitivities[""]["E"], atol=1e-12)
    same = Biofilm(mesh="coarse", material=f"{own}:plain")(neo).interface.points
    np.testing.assert_allclose(same, expected.interface.points, atol=1e-12)


def test_the_source_of_a_third_partys_law_counts_in_the_fingerprint(own, tmp_path):
    before = fingerprint(Biofilm(material=f"{own}:plain"))
    assert fingerprint(Biofilm(material=f"{own}:Softer")) != before
    source = tmp_path / "our_laws.py"
    source.write_text(OWN + "\n# another comment\n", "utf-8")
    assert fingerprint(Biofilm(material=f"{own}:plain")) != before


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("neo_hokean", "Did you mean neo_hookean"),
        ("our_laws:missing", "a name defined in our_laws"),
        ("our_laws:number", "our_laws:number of the biofilm model: got 3"),
        ("our_laws:Bad", "got k2"),
    ],
)
def test_what_is_no_law_is_refused(own, name, words):
    with pytest.raises(InvalidInput, match=words) as caught:
        law_named(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("law", "values", "words"),
    [
        ("mooney_rivlin", {"share": 1.2}, r"share \(share of the second invariant, c2 / \(c1 \+ c2\)\) in \[0, 1\]"),
        ("fung", {"exponent": -1}, r"in \[0, inf\)"),
        ("yeoh", {"second": -1, "third": -0.1}, r"in \[0, inf\)"),
        ("yeoh", {"second": 1}, "no value for third"),
    ],
)
def test_parameters_out_of_range_are_refused_in_a_study(tmp_path, law, values, words):
    given = ", ".join(f"{name}: {value}" for name, value in values.items())
    (tmp_path / "study.yaml").write_text(
        f"""
version: 1
name: a
model: {{biofilm: {{mesh: coarse, material: {law}}}}}
fixed: {{V_in: 100, nu: 0.3, {given}}}
inputs:
  E: {{prior: {{uniform: [100, 800]}}, unit: Pa}}
observation: {{synthetic: {{E: 400}}}}
discrepancy: {{normal_offset: {{}}}}
noise: {{sd: 4, unit: um}}
design: {{sobol: {{runs: 32}}}}
""",
        "utf-8",
    )
    with pytest.raises(InvalidInput, match=words) as caught:
        load_study(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("law", LAWS.values(), ids=list(LAWS))
def test_own_laws_are_right_at_rest(law):
    assert flaw(law) is None


@pytest.mark.parametrize(
    ("coefficients", "words"),
    [
        (lambda i, v, p, m: (m, p - m), "coefficients that cannot be computed: ValueError: not enough values"),
        (lambda i, v, p, m: (m, 0.0, p), "stress at rest: 2 in place of 0"),
        (lambda i, v, p, m: (2 * m, 0.0, p - 2 * m), "beta - gamma at rest: 4 in place of 2"),
        (lambda i, v, p, m: (m * (i - 2), 0.0, p - m), "change of the stress at rest with the volume"),
        (lambda i, v, p, m: (m, 0.0, 2 * p - m), "change of the stress at rest with the pressure: 2 in place of 1"),
        (lambda i, v, p, m: (m, 0.0, p - m * v / v), "coefficients that cannot be computed: ZeroDivisionError"),
        (lambda i, v, p, m: (m, 0.0, p - m * float("nan")), "stress at rest: nan in place of 0"),
    ],
)
def test_a_law_that_is_wrong_at_rest_is_refused(own, coefficients, words):
    vars(importlib.import_module(own))["BENT"] = coefficients
    with pytest.raises(InvalidInput, match=re.escape(words)):
        law_named(f"{own}:Bent")


def test_a_law_without_coefficients_is_refused(own):
    with pytest.raises(InvalidInput, match="Can't instantiate abstract class WithoutCoefficients"):
        law_named(f"{own}:WithoutCoefficients")
