"""The study folders that come along: they load, and need no forward runs but those of biofilm-uniform."""

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


@pytest.mark.parametrize("name", ["biofilm-informed", "biofilm-measures", "biofilm-uniform-refined"])
def test_it_needs_the_same_forward_runs(name: str) -> None:
    study, first = load_study(STUDIES / name), load_study(STUDIES / "biofilm-uniform")
    assert needed_keys(study) == needed_keys(first)
    assert [path.resolve() for path in study.reuse] == [first.ledger_path]
