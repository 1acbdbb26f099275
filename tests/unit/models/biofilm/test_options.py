"""Options of the biofilm model: what is refused, in one line that names the place, and what a fingerprint counts."""

import importlib
import re

import pytest
from tests.unit.models.biofilm.cells import LAYER, OWN, PAIR, coarse

from strandline.errors import InvalidInput
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.materials import law_named
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.subdivision import Partition
from strandline.models.protocol import fingerprint, with_sensitivities
from strandline.studies import load_study
from strandline.testing.studies import write_study

THREE = Partition.PRESETS["three_parts"]


def outline(*points, **options):
    return {"outline": {"points": list(points), "spline": False, "nodes": None, **options}}


def cut(markers, lines=((0.4, 0.1), (1.5, 0.1))):
    return {"partition": {"lines": [lines] if lines else [], "markers": markers}}


TWO = {"channel": {"length": 4.0}, "outline": {"points": PAIR}}
RANGES = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
RISE = {"inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]], "times": {"half": 0.05, "late": 0.3}}
STEP = {"inflow": [[0, 0], [0, 1], [5, 1]], "times": {"a": 1.0, "b": 5.0}}


def table(*points):
    return {"inflow": {"table": list(points)}}


def anchors(**changes):
    return {"anchors": RANGES | changes}


def course(**changes):
    return {"course": RISE | changes}


def creeping(**changes):
    return {"course": STEP | changes, "branches": 1}


REFUSED = {
    "mesh and budget": [
        ({"mesh": "corse"}, "coarse, default, fine"),
        *(({"failure_budget": budget}, "failure_budget") for budget in (2, True)),
    ],
    "channel": [
        ({"channel": {"inlet": "top"}}, "left, right"),
        ({"channel": {"height": 0}}, "height.*above 0"),
        ({"channel": {"height": "1.5 mm"}}, "height of the channel: got 1.5 mm"),
        ({"channel": {"heigth": 1.5}}, "Did you mean height"),
    ],
    "outline": [
        (outline((0.5, 0.1), (1.0, 0.5), (1.5, 0.0)), r"end of the outline.*\(0.5, 0.1\)"),
        (outline((0.5, 0.0), (1.0, 1.2), (1.5, 0.0)), r"outside the channel.*\(1, 1.2\)"),
        (outline((0.5, 0.0), (1.2, 0.5), (1.2, 0.2), (0.7, 0.4), (1.5, 0.0)), r"cross.*\(0.930769, 0.307692\)"),
        (outline((1.5, 0.0), (1.0, 0.5), (0.5, 0.0)), r"direction.*\(1.5, 0\)"),
        (outline((0.5, 0.0), (1.0, 0.5), (2.0, 0.0)), r"\(2, 0\)"),
        (outline((0.9, 0), (1, 1.0), (1.9, 0), nodes=4), r"\(1, 1\) mm"),
        (outline((0.5, 0.0), (1.0, 0.5), (1.5, 0.0), spline=True), "nodes"),
        (outline((0.5, 0), (1, 0.5)), "three pairs"),
        ({"outline": {"nodes": 3}}, "at least 4"),
        ({"outline": "hill.csv"}, "also file with its unit"),
        (outline((0.3, 0), (0.5, 0.3), (0.7, 0), (1, 0.3), (1.3, 0)), "two neighbouring points on the floor"),
        (outline((0.3, 0), (0.5, 0.3), (0.7, 0), (0.8, 0), (0.9, 0), (1.3, 0)), r"got 1 point\(s\) from \(0.8, 0\) mm"),
    ],
    "parts": [
        ({"partition": "three_parts", **outline((0.2, 0), (0.4, 0.5), (0.7, 0))}, "the study's outline"),
        (cut([[0.9, 0.3]], [0.4, 0.1]), "pairs of points in mm"),
        (cut([0.9, 0.3], None), "markers of the partition"),
        (cut([[0.9, 0.3], [0.9, 0.31]]), "of its own"),
        ({"partition": {"lines": THREE.lines, "markers": [*THREE.markers[:2], (0.1, 0.9)]}}, "marker"),
        ({**TWO, **cut([[0.95, 0.1]], None)}, "expected 2"),
    ],
    "foot": [
        ({"clamped": 0.5}, r"stretches \[from, to\] of the floor"),
        ({"clamped": [[0.6, 0.9], [0.8, 1.0]]}, "from left to right"),
        ({"clamped": [[1.5, 1.9]]}, "got 1.5 to 1.9 mm.*stands from 0.54 to 1.391 mm"),
        ({**TWO, "clamped": [[0.8, 1.1]]}, "stands from 2.9 to 3.2 mm"),
    ],
    "fluid": [
        ({"fluid": {"viscosity": 0}}, r"viscosity of the fluid: got 0.*a number in \(0, inf\), in Pa s"),
        ({"fluid": {"density": "unknwon"}}, "got unknwon"),
        ({"fluid": {"force_y": float("nan")}}, "force_y of the fluid: got nan"),
        ({"fluid": {"viscosty": 1e-3}}, "Did you mean viscosity"),
    ],
    "inflow": [
        ({"inflow": "plugg"}, "Did you mean plug"),
        ({"inflow": {"profile": "plug"}}, "inflow of the biofilm model"),
        (table([0, 1], [0.5, 2], [0.5, 1], [1, 0]), "y = 0.5 mm after 0.5 mm"),
        (table([0.1, 1], [1, 1]), "covers the inlet, from 0 to 1 mm"),
        (table([0, 0], [1, 0]), "no net inflow"),
        (table([0, 0], [0.5, -2], [1, 0]), r"got -2 at y = 0.5 mm.*velocities that enter"),
        (table([0, 1, 2], [1, 1, 1]), "at least two pairs"),
        ({"inflow": "our_model:wrong"}, r"one velocity for each height"),
    ],
    "several loads": [
        ({"inflow": "pressure", "inflow_rates": {"slow": 1}}, "or give `pressure_drops` by condition"),
        ({"pressure_drops": {"low": 5}}, "got low: 5.0 without inflow: pressure; expected"),
        ({"inflow": "pressure", "pressure_drops": {"low": -5}}, "pressure drop 'low' of the biofilm model: got -5"),
        ({"inflow": "pressure", "pressure_drops": [5, 10]}, r"pressure drops in Pa by the name.*{slow: 5, fast: 10}"),
    ],
    "law": [
        ({"material": "neo_hokean"}, "Did you mean neo_hookean"),
        ({"material": "our_model:number"}, "our_model:number of the biofilm model: got 3"),
        ({"material": "our_model:Bad"}, "got k2"),
        ({"material": "our_model:WithoutCoefficients"}, "abstract class WithoutCoefficients"),
    ],
    "anchors": [
        (anchors(V_in=[0, 100]), r"\(0, inf\)"),
        ({"anchors": {"E": [100, 800], "nu": 0.3}}, "got no V_in;"),
        (anchors(Ee=3), "Ee, which is no input"),
        (anchors(E=[800, 100]), "E in the anchors"),
        (anchors(nu=[0.0, 0.6]), r"\(-1, 0.5\]"),
        *((anchors(E=wrong), "a number, or lowest") for wrong in ([100, 300, 800], [100, float("nan")], 10**400)),
        ({"anchors": {"E": 400, "nu": 0.3, "V_in": 100}}, "at least one input that varies"),
        ({**anchors(), "course": RISE}, "no course"),
    ],
    "course": [
        (course(times=[0.2, 0.1]), "times in the course of the biofilm model: got 0.1 s after 0.2 s; expected times"),
        (course(times=[0.1, 0.4]), "got 0.4 s; expected times inside the course, from 0 to 0.3 s"),
        (course(times=[]), "times in the course of the biofilm model: got none; expected at least one"),
        (course(times=0.1), "expected times in s by the name of the condition"),
        (course(times={"a/b": 0.1}), "expected names of conditions"),
        (course(times={"a": "soon"}), "expected a finite number"),
        (course(inflow=[[0, 0], [0.5, 1], [0.4, 2]]), "times of the inflow in the course .* got 0.4 s after 0.5 s"),
        (course(inflow=[[0, 0], [0.5, -1]]), "got share -1 at 0.5 s; expected shares of V_in, 0 or above"),
        (course(motion="dynamic"), "got dynamic; expected one of quasi_static, transient"),
        (course(solid_density=0), r"expected a density in kg/m\^3 above 0"),
        (course(tolerance=0.5), "expected a share above 0, at most 0.1"),
        (course(speed=1), "expected a mapping with inflow and times"),
        (course(**STEP, motion="transient"), "0 s after 0 s"),
        ({"course": RISE, "inflow_rates": {"slow": 50}}, "a course with inflow_rates or pressure_drops; expected one"),
    ],
    "creep": [
        *((creeping() | {"branches": wrong}, "a whole number from 0 to 3") for wrong in (4, True)),
        (creeping(inflow=[[0, 0], [5, 1]], motion="transient"), "branches: 1 with motion: transient"),
        ({"branches": 1}, "branches: 1 with no course"),
        (creeping() | {"sensitivities": True}, "sensitivities with branches: 1"),
    ],
}


@pytest.mark.parametrize("group", REFUSED)
def test_options_that_cannot_be_used(own, group):
    for options, words in REFUSED[group]:
        with pytest.raises(InvalidInput, match=words) as caught:
            coarse(**options)
        assert "\n" not in str(caught.value)
        if group == "course" and options["course"] != RISE:
            assert str(caught.value).endswith("Correct the course.")


def test_inertia_has_no_sensitivities():
    with pytest.raises(InvalidInput, match="got sensitivities with motion: transient; expected motion: quasi_static"):
        with_sensitivities(coarse(**course(motion="transient")))


def test_options_as_objects_are_taken_as_they_are():
    model = coarse(**anchors(viscosity=[9e-4, 11e-4]), fluid={"viscosity": "unknown"}, partition=Partition())
    assert (type(model.fluid), type(model.partition)) == (Fluid, Partition)
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
    ],
)
def test_a_law_that_is_wrong_at_rest(own, coefficients, words):
    vars(importlib.import_module(own))["BENT"] = coefficients
    with pytest.raises(InvalidInput, match=re.escape(words)):
        law_named(f"{own}:Bent")


def test_parameters_of_a_law_out_of_range_in_a_study(tmp_path):
    for law, values, words in (
        ("mooney_rivlin", {"share": 1.2}, r"share \(share of the second invariant, c2 / \(c1 \+ c2\)\) in \[0, 1\]"),
        ("yeoh", {"second": 1}, "no value for third"),
    ):
        folder = write_study(
            tmp_path / law,
            model={"biofilm": {"mesh": "coarse", "material": law}},
            fixed={"V_in": 100, "nu": 0.3, **values},
            inputs={"E": {"prior": {"uniform": [100, 800]}, "unit": "Pa"}},
            observation={"synthetic": {"E": 400}},
        )
        with pytest.raises(InvalidInput, match=words):
            load_study(folder)


EARLIER = {
    "biofilm:r2:mesh=default": {"mesh": "default"},
    "biofilm:r2:mesh=coarse:16696130e17337a5": {"material": "neo_hookean"},
    "biofilm:r2:mesh=coarse:5ccd804850463b5a": {"partition": "three_parts"},
    "biofilm:r2:mesh=coarse:7e57dc79f9e323a3": {"channel": {"inlet": "right", "outlet": "traction_free"}},
    "biofilm:r2:mesh=coarse:eeeb15a0cff228d5": {"inflow_rates": {"slow": 50, "fast": 100}},
}
OTHERS = [
    {},
    {"channel": {"length": 2.5}},
    {"channel": {"top": "slip"}},
    {"fluid": {"viscosity": 0.9e-3}},
    {"fluid": {"viscosity": "unknown"}},
    {"inflow": "plug"},
    {"inflow": "pressure"},
    {"inflow": "pressure", "pressure_drops": {"low": 4, "high": 8}},
    table([0, 1], [1, 1]),
    *({"clamped": [stretch]} for stretch in ([0.54, 1.391], [0.7, 1.2])),
    {"failure_budget": 0},
    *(anchors(E=[100, highest]) for highest in (800, 700)),
    {"course": STEP},
    {"course": STEP | {"times": {"a": 1.0, "b": 4.0}}},
    {"course": STEP | {"tolerance": 0.01}},
    {"course": STEP | {"inflow": [[0, 0], [0, 0.9], [5, 0.9]]}},
    {"course": STEP | {"inflow": [[0, 0], [5, 1]], "motion": "transient"}},
    *({"course": STEP, "branches": number} for number in (1, 2)),
]


def test_ledgers_of_earlier_versions_stay_readable():
    """New options count only where they differ from their defaults."""
    assert {coarse(**options).fingerprint: options for options in EARLIER.values()} == EARLIER
    same = [{"sensitivities": True}, {"fluid": {"viscosity": 1e-3, "density": 1000}}]
    assert {coarse(**options).fingerprint for options in same} == {coarse().fingerprint}


def test_all_that_changes_results_counts(own, tmp_path):
    found = [fingerprint(coarse(**options)) for options in [*OTHERS, *EARLIER.values()]]
    options = [{"material": f"{own}:plain"}, {"material": f"{own}:other"}, {"inflow": f"{own}:profile"}]
    found += [fingerprint(coarse(**one)) for one in options]
    (tmp_path / f"{own}.py").write_text(OWN + "\n# another comment\n", "utf-8")
    found += [fingerprint(coarse(**one)) for one in options]
    assert len(set(found)) == len(found)


def test_the_rule_for_element_sizes_counts_where_it_acts(monkeypatch):
    bump = {"points": [[0.5, 0.0], [0.8, 0.12], [1.0, 0.14], [1.5, 0.0]]}
    for options, acts in (({"outline": bump}, False), ({"channel": {"length": 3.0}, "outline": LAYER}, True)):
        model = Biofilm.from_options(**options)
        with monkeypatch.context() as patch:
            patch.setattr("strandline.models.biofilm.model._is_adapted", lambda *_: False)
            without = model.fingerprint
        assert (model.fingerprint != without) == acts
