"""The log-evidence against quadrature of the surrogate and of the true model, and its errors."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from tests.calibration.arches import SD, SPACE, arch, seen

from strandline.calibration import evidence
from strandline.calibration.evidence import Evidence, log_evidence, surrogate_error
from strandline.calibration.importance_sampler import Pool
from strandline.design import sobol
from strandline.design.active import Knowledge, learn
from strandline.discrepancy import NormalOffset
from strandline.interface import Observation, PointErrors
from strandline.likelihood import InterfaceLikelihood
from strandline.posterior import systematic_indices
from strandline.posterior.quadrature import integrate
from strandline.posterior.weighted import Weighted
from strandline.runs import RunRecord

SHARP = 0.0005
OBSERVED = Observation(seen(PointErrors(SD)), PointErrors(SD))


def learnt(runs: int, scramble: int, observed: Observation = OBSERVED) -> Knowledge:
    x = SPACE.to_physical(sobol(runs, 2, scramble=scramble))
    records = [RunRecord(str(k), SPACE.as_mapping(row), "ok", {"": arch(row)}) for k, row in enumerate(x)]
    return learn(x, records, SPACE, (observed,), NormalOffset())


def rough(log_likelihood: Callable[[np.ndarray], np.ndarray], number: int = 2000) -> Weighted:
    """Return weighted draws of the prior as a posterior."""
    x = SPACE.prior_quantiles(np.random.default_rng(0).random((number, 2)))
    values = log_likelihood(x)
    return Weighted(x, np.asarray(softmax(values)))


@pytest.fixture(scope="module")
def good() -> Knowledge:
    return learnt(24, 3)


def true_log_evidence(good: Knowledge) -> float:
    """Return the log-evidence of the arches themselves, by Gauss–Legendre quadrature where the posterior lies."""
    likelihood = InterfaceLikelihood(good.likelihood.observations, NormalOffset())
    nodes, weights = np.polynomial.legendre.leggauss(24)
    where = integrate(lambda x: learnt_log_density(good, x), SPACE.low, SPACE.high)
    low, high = (SPACE.to_unit(where.mean + side * where.sd) for side in (-6, 6))
    assert (low > 0).all()
    assert (high < 1).all()
    u = [a + (b - a) * 0.5 * (nodes + 1) for a, b in zip(low, high, strict=True)]
    values = np.array([[likelihood(arch(SPACE.to_physical(np.array([a, b])))) for b in u[1]] for a in u[0]])
    share = np.log(0.25 * np.prod(high - low) * np.outer(weights, weights))
    return float(logsumexp(values + share))


def errors_in_sampling_errors(knowledge: Knowledge, exact: float, number: int) -> np.ndarray:
    posterior = rough(knowledge.plug_in)
    found = [log_evidence(knowledge, SPACE, posterior, np.random.default_rng(seed)) for seed in range(number)]
    return np.array([(one.log - exact) / one.sampling for one in found])


@pytest.mark.parametrize("planted", ["", "prior not counted", "draws counted twice"])
def test_sampling_errors_are_what_they_say(good: Knowledge, planted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against quadrature of the same surrogate."""
    if planted == "prior not counted":
        plain = good.nearly_expected
        monkeypatch.setattr(Knowledge, "nearly_expected", lambda self, x: plain(x) - np.asarray(SPACE.log_prior(x)))
    elif planted:
        ratios = Pool.log_ratios.fget
        assert ratios is not None
        monkeypatch.setattr(Pool, "log_ratios", property(lambda self: ratios(self) + np.log1p(1 / 5)))
    exact = integrate(lambda x: learnt_log_density(good, x), SPACE.low, SPACE.high).log_evidence
    z = errors_in_sampling_errors(good, exact, 10)
    calibrated = bool(abs(z.mean()) < 1.2 and 0.3 < z.std() < 2.0)
    assert calibrated is (planted == "")


def learnt_log_density(knowledge: Knowledge, x: np.ndarray) -> np.ndarray:
    """Return log L p by other functions than those that importance sampling calls."""
    plug_in = knowledge.likelihood.plug_in(x)
    expected = plug_in + knowledge.likelihood.gain(x, plug_in) + knowledge.log_feasibility(x)
    return np.asarray(expected - np.log(np.prod(SPACE.high - SPACE.low)))


def test_it_is_that_of_the_true_model(good: Knowledge) -> None:
    true = true_log_evidence(good)
    found = log_evidence(good, SPACE, rough(good.plug_in), np.random.default_rng(1))
    assert found.log == pytest.approx(true, abs=3 * found.error + 0.01)
    assert found.error < 0.1
    assert found.error == pytest.approx(np.sqrt(found.sampling**2 + found.surrogate**2 + found.failing**2))


@pytest.fixture(scope="module")
def poor() -> list[tuple[Evidence, float]]:
    """Evidences by designs of few runs, for small errors of the data, and what they should be."""
    sharp = Observation(seen(PointErrors(SHARP)), PointErrors(SHARP))
    true, found = true_log_evidence(learnt(48, 3, sharp)), []
    for scramble in range(8):
        knowledge = learnt(6, scramble, sharp)
        one = log_evidence(knowledge, SPACE, rough(knowledge.plug_in), np.random.default_rng(scramble))
        found.append((one, true))
    return found


@pytest.mark.parametrize("planted", [False, True])
def test_a_poor_surrogate_says_how_far_the_evidence_may_be_off(
    poor: list[tuple[Evidence, float]], planted: bool
) -> None:
    """Planted: only the finite number of draws counts."""
    z = [(one.log - true) / (one.sampling if planted else one.error) for one, true in poor]
    rms = float(np.sqrt(np.mean(np.square(z))))
    assert (rms < 2.0) is not planted
    assert np.median([one.surrogate for one, _ in poor]) < 1.0, "no error is so large that it says nothing"


def test_the_error_grows_with_the_square_root_of_the_variance(good: Knowledge, monkeypatch: pytest.MonkeyPatch) -> None:
    """For small errors, the sd of ln Z is proportional to that of the field."""
    some = rough(good.plug_in)
    chosen, counts = np.unique(systematic_indices(some.weights, 60, np.random.default_rng(1)), return_counts=True)
    x = some.draws[chosen]
    shares = counts / 60
    small = surrogate_error(good, x, shares, np.random.default_rng(2))
    root = evidence._root
    monkeypatch.setattr(evidence, "_root", lambda covariance: 2 * root(covariance))
    assert surrogate_error(good, x, shares, np.random.default_rng(2)) == pytest.approx(2 * small, rel=0.1)


def test_it_prints_in_a_line() -> None:
    assert repr(Evidence(-4.3839, 0.011, 0.0, 0.027)) == "<Evidence: log -4.384 ± 0.029>"
