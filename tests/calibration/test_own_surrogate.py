"""A surrogate of the user's: the Gaussian process behind another face, which knows neither JAX nor derivatives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strandline.calibration import Calibration, Problem, Settings, calibrate
from strandline.design.refinement import Refinement
from strandline.discrepancy import TrackedPoints
from strandline.errors import InvalidInput
from strandline.interface import Observation
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Normal, Uniform
from strandline.smc import SMCSettings
from strandline.surrogate import fit_log_likelihood
from strandline.testing.studies import beam

TRUTH = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
SETTINGS = Settings(
    runs=30,
    particles=2000,
    smc=SMCSettings(rejuvenation_steps=5, zeta=0.6),
    refine=Refinement(1, 10),
    nuisance_values=4,
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


def problem() -> Problem:
    tilt = Parameter("tilt", Normal(0.02, 0.004), box=(0.0, 0.04), nuisance=True)
    space = ParameterSpace((Parameter("E", Uniform(300.0, 560.0), "Pa"), tilt))
    observation = Observation(beam(TRUTH, Path()).interface, 0.003**2)
    return Problem(beam, space, {"load": 1e-5}, (observation,), {"tracked": TrackedPoints()})


@pytest.fixture(scope="module")
def both() -> tuple[Calibration, Calibration]:
    own = replace(SETTINGS, fit=f"{__name__}:Plain")
    return calibrate(problem(), SETTINGS), calibrate(problem(), own)


def test_the_posterior_is_that_of_the_same_surrogate_built_in(both: tuple[Calibration, Calibration]) -> None:
    built_in, own = both
    assert (np.abs(own.posterior.mean - built_in.posterior.mean) < 0.15 * built_in.posterior.sd).all()
    np.testing.assert_allclose(own.posterior.sd, built_in.posterior.sd, rtol=0.1)
    assert own.posterior.log_evidence == pytest.approx(built_in.posterior.log_evidence, abs=0.1)


def test_it_is_integrated_and_has_a_laplace_approximation(both: tuple[Calibration, Calibration]) -> None:
    _, own = both
    assert own.quadrature is not None
    assert (np.abs(own.posterior.mean - own.quadrature.mean) < 0.15 * own.quadrature.sd).all()
    assert own.laplace.definite
    assert own.cut_quadrature is not None
    assert own.under_uncertainty is not None
    pooled = np.mean([one.mean[0] for one in own.cut_quadrature])
    assert own.under_uncertainty.cut.mean[0] == pytest.approx(pooled, abs=0.2 * own.posterior.sd[0])


def test_it_is_validated_on_runs_that_it_has_not_seen(both: tuple[Calibration, Calibration]) -> None:
    built_in, own = both
    assert (own.surrogate.fit, len(own.surrogate.validation.residuals)) == (None, len(own.training))
    assert own.surrogate.validation.loo_rms > 0
    assert own.surrogate.validation.loo_rms < 100 * built_in.surrogate.validation.loo_rms


@pytest.mark.parametrize(
    ("name", "said"),
    [("none_at_all", "mean and variance"), ("SETTINGS", "a function of inputs"), ("missing", "a name defined in")],
)
def test_what_is_no_surrogate_is_refused(name: str, said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        calibrate(problem(), replace(SETTINGS, fit=f"{__name__}:{name}"))
