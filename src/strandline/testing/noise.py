"""Conformance suite for noise models: what any `strandline.interface.Noise` must do."""

import math
from collections.abc import Callable

import numpy as np
from scipy import integrate

from strandline.interface import Noise
from strandline.testing import checks_of, require_parts


def check_it_has_all_parts(noise: Noise) -> None:
    """It satisfies the protocol."""
    require_parts(noise, Noise)
    assert all(isinstance(value, float) for value in noise.facts.values()), "facts are numbers by name"


def check_no_discrepancy_costs_nothing(noise: Noise) -> None:
    """An interface that agrees exactly has a log-likelihood of 0, without the constant."""
    assert float(noise.log_density(np.zeros(1))[0]) == 0.0, "the log-likelihood at d² = 0 is not 0"


def check_it_falls(noise: Noise) -> None:
    """A larger discrepancy is less likely."""
    values = noise.log_density(noise.scale * np.linspace(0.0, 100.0, 201))
    assert np.isfinite(values).all(), "the log-likelihood is not finite"
    assert (np.diff(values) < 0).all(), "the log-likelihood does not fall with d²"


def check_the_scale_costs_half_a_unit(noise: Noise) -> None:
    """`scale` is the d² that costs half a unit of log-likelihood."""
    assert math.isfinite(noise.scale), "the scale is not finite"
    assert noise.scale > 0, "the scale is not above 0"
    cost = -float(noise.log_density(np.full(1, noise.scale))[0])
    assert math.isclose(cost, 0.5, rel_tol=1e-9), f"d² = scale costs {cost:g} units of log-likelihood, not 0.5"


def check_each_number_is_on_its_own(noise: Noise) -> None:
    """Any shape is accepted, and each number is evaluated on its own."""
    squares = noise.scale * np.linspace(0.0, 5.0, 6)
    together = noise.log_density(squares.reshape(2, 3))
    assert together.shape == (2, 3), "the shape is not kept"
    alone = [float(noise.log_density(squares[k : k + 1])[0]) for k in range(6)]
    assert np.array_equal(together.ravel(), alone), "a number depends on those beside it"


def check_the_constant_normalises(noise: Noise) -> None:
    """With the constant for n residuals, the density of n residuals whose squares sum to d² integrates to one."""
    for terms in (1, 2, 5):
        area = 2 * math.pi ** (terms / 2) / math.gamma(terms / 2)

        def density(log_radius: float, terms: int = terms, area: float = area) -> float:
            """Return the density times the area of the sphere at a distance from zero, given by its logarithm."""
            radius = math.exp(log_radius)
            log_density = float(noise.log_density(np.full(1, radius**2))[0]) + noise.constant(terms)
            return area * radius**terms * math.exp(log_density)

        middle = 0.5 * math.log(noise.scale)
        mass = integrate.quad(density, middle - 20.0, middle + 20.0, limit=400, points=[middle])[0]
        assert abs(mass - 1.0) < 1e-4, f"the density of {terms} residuals integrates to {mass:.4g}, not 1"


CHECKS: dict[str, Callable[[Noise], None]] = checks_of(globals())
