"""Options of the biofilm model: what is refused, in one line that names the place, and what a fingerprint counts."""

import importlib
import re

import pytest
from tests.unit.models.biofilm.cells import LAYER, OWN, PAIR, coarse

from strandline.foundations import InvalidInput
from strandline.models.biofilm.materials import law_named
from strandline.models.biofilm.model import Biofilm
from strandline.models.identity import fingerprint
from strandline.studies.keys.parse import made

TWO = {"channel": {"length": 4.0}, "outline": {"points": PAIR}}
RANGES = {"E": [100, 800], "nu": [-0.8, 0.5], "V_in": 100}
RISE = {"inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]], "times": {"half": 0.05, "late": 0.3}}
STEP = {"inflow": [[0, 0], [0, 1], [5, 1]], "times": {"a": 1.0, "b": 5.0}}
CREEPING = {"course": STEP, "branches": 1}


def outline(*points, **options):
    return {"outline": {"points": list(points), "spline": False, "nodes": None, **options}}


def cut(markers, lines=()):
    return {"partition": {"lines": list(lines), "markers": markers}}


def table(*points):
    return {"inflow": {"table": list(points)}}


def anchors(**changes):
    return {"anchors": RANGES | changes}


def course(**changes):
    return {"course": RISE | changes}


REFUSED = {
    "mesh and channel": [
        ({"mesh": "corse"}, "coarse, default, fine"),
        ({"failure_budget": 2}, "failure_budget"),
        ({"channel": {"height": "1.5 mm"}}, "channel.height: got 1.5 mm; expected a number"),
    ],
    "outline": [
        (outline((0.5, 0.1), (1.0, 0.5), (1.5, 0.0)), r"end of the outline.*\(0.5, 0.1\)"),
        (outline((0.5, 0.0), (1.0, 1.2), (1.5, 0.0)), r"outside the channel.*\(1, 1.2\)"),
        (outline((0.5, 0.0), (1.2, 0.5), (1.2, 0.2), (0.7, 0.4), (1.5, 0.0)), r"cross.*\(0.930769, 0.307692\)"),
        (outline((1.5, 0.0), (1.0, 0.5), (0.5, 0.0)), r"direction.*\(1.5, 0\)"),
        (outline((0.5, 0.0), (1.0, 0.5), (2.0, 0.0)), r"\(2, 0\)"),
        ({"outline": "hill.csv"}, "outline: got hill.csv; expected keys with values"),
        (outline((0.3, 0), (0.5, 0.3), (0.7, 0), (1, 0.3), (1.3, 0)), "two neighbouring points on the floor"),
        (outline((0.3, 0), (0.5, 0.3), (0.7, 0), (0.8, 0), (0.9, 0), (1.3, 0)), r"got 1 point\(s\) from \(0.8, 0\) mm"),
    ],
    "parts and foot": [
        ({"partition": "three_parts", **outline((0.2, 0), (0.4, 0.5), (0.7, 0))}, "the study's outline"),
        (cut([[0.9, 0.3], [0.9, 0.31]], [((0.4, 0.1), (1.5, 0.1))]), "of its own"),
        ({**TWO, **cut([[0.95, 0.1]])}, "expected 2"),
        ({"clamped": [[0.6, 0.9], [0.8, 1.0]]}, "from left to right"),
        ({"clamped": [[1.5, 1.9]]}, "got 1.5 to 1.9 mm.*stands from 0.54 to 1.391 mm"),
    ],
    "fluid and inflow": [
        ({"fluid": {"viscosity": 0}}, r"viscosity of the fluid: got 0.*a number in \(0, inf\), in Pa s"),
        (table([0, 1], [0.5, 2], [0.5, 1], [1, 0]), "y = 0.5 mm after 0.5 mm"),
        (table([0.1, 1], [1, 1]), "covers the inlet, from 0 to 1 mm"),
        (table([0, 0], [1, 0]), "no net inflow"),
        (table([0, 0], [0.5, -2], [1, 0]), r"got -2 at y = 0.5 mm.*velocities that enter"),
        ({"inflow": "our_model:wrong"}, r"one velocity for each height"),
        ({"inflow": "pressure", "inflow_rates": {"slow": 1}}, "or give `pressure_drops` by condition"),
        (
            {"pressure_drops": {"low": 5}},
            "pressure_drops of the biofilm model: got inflow: parabola; expected inflow: p",
        ),
        ({"inflow": "pressure", "pressure_drops": {"low": -5}}, "pressure drop 'low' of the biofilm model: got -5"),
    ],
    "law": [
        ({"material": "our_model:number"}, "our_model:number of the biofilm model: got 3"),
        ({"material": "our_model:Bad"}, "got k2"),
        ({"material": "our_model:WithoutCoefficients"}, "abstract class WithoutCoefficients"),
    ],
    "anchors": [
        (anchors(V_in=[0, 100]), r"\(0, inf\)"),
        ({"anchors": {"E": [100, 800], "nu": 0.3}}, "got no V_in;"),
        (anchors(Ee=3), "Ee, which is no input"),
        (anchors(E=[800, 100]), "E in the anchors"),
        ({"anchors": {"E": 400, "nu": 0.3, "V_in": 100}}, "at least one input that varies"),
        ({**anchors(), "course": RISE}, "no course"),
    ],
    "course": [
        (course(times=[0.2, 0.1]), "times in the course of the biofilm model: got 0.1 s after 0.2 s; expected times"),
        (course(times=[0.1, 0.4]), "got 0.4 s; expected times inside the course, from 0 to 0.3 s"),
        (course(inflow=[[0, 0], [0.5, 1], [0.4, 2]]), "times of the inflow in the course .* got 0.4 s after 0.5 s"),
        (course(inflow=[[0, 0], [0.5, -1]]), "got share -1 at 0.5 s; expected shares of V_in, 0 or above"),
        (course(tolerance=0.5), "expected a share above 0, at most 0.1"),
        (course(**STEP, motion="transient"), "0 s after 0 s"),
        ({"course": RISE, "inflow_rates": {"slow": 50}}, "a course with inflow_rates or pressure_drops; expected one"),
        (course(motion="transient") | {"sensitivities": True}, "got sensitivities with motion: transient"),
        (CREEPING | {"branches": 4}, "a whole number from 0 to 3"),
        (CREEPING | course(motion="transient"), "branches: 1 with motion: transient"),
        ({"branches": 1}, "branches: 1 with no course"),
        (CREEPING | {"sensitivities": True}, "sensitivities with branches: 1"),
    ],
}


@pytest.mark.parametrize("group", REFUSED)
def test_options_that_cannot_be_used(own, group):
    for options, words in REFUSED[group]:
        with pytest.raises(InvalidInput, match=words) as caught:
            coarse(**options)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("coefficients", "words"),
    [
        (lambda i, v, p, m: (m, p - m), "coefficients that cannot be computed: ValueError: not enough values"),
        (lambda i, v, p, m: (2 * m, 0.0, p - 2 * m), "beta - gamma at rest: 4 in place of 2"),
        (lambda i, v, p, m: (m, 0.0, 2 * p - m), "change of the stress at rest with the pressure: 2 in place of 1"),
    ],
)
def test_a_law_that_is_wrong_at_rest(own, coefficients, words):
    vars(importlib.import_module(own))["BENT"] = coefficients
    with pytest.raises(InvalidInput, match=re.escape(words)):
        law_named(f"{own}:Bent")


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
        model = made(Biofilm, options, "model.biofilm")
        with monkeypatch.context() as patch:
            patch.setattr("strandline.models.biofilm.model._is_adapted", lambda *_: False)
            without = model.fingerprint
        assert (model.fingerprint != without) == acts
