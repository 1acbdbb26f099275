"""The registry, the protocol and what every measure shares."""

import dataclasses

import pytest
from tests.unit.discrepancy.curves import level
from tests.unit.discrepancy.surfaces import sheet

import strandline.discrepancy as package
from strandline.discrepancy import DISCREPANCIES, Currents, Discrepancy, MeasurementLines, independent_terms, unit_of
from strandline.errors import InvalidInterface
from strandline.interface import Interface

LINE = level(0.0, 3, length=2.0)


@pytest.mark.parametrize("name", DISCREPANCIES)
def test_every_measure_satisfies_the_protocol_and_knows_surfaces(name: str) -> None:
    measure = DISCREPANCIES[name](**({"width": 0.2} if name == "currents" else {}))
    assert isinstance(measure, Discrepancy)
    assert unit_of(measure) == unit_of(measure, LINE) == "mm²"
    assert independent_terms(measure, LINE) is None or independent_terms(measure, LINE) > 0
    assert isinstance(measure(LINE, LINE), float)
    twin = dataclasses.replace(measure)
    assert twin is not measure
    assert twin == measure
    assert hash(twin) == hash(measure)
    simulated, observed = sheet(4, height=0.1), sheet(4)
    if isinstance(measure, MeasurementLines):
        with pytest.raises(InvalidInterface, match="plane"):
            measure(simulated, observed)
        return
    assert measure(simulated, observed) > 0
    assert measure(observed, observed) == pytest.approx(0.0, abs=1e-12)
    assert unit_of(measure, observed) == ("mm⁴" if isinstance(measure, Currents) else "mm²")


def test_a_plain_function_states_neither_unit_nor_terms() -> None:
    def measure(simulated: Interface, observed: Interface) -> float:
        return 0.0

    assert unit_of(measure) == ""
    assert independent_terms(measure, LINE) is None


def test_public_names_exist() -> None:
    assert sorted(package.__all__) == sorted(set(package.__all__))
    assert all(hasattr(package, name) for name in package.__all__)
    assert {cls.__name__ for cls in DISCREPANCIES.values()} <= set(package.__all__)
