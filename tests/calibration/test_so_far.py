"""The posterior of the runs so far against quadrature of the true model, and against a planted fault."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp

import strandline as sl
from strandline.calibration.so_far import posterior_so_far
from strandline.design.active import Knowledge
from strandline.numerics.precision import use_double
from strandline.posterior.weighted import Weighted
from strandline.questions.knowledge import field_knowledge
from strandline.studies.first_run import observations_of
from strandline.testing.studies import beam, write_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> sl.Study:
    folder = write_study(tmp_path_factory.mktemp("so-far") / "beam", design={"sobol": {"runs": 24}})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("strandline.studies.run.write_report", lambda *given, folder, **others: folder / "report.html")
        sl.run_study(sl.load_study(folder), executor=sl.InProcess())
    use_double()
    return sl.load_study(folder)


@pytest.fixture(scope="module")
def knowledge(study: sl.Study) -> Knowledge:
    return field_knowledge(study, "tracked_points")


@pytest.fixture(scope="module")
def exact(study: sl.Study) -> tuple[Weighted, float]:
    """The posterior of the true model on a grid, and its log-evidence."""
    observed = study.observations(observations_of(study))
    likelihood = sl.InterfaceLikelihood(observed, study.discrepancies["tracked_points"])
    low, high = study.space.low, study.space.high
    middles = [a + (b - a) * (np.arange(90) + 0.5) / 90 for a, b in zip(low, high, strict=True)]
    x = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    runs = (beam({**study.fixed, "E": E, "tilt": tilt}, Path()).interfaces for E, tilt in x.tolist())
    log_density = np.array([likelihood(run) for run in runs]) + np.asarray(study.space.log_prior(x))
    cell = float(np.prod((high - low) / 90))
    return Weighted(x, np.exp(log_density - logsumexp(log_density))), float(logsumexp(log_density) + np.log(cell))


def test_it_is_the_posterior_of_the_true_model(
    study: sl.Study, knowledge: Knowledge, exact: tuple[Weighted, float]
) -> None:
    true, log_evidence = exact
    found = posterior_so_far(knowledge, study.space, seed=1)
    assert np.abs((found.mean - true.mean) / true.sd).max() < 0.1
    assert np.abs(np.log(found.sd / true.sd)).max() < 0.08
    assert found.log_evidence == pytest.approx(log_evidence, abs=0.1)
    assert found.quality is not None
    assert found.quality.good


def test_the_same_seed_gives_the_same_draws(study: sl.Study, knowledge: Knowledge) -> None:
    one, two, other = (posterior_so_far(knowledge, study.space, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.draws, two.draws)
    assert not np.array_equal(one.draws, other.draws)


def test_half_the_likelihood_would_be_noticed(
    study: sl.Study, knowledge: Knowledge, exact: tuple[Weighted, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the draws are not weighted by the likelihood that they lack."""
    nearly = Knowledge.nearly_expected
    monkeypatch.setattr(Knowledge, "nearly_expected", lambda self, x: 0.5 * nearly(self, x))
    monkeypatch.setattr(Knowledge, "expected", lambda self, x, plug_in=None: 0.5 * nearly(self, x))
    found = posterior_so_far(knowledge, study.space, seed=1)
    assert np.abs(np.log(found.sd / exact[0].sd)).max() > 0.08
