import pytest
from verification.reproduction.field_table import LoadCoordinates, tabulate

from strandline.runs import InProcess, Ledger
from strandline.testing.folding import Folding

MODEL = Folding(softness=0.97)
"""Its fold is 3 % away from the one that the coordinates are told."""
BOX = LoadCoordinates(fold=Folding.FOLD, reach=0.9, inertia=None)


@pytest.fixture(scope="session")
def model():
    return MODEL


@pytest.fixture(scope="session")
def ledger(tmp_path_factory):
    with Ledger.open(tmp_path_factory.mktemp("table") / "ledger.sqlite", model=MODEL) as ledger:
        yield ledger


@pytest.fixture(scope="session")
def make_table(ledger):
    def make(intervals):
        reference = MODEL.undeformed()
        return tabulate(MODEL, reference, intervals=intervals, ledger=ledger, executor=InProcess(), coordinates=BOX)

    return make


@pytest.fixture(scope="session")
def table(make_table):
    return make_table((12, 6, 4))
