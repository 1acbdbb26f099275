"""The study folders that come along: they load, and variants take the forward runs of the first of their kind."""

from pathlib import Path

import pytest

from strandline.studies import load_study
from strandline.studies.ledgers import needed_keys

STUDIES = Path(__file__).parents[2] / "studies"
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/study.yaml"))


def test_there_are_some() -> None:
    assert {"biofilm-uniform", "biofilm-informed", "biofilm-measures"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_it_loads_under_its_own_name(name: str) -> None:
    assert load_study(STUDIES / name).name == name


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("biofilm-informed", "biofilm-uniform"),
        ("biofilm-measures", "biofilm-uniform"),
        ("biofilm-uniform-refined", "biofilm-uniform"),
        ("biofilm-inflow-refined", "biofilm-inflow"),
    ],
)
def test_it_needs_the_same_forward_runs(name: str, source: str) -> None:
    study, first = load_study(STUDIES / name), load_study(STUDIES / source)
    assert needed_keys(study) == needed_keys(first)
    assert [path.resolve() for path in study.reuse] == [first.ledger_path]
