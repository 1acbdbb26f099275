"""What a smooth error of the log-likelihood does to a posterior: units, and a closed form."""

import numpy as np
import pytest

from strandline.design.active.parabola import smooth_effect


def test_the_effect_is_that_of_the_inputs_in_any_units() -> None:
    """In four inputs, the parabola has no products of axes: those of correlated inputs must be found."""
    random = np.random.default_rng(4)
    turn = np.linalg.qr(random.standard_normal((4, 4)))[0]
    draws, posterior = (random.standard_normal((n, 4)) * [3.0, 1.0, 0.5, 0.2] @ turn.T for n in (40, 800))
    ratios = 0.2 * (draws @ turn[:, 0] / 3.0) ** 2
    units = np.array([1e3, 1.0, 1e-3, 50.0])
    one, other = (smooth_effect(draws * by, ratios, posterior * by, 0.05) for by in (1.0, units))
    assert one.width == pytest.approx(other.width, rel=1e-6)
    assert one.width_bounds == pytest.approx(other.width_bounds, rel=1e-6)


def test_the_effect_on_a_width_has_its_closed_form() -> None:
    """The weights exp(-c z²) make a standard normal input narrower by the factor 1/√(1 + 2c)."""
    random = np.random.default_rng(5)
    draws, posterior = random.standard_normal((20, 1)), random.standard_normal((20_000, 1))
    effect = smooth_effect(draws, -0.3 * draws[:, 0] ** 2, posterior, 0.05)
    assert effect.width == pytest.approx(0.5 * np.log(1.6), rel=0.03)
