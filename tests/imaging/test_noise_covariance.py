"""The covariance of noise, and what it does to points, against noise that is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from strandline.imaging.noise_covariance import noise_covariance, roughness, scatter_of, sum_to_first_zero

PLACES = np.linspace(-8, 8, 33)
BASIS = np.stack([np.exp(-0.5 * PLACES**2), PLACES > 0, PLACES <= 0], axis=1).astype(float)


@pytest.mark.parametrize("blur", [(0.0, 0.0), (1.0, 1.5)])
def test_covariance_is_that_of_the_noise_although_a_fit_took_part_of_it_out(blur: tuple[float, float]) -> None:
    noise = gaussian_filter(np.random.default_rng(1).standard_normal((20000, 33)), blur, mode="wrap")
    residuals = noise - noise @ (BASIS @ np.linalg.pinv(BASIS)).T
    found = noise_covariance(residuals, np.ones_like(residuals, dtype=bool), BASIS)
    for along in (0, 1, 3):
        for across in (0, 1, 3):
            expected = np.mean(noise[: len(noise) - along, : 33 - across] * noise[along:, across:])
            assert found[along, across] == pytest.approx(expected, abs=0.03 * found[0, 0])


def test_scatter_of_points_is_that_of_a_linear_fit() -> None:
    noise = gaussian_filter(np.random.default_rng(2).standard_normal((20000, 33)), (1.0, 1.0), mode="wrap")
    row = np.linalg.pinv(BASIS)[0]
    places = noise @ row
    residuals = noise - noise @ (BASIS @ np.linalg.pinv(BASIS)).T
    found = scatter_of(places, noise_covariance(residuals, np.ones_like(residuals, dtype=bool), BASIS), row)
    shares = np.array([np.mean(places[: len(places) - k] * places[k:]) for k in range(12)]) / places.var()
    assert found.sd == pytest.approx(places.std(), rel=0.04)
    assert found.length == pytest.approx(sum_to_first_zero(shares), rel=0.1)


@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_roughness_makes_up_for_what_the_smooth_line_follows(sigma: float) -> None:
    white = np.random.default_rng(3).standard_normal(20000)
    errors = gaussian_filter1d(white, sigma) if sigma else white
    shares = np.array([np.mean(errors[: len(errors) - k] * errors[k:]) for k in range(12)]) / errors.var()
    assert roughness(errors + np.linspace(0, 50, 20000), shares) == pytest.approx(errors.std(), rel=0.05)


def test_the_sum_of_an_autocorrelation() -> None:
    assert sum_to_first_zero(np.array([1.0, 0.0, 0.7])) == 0.5
    assert sum_to_first_zero(np.exp(-np.arange(200) / 10.0)) == pytest.approx(10.0, rel=0.01)
