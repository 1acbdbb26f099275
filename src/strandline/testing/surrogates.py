"""Conformance suite for surrogates: what any `strandline.surrogate.Fit` must do."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from strandline.surrogate import Fit, Predictor
from strandline.testing import checks_of, require_parts

Points = Float[np.ndarray, "run dim"]
Values = Float[np.ndarray, " run"]

LOW, HIGH = np.array([100.0, -0.5]), np.array([800.0, 0.5])  # a box of inputs of different magnitude


def training(number: int = 80) -> tuple[Points, Values]:
    """Return runs spread over the box, and the logarithm of a Gaussian likelihood at them."""
    x = np.random.default_rng(5).uniform(LOW, HIGH, size=(number, 2))
    return x, truth(x)


def truth(x: Points) -> Values:
    """Return a Gaussian log-likelihood with a correlation, from 0 down to about -20."""
    a, b = ((x - LOW) / (HIGH - LOW) - [0.4, 0.6]).T
    return np.asarray(-20 * (a**2 - a * b + b**2))


def elsewhere(number: int) -> Points:
    """Return points of the box between the runs."""
    return np.random.default_rng(6).uniform(LOW, HIGH, size=(number, 2))


def learn(fit: Fit, x: Points, y: Values) -> Predictor:
    """Return what `fit` makes of the runs, once it is known to have all parts."""
    learnt = fit(x, y)
    require_parts(learnt, Predictor)
    return learnt


def check_shapes_and_signs(fit: Fit) -> None:
    """Mean and variance are finite numbers, one for each point; the variance is not negative."""
    learnt, x = learn(fit, *training()), elsewhere(30)
    for name, found in (("mean", np.asarray(learnt.mean(x))), ("variance", np.asarray(learnt.variance(x)))):
        assert found.shape == (30,), f"the {name} of 30 points has the shape {found.shape}"
        assert np.isfinite(found).all(), f"the {name} is not finite"
    assert (np.asarray(learnt.variance(x)) >= 0).all(), "a variance is negative"


def check_it_learns(fit: Fit) -> None:
    """Between 80 runs it predicts the logarithm of a Gaussian likelihood to a tenth of its standard deviation."""
    learnt, x = learn(fit, *training()), elsewhere(200)
    error = np.sqrt(np.mean((learnt.mean(x) - truth(x)) ** 2)) / truth(x).std()
    assert error < 0.1, f"it errs by {error:.2g} standard deviations of what it learns"


def check_points_are_predicted_one_by_one(fit: Fit) -> None:
    """What it predicts at a point does not depend on the others, and it leaves its arguments as they are."""
    x, y = training()
    kept = x.copy(), y.copy()
    learnt, at = learn(fit, x, y), elsewhere(12)
    together = np.asarray(learnt.mean(at))
    singly = np.concatenate([np.asarray(learnt.mean(row[None])) for row in at])
    assert np.allclose(together, singly, rtol=1e-9, atol=1e-9), "the mean at a point depends on the points beside it"
    for given, before in zip((x, y), kept, strict=True):
        assert np.array_equal(given, before), "it changes what it is given"


def check_it_repeats(fit: Fit) -> None:
    """The same runs give the same surrogate to the bit: a resumed study must end as if it had not stopped."""
    at = elsewhere(20)
    one, other = (np.asarray(learn(fit, *training()).mean(at)) for _ in range(2))
    assert np.array_equal(one, other), "the same runs give another surrogate"


def check_a_constant_is_only_added(fit: Fit) -> None:
    """A constant in the log-likelihood only shifts the mean: the likelihood's scale must not change the posterior."""
    (x, y), at = training(), elsewhere(20)
    difference = np.asarray(learn(fit, x, y - 500.0).mean(at)) - np.asarray(learn(fit, x, y).mean(at))
    assert np.abs(difference + 500.0).max() < 0.1, "a constant added to the log-likelihood changes more than that"


def check_units_do_not_matter(fit: Fit) -> None:
    """An input in another unit gives the same mean."""
    (x, y), at, factor = training(), elsewhere(20), np.array([1e-6, 1e3])
    found, expected = np.asarray(learn(fit, x * factor, y).mean(at * factor)), np.asarray(learn(fit, x, y).mean(at))
    assert np.abs(found - expected).max() < 0.1, "inputs in other units give another surrogate"


CHECKS: dict[str, Callable[[Fit], None]] = checks_of(globals())
