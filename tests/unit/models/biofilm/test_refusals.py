"""Options of the biofilm model that cannot be used: each is refused in one line that names the place."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest
from tests.unit.models.biofilm.cells import coarse, importable

from strandline.errors import InvalidInput
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.materials import law_named
from strandline.models.biofilm.subdivision import Partition
from strandline.models.protocol import with_sensitivities
from strandline.studies import load_study
from strandline.testing.studies import write_study

THREE = Partition.PRESETS["three_parts"]
OWN = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from strandline.models.biofilm.materials.isotropic import IsotropicLaw
from strandline.models.protocol import ModelInput

number = 3

def wrong(y, bottom, top):
    return np.ones(3)

class Bent(IsotropicLaw):
    def coefficients(self, invariant, log_volume, pressure, shear):
        return BENT(invariant, log_volume, pressure, shear)

class WithoutCoefficients(IsotropicLaw):
    pass

@dataclass(frozen=True)
class Bad:
    parameters: ClassVar = (ModelInput("k2", "1", 0.0, 1.0),)

    def __call__(self, d, solid_pressure, young, poisson, /, k2):
        return 0
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a third party's module of laws and profiles."""
    return importable(tmp_path, monkeypatch, "our_refused", OWN)


def outline(*points: tuple[float, float], **options: Any) -> dict[str, Any]:
    return {"outline": {"points": [list(point) for point in points], "spline": False, "nodes": None, **options}}


def cut(markers: Any, lines: Any = ([[0.4, 0.1], [1.5, 0.1]],)) -> dict[str, Any]:
    return {"partition": {"lines": list(lines), "markers": markers}}


FIRST = [[0.8, 0.0], [0.9, 0.3], [1.0, 0.3], [1.1, 0.0]]
SECOND = [[2.9, 0.0], [3.0, 0.3], [3.1, 0.3], [3.2, 0.0]]
TOUCHING = [[0.3, 0], [0.5, 0.3], [0.7, 0]]
TWO = {"channel": {"length": 4.0}, "outline": {"points": FIRST + SECOND}}
RANGES: dict[str, Any] = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
RISE: dict[str, Any] = {"inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]], "times": {"half": 0.05, "late": 0.3}}
STEP: dict[str, Any] = {"inflow": [[0, 0], [0, 1], [5, 1]], "times": {"a": 1.0, "b": 5.0}}
SLOWLY = STEP | {"inflow": [[0, 0], [5, 1]], "motion": "transient"}


def table(*points: list[float]) -> dict[str, Any]:
    return {"inflow": {"table": list(points)}}


def anchors(**changes: Any) -> dict[str, Any]:
    return {"anchors": RANGES | changes}


def course(**changes: Any) -> dict[str, Any]:
    return {"course": RISE | changes}


def creeping(**changes: Any) -> dict[str, Any]:
    return {"course": STEP, "branches": 1} | changes


REFUSED: dict[str, list[tuple[dict[str, Any], str]]] = {
    "mesh and budget": [
        ({"mesh": "corse"}, "coarse, default, fine"),
        *(({"failure_budget": budget}, "failure_budget") for budget in (1, 2, -5, True)),
    ],
    "channel": [
        ({"channel": {"len": 2}}, "length"),
        ({"channel": {"inlet": "top"}}, "left, right"),
        ({"channel": {"height": 0}}, "height.*above 0"),
        ({"channel": {"length": float("inf")}}, "length"),
        ({"channel": {"height": "1.5 mm"}}, "height of the channel: got 1.5 mm"),
        ({"channel": {"heigth": 1.5}}, "Did you mean height"),
        ({"channel": {"top": "open"}}, "no_slip, slip, symmetry"),
    ],
    "outline": [
        (outline((0.5, 0.1), (1.0, 0.5), (1.5, 0.0)), r"end of the outline.*\(0.5, 0.1\)"),
        (outline((0.5, 0.0), (1.0, 1.2), (1.5, 0.0)), r"outside the channel.*\(1, 1.2\)"),
        (outline((0.5, 0.0), (1.2, 0.5), (1.2, 0.2), (0.7, 0.4), (1.5, 0.0)), r"cross.*\(0.930769, 0.307692\)"),
        (outline((1.5, 0.0), (1.0, 0.5), (0.5, 0.0)), r"direction.*\(1.5, 0\)"),
        (outline((0.5, 0.0), (1.0, -0.1), (1.5, 0.0)), r"outside the channel.*\(1, -0.1\)"),
        (outline((0.5, 0.0), (1.0, 0.5), (2.0, 0.0)), r"\(2, 0\)"),
        (outline((0.5, 0.0), (2.5, 0.4), (2.6, 0.0)), "outline"),
        (outline((0.9, 0), (1, 0.5), (1.5, 0.05), (1.9, 0), spline=True, nodes=66), "spline may overshoot"),
        (outline((0.9, 0), (1, 1.0), (1.9, 0), nodes=4), r"\(1, 1\) mm"),
        (outline((0.5, 0.0), (1.0, 0.5), (1.5, 0.0), spline=True), "nodes"),
        (outline((0.5, 0), (1, 0.5)), "three pairs"),
        ({"outline": {"nodes": 2}}, "at least 4"),
        ({"outline": {"nodes": 3}}, "at least 4"),
        ({"outline": "hill.csv"}, "also file with its unit"),
        ({"outline": {"points": [*TOUCHING, [1, 0.3], [1.3, 0]]}}, "two neighbouring points on the floor"),
        ({"outline": {"points": [*TOUCHING, [0.8, 0], [0.9, 0], [1.3, 0]]}}, r"got 1 point\(s\) from \(0.8, 0\) mm"),
    ],
    "parts": [
        ({"partition": "four"}, "lines, markers"),
        ({"partition": "three_parts", **outline((0.2, 0), (0.4, 0.5), (0.7, 0))}, "the study's outline"),
        (cut([[0.9, 0.3]], [[0.4, 0.1], [1.5, 0.1]]), "pairs of points in mm"),
        (cut([0.9, 0.3], []), "markers of the partition"),
        (cut([[0.9, 0.3]]), "one in each part"),
        (cut([[0.9, 0.3], [0.9, 0.31]]), "of its own"),
        (cut([*THREE.markers[:2], (0.1, 0.9)], THREE.lines), "marker"),
        ({**TWO, **cut([[0.95, 0.1]], [])}, "expected 2"),
    ],
    "foot": [
        ({"clamped": 0.5}, r"stretches \[from, to\] of the floor"),
        ({"clamped": [0.5, 0.9]}, "stretches"),
        ({"clamped": [[0.9, 0.6]]}, "from left to right"),
        ({"clamped": [[0.6, 0.9], [0.8, 1.0]]}, "from left to right"),
        ({"clamped": [[1.5, 1.9]]}, "got 1.5 to 1.9 mm.*stands from 0.54 to 1.391 mm"),
        ({**TWO, "clamped": [[0.8, 1.1]]}, "stands from 2.9 to 3.2 mm"),
    ],
    "fluid": [
        ({"fluid": {"viscosity": 0}}, r"viscosity of the fluid: got 0.*a number in \(0, inf\), in Pa s"),
        ({"fluid": {"viscosity": 0}, "course": RISE}, "viscosity of the fluid"),
        ({"fluid": {"density": -1}}, "density of the fluid: got -1"),
        ({"fluid": {"density": "unknwon"}}, "got unknwon"),
        ({"fluid": {"force_y": float("nan")}}, "force_y of the fluid: got nan"),
        ({"fluid": {"viscosty": 1e-3}}, "Did you mean viscosity"),
    ],
    "inflow": [
        ({"inflow": "plugg"}, "Did you mean plug"),
        ({"inflow": {"profile": "plug"}}, "inflow of the biofilm model"),
        (table([0, 1], [0.5, 2], [0.5, 1], [1, 0]), "y = 0.5 mm after 0.5 mm"),
        (table([0.1, 1], [1, 1]), "covers the inlet, from 0 to 1 mm"),
        (table([0, 1], [0.9, 1]), "covers the inlet, from 0 to 1 mm"),
        (table([0, 0], [1, 0]), "no net inflow"),
        (table([0, 0], [0.5, -2], [1, 0]), r"got -2 at y = 0.5 mm.*velocities that enter"),
        (table([0, 1, 2], [1, 1, 1]), "at least two pairs"),
        ({"inflow": "our_refused:wrong"}, r"one velocity for each height"),
        ({"inflow": "our_refused:missing"}, "a name defined in our_refused"),
    ],
    "several loads": [
        ({"inflow_rates": {"fast": -1}}, "with its inflow rate in mm"),
        ({"inflow": "pressure", "inflow_rates": {"slow": 1}}, "or give `pressure_drops` by condition"),
        ({"pressure_drops": {"low": 5}}, "got low: 5.0 without inflow: pressure; expected"),
        ({"inflow": "pressure", "pressure_drops": {"low": -5}}, "pressure drop 'low' of the biofilm model: got -5"),
        ({"inflow": "pressure", "pressure_drops": [5, 10]}, r"pressure drops in Pa by the name.*{slow: 5, fast: 10}"),
    ],
    "law": [
        ({"material": "ogden"}, "neo_hookean"),
        ({"material": "neo_hokean"}, "Did you mean neo_hookean"),
        ({"material": "our_refused:missing"}, "a name defined in our_refused"),
        ({"material": "our_refused:number"}, "our_refused:number of the biofilm model: got 3"),
        ({"material": "our_refused:Bad"}, "got k2"),
        ({"material": "our_refused:WithoutCoefficients"}, "abstract class WithoutCoefficients"),
    ],
    "anchors": [
        ({"anchors": 24}, "lowest and highest value of each input"),
        (anchors(V_in=[0, 100]), r"\(0, inf\)"),
        (anchors(V_in=0), r"got 0\.0;"),
        ({"anchors": {"E": [100, 800], "nu": 0.3}}, "got no V_in;"),
        (anchors(Ee=3), "Ee, which is no input"),
        (anchors(E=[800, 100]), "E in the anchors"),
        (anchors(nu=[0.0, 0.6]), r"\(-1, 0.5\]"),
        (anchors(E=[0, 800]), r"\(0, inf\)"),
        *(
            (anchors(E=wrong), "a number, or lowest and highest")
            for wrong in ("soft", [100, 300, 800], [100, float("nan")], [100, 10**400], {"low": 1}, True)
        ),
        ({"anchors": {"E": 400, "nu": 0.3, "V_in": 100}}, "at least one input that varies"),
        ({**anchors(), "course": RISE}, "no course"),
    ],
    "course": [
        (course(times=[0.2, 0.1]), "times in the course of the biofilm model: got 0.1 s after 0.2 s; expected times"),
        (course(times=[0.1, 0.1]), "0.1 s after 0.1 s"),
        (course(times=[0.1, 0.4]), "got 0.4 s; expected times inside the course, from 0 to 0.3 s"),
        (course(times=[-0.1]), "got -0.1 s; expected times inside"),
        (course(times=[]), "times in the course of the biofilm model: got none; expected at least one"),
        (course(times=0.1), "expected times in s by the name of the condition"),
        (course(times={"a/b": 0.1}), "expected names of conditions"),
        (course(times={"a": "soon"}), "expected a finite number"),
        (course(inflow=[[0, 0], [0.5, 1], [0.4, 2]]), "times of the inflow in the course .* got 0.4 s after 0.5 s"),
        (course(inflow=[[0, 0], [0.5, -1]]), "got share -1 at 0.5 s; expected shares of V_in, 0 or above"),
        (course(inflow=[[0, 0]]), "expected a table of at least two pairs"),
        (course(inflow="fast"), "expected a table of at least two pairs"),
        (course(motion="dynamic"), "got dynamic; expected one of quasi_static, transient"),
        (course(solid_density=0), r"expected a density in kg/m\^3 above 0"),
        (course(tolerance=0.5), "expected a share above 0, at most 0.1"),
        (course(tolerance=0), "a share above 0"),
        (course(tolerance=float("nan")), "expected a finite number"),
        (course(speed=1), "expected a mapping with inflow and times"),
        (course(inflow=[[0, 0], [0, 1], [5, 1]], times=[1], motion="transient"), "0 s after 0 s"),
        ({"course": 3}, "course of the biofilm model: got 3; expected a mapping"),
        ({"course": RISE, "inflow_rates": {"slow": 50}}, "a course with inflow_rates or pressure_drops; expected one"),
    ],
    "creep": [
        (creeping(branches=4), "a whole number from 0 to 3"),
        (creeping(branches=True), "a whole number from 0 to 3"),
        (creeping(course=SLOWLY), "branches: 1 with motion: transient"),
        (creeping(course=None), "branches: 1 with no course"),
        (creeping(sensitivities=True), "sensitivities with branches: 1"),
        (creeping(course=STEP | {"inflow": [[0, 0], [0, 1], [0, 0], [5, 1]]}), "0 s after 0 s"),
        (creeping(course=STEP | {"inflow": [[0, 1], [6, 1], [5, 0]]}), "5 s after 6 s"),
    ],
}


@pytest.mark.parametrize("group", REFUSED)
def test_options_that_cannot_be_used(own: str, group: str) -> None:
    for options, words in REFUSED[group]:
        with pytest.raises(InvalidInput, match=words) as caught:
            coarse(**options)
        assert "\n" not in str(caught.value)
        if group == "course" and options["course"] != RISE:
            assert str(caught.value).endswith("Correct the course.")


def test_inertia_has_no_sensitivities() -> None:
    with pytest.raises(InvalidInput, match="got sensitivities with motion: transient; expected motion: quasi_static"):
        with_sensitivities(coarse(**course(motion="transient")))


def test_options_as_objects_are_taken_as_they_are() -> None:
    model = coarse(**anchors(viscosity=[9e-4, 11e-4]), fluid={"viscosity": "unknown"}, partition=Partition())
    assert isinstance(model.fluid, Fluid)
    assert isinstance(model.partition, Partition)
    assert model.anchors[-1] == ("viscosity", 9e-4, 11e-4)
    assert coarse(course=Course.of(RISE)).course == Course.of(RISE)


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
def test_a_law_that_is_wrong_at_rest(own: str, coefficients: Any, words: str) -> None:
    vars(importlib.import_module(own))["BENT"] = coefficients
    with pytest.raises(InvalidInput, match=re.escape(words)):
        law_named(f"{own}:Bent")


def test_parameters_of_a_law_out_of_range_in_a_study(tmp_path: Path) -> None:
    for law, values, words in (
        ("mooney_rivlin", {"share": 1.2}, r"share \(share of the second invariant, c2 / \(c1 \+ c2\)\) in \[0, 1\]"),
        ("fung", {"exponent": -1}, r"in \[0, inf\)"),
        ("yeoh", {"second": -1, "third": -0.1}, r"in \[0, inf\)"),
        ("yeoh", {"second": 1}, "no value for third"),
    ):
        folder = write_study(
            tmp_path / law / str(len(values)),
            model={"biofilm": {"mesh": "coarse", "material": law}},
            fixed={"V_in": 100, "nu": 0.3, **values},
            inputs={"E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"}},
            observation={"synthetic": {"E": 400}},
        )
        with pytest.raises(InvalidInput, match=words):
            load_study(folder)
