"""The covariance of noise against noise that is known; forward–backward against a Gaussian random walk."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from strandline.errors import InvalidInput
from strandline.imaging.markov_path import MarkovPath
from strandline.imaging.noise_covariance import noise_covariance, roughness, scatter_of, sum_to_first_zero
from strandline.imaging.random_walk import walk

PLACES = np.linspace(-8, 8, 33)
BASIS = np.stack([np.exp(-0.5 * PLACES**2), PLACES > 0, PLACES <= 0], axis=1).astype(float)
CANDIDATES = np.arange(-8.0, 8.01, 0.25)


def correlations(errors: np.ndarray) -> np.ndarray:
    return np.array([np.mean(errors[: len(errors) - k] * errors[k:]) for k in range(12)]) / errors.var()


@pytest.mark.parametrize("blur", [(0.0, 0.0), (1.0, 1.5)])
def test_covariance_and_scatter_are_those_of_the_noise_although_a_fit_took_part_of_it_out(
    blur: tuple[float, float],
) -> None:
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((20000, 33)), blur, mode="wrap")
    residuals, row = noise - noise @ (BASIS @ np.linalg.pinv(BASIS)).T, np.linalg.pinv(BASIS)[0]
    found = noise_covariance(residuals, np.ones_like(residuals, dtype=bool), BASIS)
    for along in (0, 1, 3):
        for across in (0, 1, 3):
            expected = np.mean(noise[: len(noise) - along, : 33 - across] * noise[along:, across:])
            assert found[along, across] == pytest.approx(expected, abs=0.03 * found[0, 0])
    places = noise @ row
    scatter = scatter_of(places, found, row)
    assert scatter.sd == pytest.approx(places.std(), rel=0.04)
    if any(blur):
        assert scatter.length == pytest.approx(sum_to_first_zero(correlations(places)), rel=0.1)


def test_roughness_makes_up_for_what_the_smooth_line_follows() -> None:
    white = np.random.default_rng(3).standard_normal(20000)
    for errors in (white, gaussian_filter1d(white, 1.5)):
        found = roughness(errors + np.linspace(0, 50, 20000), correlations(errors))
        assert found == pytest.approx(errors.std(), rel=0.05)


def test_the_sum_of_an_autocorrelation() -> None:
    assert sum_to_first_zero(np.array([1.0, 0.0, 0.7])) == 0.5
    assert sum_to_first_zero(np.exp(-np.arange(200) / 10.0)) == pytest.approx(10.0, rel=0.01)


def test_the_posterior_is_that_of_a_gaussian_walk() -> None:
    seen, sd, drift = np.sin(np.arange(60) / 8.0) + 0.5, 1.5, 0.5
    table = -0.5 * ((seen[:, None] - CANDIDATES) / sd) ** 2
    found = walk(table, CANDIDATES, drift, draws=2000, random=np.random.default_rng(1))
    steps = np.diff(np.eye(60), axis=0)
    covariance = np.linalg.inv(np.eye(60) / sd**2 + steps.T @ steps / drift**2)
    np.testing.assert_allclose(found.mean, covariance @ seen / sd**2, atol=2e-3)
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=5e-3)
    np.testing.assert_allclose(found.draws.mean(axis=0), found.mean, atol=0.1)
    np.testing.assert_allclose(np.cov(found.draws.T)[30, 25:36], covariance[30, 25:36], rtol=0.12)


def test_normals_that_show_nothing_are_bridged() -> None:
    table = -0.5 * ((CANDIDATES - 2.0) / 0.3) ** 2 * np.ones((40, 1))
    table[10:30] = 0.0
    found = walk(table, CANDIDATES, 0.3)
    np.testing.assert_allclose(found.mean, 2.0, atol=0.02)
    assert found.sd[20] > 2 * found.sd[5]


def test_a_path_that_could_not_move_is_refused() -> None:
    with pytest.raises(InvalidInput, match="drift of the path"):
        MarkovPath(drift=0.2)
