"""The study folders that come along: they load, and those on the same specimen need the same forward runs."""

from functools import cache
from pathlib import Path

from strandline.studies import Study, load_study

STUDIES = Path(__file__).parents[3] / "studies"
NAMES = sorted(path.parent.name for path in STUDIES.glob("*/study.yaml"))
REFINED = ("biofilm-uniform-refined", "biofilm-inflow-refined", "biofilm-parts-refined")


@cache
def shipped(name: str) -> Study:
    return load_study(STUDIES / name)


def test_each_loads_under_its_own_name() -> None:
    assert {"biofilm-uniform", "biofilm-informed", "biofilm-measures", "biofilm-parts", *REFINED} <= set(NAMES)
    assert [shipped(name).name for name in NAMES] == NAMES


def test_studies_of_one_specimen_need_the_same_forward_runs() -> None:
    sources = {name: name.removesuffix("-refined") for name in REFINED}
    for name, source in {
        **sources,
        "biofilm-informed": "biofilm-uniform",
        "biofilm-measures": "biofilm-uniform",
    }.items():
        study, first = shipped(name), shipped(source)
        assert study.runs.needed_keys == first.runs.needed_keys
        assert [path.resolve() for path in study.reuse] == [first.ledger_path]


def test_an_active_variant_asks_the_same_question_with_fewer_runs() -> None:
    for refined in REFINED:
        study, published = shipped(refined.replace("refined", "active")), shipped(refined)
        assert (study.settings.surrogate, published.settings.surrogate) == ("field", "log_likelihood")
        assert study.settings.planned_runs <= published.settings.planned_runs / 5
        for question in ("model", "space", "fixed", "truth", "synthetic_noise", "noise", "noises", "discrepancies"):
            assert getattr(study, question) == getattr(published, question), question
        assert study.reuse == ()


def test_the_heterogeneous_specimen_is_the_publications() -> None:
    """Ground truth, noise and settings of its last example."""
    truth = {"E1": 500, "nu1": 0.2, "E2": 200, "nu2": 0.1, "E3": 1000, "nu3": 0.3, "V_in": 100}
    for name, quadrature in (("biofilm-parts", "centre"), ("biofilm-parts-refined", "refined")):
        study = shipped(name)
        assert study.truth == truth
        assert study.synthetic_noise is not None
        assert study.synthetic_noise.sd == 0.001
        assert all(low < truth[p.name] < high for p in study.space for low, high in [p.interval])
        assert study.space["V_in"].prior.quantile(1.0) == 110
        settings = study.settings
        assert (settings.runs, settings.particles, settings.kernel) == (2000, 10_000, "matern32_product")
        assert (settings.smc.rejuvenation_steps, settings.smc.zeta) == (30, 0.998)
        assert study.discrepancies["currents"].quadrature == quadrature  # type: ignore[attr-defined]
