"""The registry, the protocol and what every measure shares."""

import dataclasses

import numpy as np
import pytest
from tests.discrepancy.surfaces import sheet

import strandline.discrepancy as package
from strandline.discrepancy import (
    DISCREPANCIES,
    Currents,
    Discrepancy,
    MeasurementLines,
    independent_terms,
    unit_of,
)
from strandline.errors import InvalidInterface
from strandline.interface import Interface

OPTIONS = {"currents": {"width": 0.2}}
LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))


@pytest.fixture(params=DISCREPANCIES)
def measure(request):
    return DISCREPANCIES[request.param](**OPTIONS.get(request.param, {}))


def test_every_measure_satisfies_the_protocol(measure):
    assert isinstance(measure, Discrepancy)
    assert unit_of(measure) == "mm²"
    assert independent_terms(measure, LINE) is None or independent_terms(measure, LINE) > 0
    assert isinstance(measure(LINE, LINE), float)


def test_every_measure_can_key_a_cache(measure):
    twin = dataclasses.replace(measure)
    assert twin is not measure
    assert twin == measure
    assert hash(twin) == hash(measure)


def test_a_plain_function_states_neither_unit_nor_terms():
    def measure(simulated: Interface, observed: Interface) -> float:
        return 0.0

    assert unit_of(measure) == ""
    assert independent_terms(measure, LINE) is None


def test_all_measures_but_measurement_lines_know_surfaces(measure):
    simulated, observed = sheet(4, height=0.1), sheet(4)
    if isinstance(measure, MeasurementLines):
        with pytest.raises(InvalidInterface, match="plane"):
            measure(simulated, observed)
    else:
        assert measure(simulated, observed) > 0
        assert measure(observed, observed) == pytest.approx(0.0, abs=1e-12)
        assert unit_of(measure, observed) == ("mm⁴" if isinstance(measure, Currents) else "mm²")


def test_public_names_exist():
    assert sorted(package.__all__) == sorted(set(package.__all__))
    assert all(hasattr(package, name) for name in package.__all__)
    assert {cls.__name__ for cls in DISCREPANCIES.values()} <= set(package.__all__)
