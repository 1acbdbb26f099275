"""The registry, the protocol and what every measure shares."""

import dataclasses

import numpy as np
import pytest

import strandline.discrepancy as package
from strandline.discrepancy import DISCREPANCIES, Discrepancy, independent_terms, unit_of
from strandline.errors import InvalidInterface
from strandline.interface import Interface

OPTIONS = {"currents": {"width": 0.01}}
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


@pytest.mark.parametrize("name", sorted(set(DISCREPANCIES) - {"tracked_points"}))
def test_surfaces_are_refused(name):
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    surface = Interface(corners, np.array([[0, 1, 2]]))
    with pytest.raises(InvalidInterface, match="plane"):
        DISCREPANCIES[name](**OPTIONS.get(name, {}))(surface, surface)


def test_public_names_exist():
    assert sorted(package.__all__) == sorted(set(package.__all__))
    assert all(hasattr(package, name) for name in package.__all__)
    assert {cls.__name__ for cls in DISCREPANCIES.values()} <= set(package.__all__)
