"""A surrogate of the user's: the Gaussian process behind another face, which knows neither JAX nor derivatives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.study.calibration.beams import NOISE, SETTINGS, answer, exact, problem

from strandline.calibration import Calibration
from strandline.design.refinement import Refinement
from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.surrogate import fit_log_likelihood

SPACE = ParameterSpace(
    (Parameter("E", Uniform(300.0, 560.0), "Pa"), Parameter("tilt", Uniform(0.0, 0.04), nuisance=True))
)


class Plain:
    """Mean and variance of a Gaussian process."""

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        self.process = fit_log_likelihood(x, y).process

    def mean(self, x: np.ndarray) -> np.ndarray:
        return self.process.mean(x)

    def variance(self, x: np.ndarray) -> np.ndarray:
        return self.process.variance(x)


def none_at_all(x: np.ndarray, y: np.ndarray) -> float:
    """Return no surrogate."""
    return float(y.mean())


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    refined = replace(SETTINGS, refine=Refinement(1, 16), nuisance_values=4, fit=f"{__name__}:Plain")
    return answer(tmp_path_factory.mktemp("own") / "ledger.sqlite", problem(space=SPACE), refined)


def test_the_posterior_is_exact_integrated_and_has_a_laplace_approximation(own: Calibration) -> None:
    mean_error, sd_error, evidence_error = exact(SPACE, NOISE).off(own)
    assert mean_error < 0.2
    assert sd_error < 0.15
    assert evidence_error < 0.2
    assert own.quadrature is not None
    assert (np.abs(own.posterior.mean - own.quadrature.mean) < 0.15 * own.quadrature.sd).all()
    assert own.laplace.definite
    assert own.cut_quadrature is not None
    assert own.under_uncertainty is not None
    pooled = np.mean([one.mean[0] for one in own.cut_quadrature])
    assert own.under_uncertainty.cut.mean[0] == pytest.approx(pooled, abs=0.2 * own.posterior.sd[0])


def test_it_is_validated_on_runs_that_it_has_not_seen(own: Calibration) -> None:
    built_in = fit_log_likelihood(own.training, own.log_likelihoods["tracked"]).validation
    assert len(own.records) == 48
    assert (own.surrogate.fit, len(own.surrogate.validation.residuals)) == (None, len(own.training))
    assert 0 < own.surrogate.validation.loo_rms < 100 * built_in.loo_rms


def test_what_is_no_surrogate_is_refused(tmp_path: Path) -> None:
    for name, said in (
        ("none_at_all", "mean and variance"),
        ("SPACE", "a function of inputs"),
        ("missing", "a name defined in"),
    ):
        with pytest.raises(InvalidInput, match=said):
            answer(tmp_path / "ledger.sqlite", problem(space=SPACE), replace(SETTINGS, fit=f"{__name__}:{name}"))
