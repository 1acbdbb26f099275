"""The fingerprint of the biofilm model: what tells ledgers apart, and what must not."""

from pathlib import Path
from typing import Any

import pytest
from tests.unit.models.biofilm.cells import coarse, importable

from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import fingerprint

EARLIER: dict[str, dict[str, Any]] = {
    "biofilm:r2:mesh=default": {"mesh": "default"},
    "biofilm:r2:mesh=coarse:16696130e17337a5": {"material": "neo_hookean"},
    "biofilm:r2:mesh=coarse:5ccd804850463b5a": {"partition": "three_parts"},
    "biofilm:r2:mesh=coarse:7e57dc79f9e323a3": {"channel": {"inlet": "right", "outlet": "traction_free"}},
    "biofilm:r2:mesh=coarse:eeeb15a0cff228d5": {"inflow_rates": {"slow": 50, "fast": 100}},
}
COURSE: dict[str, Any] = {"inflow": [[0, 0], [0, 1], [5, 1]], "times": [1, 5]}
LAYER = {"points": [[0.0, 0.3], [0.8, 0.35], [1.5, 0.6], [2.2, 0.35], [3.0, 0.3]]}
OTHERS: list[dict[str, Any]] = [
    {},
    {"channel": {"length": 2.5}},
    {"channel": {"top": "slip"}},
    {"fluid": {"viscosity": 0.9e-3}},
    {"fluid": {"viscosity": "unknown"}},
    {"inflow": "plug"},
    {"inflow": "pressure"},
    {"inflow": "pressure", "pressure_drops": {"low": 4, "high": 8}},
    {"inflow": {"table": [[0, 1], [1, 1]]}},
    {"clamped": [[0.54, 1.391]]},
    {"clamped": [[0.7, 1.2]]},
    {"failure_budget": 0},
    {"anchors": {"E": [100, 800], "nu": 0.3, "V_in": 100}},
    {"anchors": {"E": [100, 700], "nu": 0.3, "V_in": 100}},
    {"course": COURSE},
    {"course": COURSE | {"times": [1, 4]}},
    {"course": COURSE | {"tolerance": 0.01}},
    {"course": COURSE | {"inflow": [[0, 0], [0, 0.9], [5, 0.9]]}},
    {"course": COURSE | {"inflow": [[0, 0], [5, 1]], "motion": "transient"}},
    {"course": COURSE, "branches": 1},
    {"course": COURSE, "branches": 2},
]


def test_ledgers_of_earlier_versions_stay_readable() -> None:
    """New options count only where they differ from their defaults."""
    for expected, options in EARLIER.items():
        assert coarse(**options).fingerprint == expected
    same = [{"sensitivities": True}, {"fluid": {"viscosity": 1e-3, "density": 1000}}]
    assert {coarse(**options).fingerprint for options in same} == {coarse().fingerprint}


def test_all_that_changes_results_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [fingerprint(coarse(**options)) for options in [*OTHERS, *EARLIER.values()]]
    assert len(set(found)) == len(found)
    source = """
from strandline.models.biofilm.materials import LAWS

def plain(d, solid_pressure, young, poisson):
    return LAWS["neo_hookean"](d, solid_pressure, young, poisson)

def other(d, solid_pressure, young, poisson):
    return LAWS["neo_hookean"](d, solid_pressure, 2 * young, poisson)

def profile(y, bottom, top):
    return y - bottom
"""
    own = importable(tmp_path, monkeypatch, "our_fingerprints", source)
    options = [{"material": f"{own}:plain"}, {"material": f"{own}:other"}, {"inflow": f"{own}:profile"}]
    found += [fingerprint(coarse(**one)) for one in options]
    (tmp_path / f"{own}.py").write_text(source + "\n# another comment\n", "utf-8")
    found += [fingerprint(coarse(**one)) for one in options]
    assert len(set(found)) == len(found)


def test_the_rule_for_element_sizes_counts_where_it_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    bump = {"points": [[0.5, 0.0], [0.8, 0.12], [1.0, 0.14], [1.5, 0.0]]}
    for options, acts in (({"outline": bump}, False), ({"channel": {"length": 3.0}, "outline": LAYER}, True)):
        model = Biofilm.from_options(**options)
        with monkeypatch.context() as patch:
            patch.setattr("strandline.models.biofilm.model._is_adapted", lambda *_: False)
            without = model.fingerprint
        assert (model.fingerprint != without) == acts
