"""Hamiltonian chains: the right distribution whatever the force, R̂ and effective draws against ArviZ."""

import arviz
import numpy as np
import pytest

from strandline.smc import Chains, hamiltonian

SD = np.array([1.0, 0.3, 2.0, 0.05])


def log_density(x):
    return -0.5 * ((x / SD) ** 2).sum(axis=1) - 0.1 * x[:, 0] ** 4


def moments_are_right(found, sd_of_first):
    draws = found.draws.reshape(-1, 4)
    expected = np.array([sd_of_first, *SD[1:]])
    error = 4 / np.sqrt(found.effective)
    return bool((np.abs(draws.mean(axis=0)) < error * expected).all()) and bool(
        (np.abs(draws.std(axis=0) / expected - 1) < error).all()
    )


@pytest.fixture(scope="module")
def sd_of_first():
    grid = np.linspace(-6, 6, 4001)
    density = np.exp(-0.5 * grid**2 - 0.1 * grid**4)
    return float(np.sqrt((density * grid**2).sum() / density.sum()))


@pytest.mark.parametrize("share", [1.0, 0.7], ids=["exact", "approximate"])
def test_chains_have_the_target_s_moments_whatever_the_force(share, sd_of_first):
    random = np.random.default_rng(1)
    start = random.standard_normal((40, 4)) * SD
    force = lambda x: -share * x / SD**2  # noqa: E731
    warm = hamiltonian(log_density, force, start, np.diag(SD), random, steps=100, adapt=True)
    found = hamiltonian(log_density, force, warm.last, np.diag(SD), random, steps=400, step=warm.step)
    assert moments_are_right(found, sd_of_first)
    assert found.r_hat < 1.03
    softer = lambda x: 0.8 * log_density(x)  # noqa: E731
    wrong = hamiltonian(softer, force, warm.last, np.diag(SD), random, steps=400, step=warm.step)
    assert not moments_are_right(wrong, sd_of_first)


def test_r_hat_and_effective_draws_are_those_of_arviz():
    random = np.random.default_rng(2)
    steps = random.standard_normal((400, 8, 3))
    draws = np.empty_like(steps)
    draws[0] = steps[0]
    for k in range(1, 400):
        draws[k] = np.array([0.0, 0.5, 0.9]) * draws[k - 1] + steps[k]
    found = Chains(draws, 1.0, 0.1)
    data = arviz.convert_to_dataset(np.moveaxis(draws, 1, 0))
    assert found.r_hat == pytest.approx(float(arviz.rhat(data, method="rank").x.max()), abs=2e-3)
    assert found.effective == pytest.approx(float(arviz.ess(data, method="bulk").x.min()), rel=0.15)
    apart = Chains(draws + np.linspace(0, 1, 8)[:, None] * 3, 1.0, 0.1)
    assert apart.r_hat > 1.1
