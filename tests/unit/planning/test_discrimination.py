"""Expected information about the model against closed forms: linear models with normal inputs."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from strandline.errors import InvalidInput
from strandline.planning import discrimination
from strandline.planning.discrimination import CLEAR, Discrimination, expected_discrimination

SIGNALS = 3
CASES = {
    "uneven": ([(0.0, 0.6), (2.0, 1.5)], [0.8, 0.2]),
    "three": ([(0.0, 1.0), (1.5, 0.7), (-2.0, 1.2)], [0.5, 0.3, 0.2]),
    "alike": ([(0.0, 1.0), (0.0, 1.0)], [0.5, 0.5]),
}
"""Mean and standard deviation of each signal under each model, and their probabilities."""


def draws(models: list[tuple[float, float]], number: int, seed: int) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [mean + sd * random.standard_normal((number, SIGNALS)) for mean, sd in models]


def exact(models: list[tuple[float, float]], shares: list[float], number: int = 50_000) -> tuple[float, float, float]:
    """Return the information, and how often the right model and a wrong one lead, from the normal densities of s."""
    random, log_prior, nats, clear, wrong = np.random.default_rng(9), np.log(shares), 0.0, 0.0, 0.0
    normals = [multivariate_normal(np.full(SIGNALS, m), (1 + sd**2) * np.eye(SIGNALS)) for m, sd in models]
    for k, share in enumerate(shares):
        s = normals[k].rvs(number, random_state=random)
        odds = log_prior + np.stack([one.logpdf(s) for one in normals], axis=1)
        nats += share * float(np.mean(odds[:, k] - np.logaddexp.reduce(odds, axis=1) - log_prior[k]))
        order = np.sort(odds, axis=1)
        leads, best = order[:, -1] - order[:, -2] >= CLEAR, odds.argmax(axis=1)
        clear += share * float(np.mean(leads & (best == k)))
        wrong += share * float(np.mean(leads & (best != k)))
    return nats, clear, wrong


@pytest.mark.parametrize("case", CASES)
def test_it_is_the_mutual_information(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the truth itself counts among the draws of its model, as if it had been known."""
    models, shares = CASES[case]
    nats, clear, wrong = exact(models, shares)

    def found() -> list[Discrimination]:
        seeds = range(12)
        return [expected_discrimination(draws(models, 300, k), shares, np.random.default_rng(100 + k)) for k in seeds]

    def z(some: list[Discrimination]) -> float:
        return abs(float(np.mean([(one.nats - nats) / max(one.error, 1e-3) for one in some])))

    right = found()
    assert z(right) < 0.8
    assert np.mean([one.clear for one in right]) == pytest.approx(clear, abs=0.03)
    assert np.mean([one.wrong for one in right]) == pytest.approx(wrong, abs=0.03)
    assert all(one.reliable for one in right)
    if case == "alike":
        whole = discrimination._log_densities
        monkeypatch.setattr(discrimination, "_log_densities", lambda seen, draws, *, own: whole(seen, draws, own=False))
        assert z(found()) > 1.0


def test_models_that_nothing_separates_and_those_that_anything_does() -> None:
    same = draws([(0.0, 1.0)], 200, 1) * 2
    assert expected_discrimination(same, [0.5, 0.5], np.random.default_rng(1)).nats < 0.05
    apart = draws([(0.0, 1.0), (50.0, 1.0)], 200, 1)
    found = expected_discrimination(apart, [0.5, 0.5], np.random.default_rng(1))
    assert found.nats == pytest.approx(np.log(2))
    assert (found.clear, found.wrong) == (1.0, 0.0)
    assert repr(Discrimination(0.6931, 0.02, 1.0, 0.0, 50.0)) == "<Discrimination: 0.693 ± 0.02 nats, clear in 100%>"


def test_too_few_draws_are_reported() -> None:
    """Ten signals of a wide distribution leave hardly a draw near an observation."""
    random = np.random.default_rng(1)
    wide = [20 * random.standard_normal((100, 10)) for _ in range(2)]
    assert not expected_discrimination(wide, [0.5, 0.5], random).reliable
    assert isinstance(expected_discrimination(draws([(0, 1), (1, 1)], 50, 1), [0.5, 0.5], random), Discrimination)


def test_what_is_refused() -> None:
    for shapes, shares in (
        ([(5, 2)], [1.0]),
        ([(5, 2), (5, 3)], [0.5, 0.5]),
        ([(5, 2), (1, 2)], [0.5, 0.5]),
        ([(5, 2), (5, 2)], [0.5, 0.6]),
        ([(5, 2), (5, 2)], [0.0, 1.0]),
        ([(5, 2), (5, 2)], [0.5, 0.3, 0.2]),
    ):
        with pytest.raises(InvalidInput):
            expected_discrimination([np.zeros(shape) for shape in shapes], shares, np.random.default_rng(1))
