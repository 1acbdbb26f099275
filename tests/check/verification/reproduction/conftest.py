"""A table of interfaces of a model with a closed form."""

from collections.abc import Callable, Iterator

import pytest
from verification.reproduction.field_table import FieldTable, LoadCoordinates, tabulate

from strandline.runs import InProcess, Ledger
from strandline.testing.folding import Folding

MODEL = Folding(softness=0.97)
"""Its fold is 3 % away from the one that the coordinates are told."""
BOX = LoadCoordinates(fold=Folding.FOLD, reach=0.9, inertia=None)


@pytest.fixture(scope="session")
def model() -> Folding:
    return MODEL


@pytest.fixture(scope="session")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ledger]:
    with Ledger.open(tmp_path_factory.mktemp("table") / "ledger.sqlite", model=MODEL) as ledger:
        yield ledger


@pytest.fixture(scope="session")
def make_table(ledger: Ledger) -> Callable[[tuple[int, int, int]], FieldTable]:
    def make(intervals: tuple[int, int, int]) -> FieldTable:
        reference = MODEL.undeformed()
        return tabulate(MODEL, reference, intervals=intervals, ledger=ledger, executor=InProcess(), coordinates=BOX)

    return make


@pytest.fixture(scope="session")
def table(make_table: Callable[[tuple[int, int, int]], FieldTable]) -> FieldTable:
    return make_table((12, 6, 2))
