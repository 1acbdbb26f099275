"""The study folders that come along: they load, and those on the same specimen need the same forward runs."""

from pathlib import Path
from typing import Any

import pytest

from strandline.studies import load_study

STUDIES = Path(__file__).parents[2] / "studies"
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/study.yaml"))


def test_there_are_some() -> None:
    assert {"biofilm-uniform", "biofilm-informed", "biofilm-measures", "biofilm-parts", "biofilm-parts-refined"} <= set(
        NAMES
    )


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
        ("biofilm-parts-refined", "biofilm-parts"),
    ],
)
def test_it_needs_the_same_forward_runs(name: str, source: str) -> None:
    study, first = load_study(STUDIES / name), load_study(STUDIES / source)
    assert study.runs.needed_keys == first.runs.needed_keys
    assert [path.resolve() for path in study.reuse] == [first.ledger_path]


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("biofilm-uniform-active", "biofilm-uniform-refined"),
        ("biofilm-inflow-active", "biofilm-inflow-refined"),
        ("biofilm-parts-active", "biofilm-parts-refined"),
    ],
)
def test_an_active_variant_asks_the_same_question_with_fewer_runs(name: str, source: str) -> None:
    study, published = load_study(STUDIES / name), load_study(STUDIES / source)
    assert (study.settings.surrogate, published.settings.surrogate) == ("field", "log_likelihood")
    assert study.settings.planned_runs <= published.settings.planned_runs / 5
    for question in ("model", "space", "fixed", "truth", "synthetic_noise", "noise", "noises", "discrepancies"):
        assert getattr(study, question) == getattr(published, question), question
    assert study.reuse == ()


def test_the_heterogeneous_specimen_is_the_publications() -> None:
    """Ground truth, noise and settings of its last example."""
    studies = [load_study(STUDIES / name) for name in ("biofilm-parts", "biofilm-parts-refined")]
    truth = {"E1": 500, "nu1": 0.2, "E2": 200, "nu2": 0.1, "E3": 1000, "nu3": 0.3, "V_in": 100}
    for study in studies:
        assert study.truth == truth
        assert study.synthetic_noise is not None
        assert study.synthetic_noise.sd == 0.001
        assert all(low < truth[p.name] < high for p in study.space for low, high in [p.interval])
        assert study.space["V_in"].prior.quantile(1.0) == 110
        settings = study.settings
        assert (settings.runs, settings.particles, settings.kernel) == (2000, 10_000, "matern32_product")
        assert (settings.smc.rejuvenation_steps, settings.smc.zeta) == (30, 0.998)
    measures: list[Any] = [study.discrepancies["currents"] for study in studies]
    assert [measure.quadrature for measure in measures] == ["centre", "refined"]
